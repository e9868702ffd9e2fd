"""From the messages of a bag, as bytes, to channels of numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from vsense_ros.bag.mcap import Payloads, Times
from vsense_ros.messages import cdr
from vsense_ros.messages.foreign import converted, is_foreign
from vsense_ros.messages.recording import Channel

LONGEST_RECORDING = 86_400_000_000_000  # [ns] a day: times further from the median are impossible


@dataclass
class TopicMessages:
    """All messages of one topic as CDR bytes, with their times of arrival [ns]."""

    kind: str
    payloads: Payloads = field(default_factory=list)
    times: Times | list[int] = field(default_factory=list)

    def append(self, payload: bytes, time: int) -> None:
        """Add one message to those that have been gathered one by one."""
        assert isinstance(self.payloads, list)
        assert isinstance(self.times, list)
        self.payloads.append(payload)
        self.times.append(time)


def skipped(topic: str, kind: str, count: int) -> str:
    """A sentence about messages that do not become numbers, and what would read them."""
    hint = "; a database and a mapping read them (--dbc, --mapping)" if kind == "can_msgs/msg/Frame" else ""
    return f"{topic}: {count} messages of type {kind} skipped{hint}"


def channels_of(gathered: Iterable[tuple[str, TopicMessages]], notes: list[str]) -> tuple[dict[str, Channel], int]:
    """Decode the messages of each topic. Returns the channels, and the number of messages that are not of their type;
    `notes` gets a sentence on these."""
    result: dict[str, Channel] = {}
    lost = 0
    for topic, messages in gathered:
        payloads = messages.payloads
        received = np.array(messages.times, np.uint64).astype(np.int64)  # from 2⁶³ on negative
        if (np.diff(received) < 0).any():
            order = np.argsort(received, kind="stable")
            received = received[order]
            payloads = payloads[order] if isinstance(payloads, np.ndarray) else [payloads[i] for i in order]
        if is_foreign(messages.kind):
            channel, damaged = converted(messages.kind, topic, payloads, received)
            decoded = cdr.Decoded(channel, damaged, "cut off" if damaged else "", {})
        else:
            decoded = cdr.decode_channel(messages.kind, topic, payloads, received)
        if decoded.channel is not None:
            decoded = replace(decoded, channel=_with_possible_times(decoded.channel, notes))
        if decoded.channel is not None:
            result[topic] = decoded.channel.compact()
        if decoded.bad:
            notes.append(f"{topic}: {decoded.bad} messages are damaged and left out; the first: {decoded.first_error}")
            lost += decoded.bad
        for frame, count in decoded.foreign.items():
            notes.append(
                f"{topic}: {count} messages with frame id {frame!r} left out; the others have "
                f"{decoded.channel.frame_id if decoded.channel else ''!r}"
            )
    return result, lost


def _with_possible_times(channel: Channel, notes: list[str]) -> Channel:
    """The channel with each impossible time of arrival replaced by the time of measurement, and vice versa."""
    if len(channel) < 2:
        return channel
    stamp, received = channel.stamp.copy(), channel.received.copy()
    usual_stamp, usual = float(np.median(stamp)), float(np.median(received))
    strange = (received < 0) | (np.abs(received - usual) > LONGEST_RECORDING)
    strange &= (np.abs(stamp - usual_stamp) <= LONGEST_RECORDING) & (abs(usual_stamp - usual) <= LONGEST_RECORDING)
    if strange.any():
        notes.append(
            f"{channel.topic}: {int(strange.sum())} messages with impossible arrival times; stamps used instead"
        )
        received[strange] = stamp[strange]
    unset = (stamp == 0) & (received > LONGEST_RECORDING)
    if unset.any():
        notes.append(f"{channel.topic}: {int(unset.sum())} messages without a time stamp; arrival times used instead")
        stamp[unset] = received[unset]
    if not (strange.any() or unset.any()):
        return channel
    return replace(channel, stamp=stamp, received=received).in_order()
