"""A ROS 2 bag in which the car's bus was recorded as frames (can_msgs/Frame, as ros2_socketcan publishes it).

The frames are decoded as those of a CAN log. Each topic of frames is a bus, which its name distinguishes from others;
the other topics of the bag stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vsense_ros.bag.decoding import TopicMessages
from vsense_ros.bag.importers import can_log, mcap, rosbag2
from vsense_ros.bag.reading import read_whole_bag
from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.errors import InputError
from vsense_ros.messages.cdr_messages import CanFrame, decode_can_frame
from vsense_ros.messages.recording import Recording

NAME = "bag_can"
DESCRIPTION = "ROS 2 bag with CAN frames (can_msgs/Frame), a database and a mapping"
NEEDS = ("dbc",)  # without a database a bag is one of topics

KIND = "can_msgs/msg/Frame"


def matches(path: Path) -> bool:
    """True if `path` is a ROS 2 bag."""
    return rosbag2.matches(path) or mcap.matches(path)


def read(
    path: Path,
    *,
    dbc: str | Path | Sequence[str | Path] | None = None,
    mapping: str | Path | Sequence[str | Path] | None = None,
    channel: str | None = None,
) -> Recording:
    """The topics that the mapping makes of the frames, and the bag's own; of a topic that both have, the bag's own.

    `channel` is the topic of the frames, where the bag has several; `--dbc TOPIC=FILE` gives each a database. Raises
    `InputError` where the bag has no frames.
    """
    decoders = can_log.decoders_of(path, dbc, mapping, channel and channel.lstrip("/"))
    own, frames = _messages(path)
    if not frames:
        raise InputError(
            f"{path}: the bag has no messages of type {KIND}, which a database is for; it has "
            f"{', '.join(own.channels) or 'no topic that can be read'}"
        )
    made = can_log.decoded(path, _columns(frames), decoders)
    used = tuple(f"{topic}: {len(messages.times)} frames" for topic, messages in frames.items())
    kept = tuple(note for note in own.notes if KIND not in note)
    return replace(
        own, channels={**made.channels, **own.channels}, notes=(*kept, *used, *made.notes), metadata={**own.metadata}
    )


def _messages(path: Path) -> tuple[Recording, Mapping[str, TopicMessages]]:
    """The bag without its frames, and the bytes of the frames by topic."""
    frames: dict[str, TopicMessages] = {}
    if rosbag2.matches(path):
        return rosbag2.whole(path, frames, KIND), frames
    bag = read_whole_bag(path)
    for topic, raw in bag.others.items():
        if bag.descriptions[topic].kind == KIND:
            frames[topic] = TopicMessages(KIND, raw.payloads, raw.times.astype(np.uint64))
    return bag.recording, frames


def _columns(frames: Mapping[str, TopicMessages]) -> CanFrames:
    """Data frames of all topics, in order of time: that of their stamp, or of arrival where they have none."""
    decoded: list[tuple[int, int, CanFrame]] = []
    damaged = 0
    for bus, messages in enumerate(frames.values()):
        for payload, time in zip(messages.payloads, messages.times, strict=True):
            try:
                frame = decode_can_frame(bytes(payload))
            except InputError:
                damaged += 1
                continue
            if not (frame.is_remote or frame.is_error):
                decoded.append((frame.stamp or int(time), bus, frame))
    decoded.sort(key=lambda one: one[0])
    length = np.array([len(frame.data) for *_, frame in decoded], np.int64)
    return CanFrames(
        np.array([stamp for stamp, *_ in decoded], np.float64) * 1e-9,
        np.array([frame.identifier for *_, frame in decoded], np.uint32),
        np.array([frame.is_extended for *_, frame in decoded], bool),
        np.array([bus for _, bus, _ in decoded], np.int16),
        tuple(frames),
        length,
        np.cumsum(length) - length,
        np.frombuffer(b"".join(frame.data for *_, frame in decoded), np.uint8),
        (f"{damaged} messages of type {KIND} are damaged and left out",) if damaged else (),
    )
