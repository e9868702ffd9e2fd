"""Bags for Foxglove: all their topics in one timeline, which the viewer plays, pauses and seeks in."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove.websocket import PlaybackCommand, PlaybackControlRequest, PlaybackState, PlaybackStatus
from numpy.typing import NDArray

from vsense_ros.bag import TopicDescription, read_whole_bag
from vsense_ros.errors import InputError
from vsense_ros.files.urdf import urdf
from vsense_ros.messages import cdr, cdr_messages
from vsense_ros.messages.recording import Channel
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.foxglove_scene import PATH, Scene
from vsense_ros.node.foxglove_server import PORT, FoxgloveServer, described
from vsense_ros.node.transforms import Transforms

NANO = 1_000_000_000
_ODOMETRY = "vsense/odometry"
_LATCHED = ("tf_static", "robot_description")
_TICK = 0.02  # [s] of wall time between two looks at what is due
_LONGEST_PAUSE = 0.25  # [s] of wall time that are caught up with
_BEFORE = 3 * NANO  # [ns] before a place that was sought, within which the newest of each topic is shown


class Timeline:
    """The messages of bags in the order in which they arrived."""

    def __init__(self, bags: Sequence[Path], vehicle: Vehicle | None = None) -> None:
        """With a vehicle the transforms and the URDF that the bags lack are made. Raises as `read_whole_bag`, and
        where two bags have the same topic or no time in common."""
        self.descriptions: dict[str, TopicDescription] = {}
        self.latched: dict[str, bytes] = {}
        self._channels: dict[str, Channel] = {}  # what the scene is drawn from
        times: list[NDArray[np.int64]] = []
        self._payloads: list[bytes] = []
        self._topics: list[str] = []
        topic_of: list[NDArray[np.intp]] = []

        def add(topic: str, when: NDArray[np.int64], what: Sequence[bytes]) -> None:
            times.append(np.asarray(when, np.int64))
            topic_of.append(np.full(len(what), len(self._topics)))
            self._topics.append(topic)
            self._payloads.extend(what)

        spans: list[tuple[Path, int, int]] = []
        for path in bags:
            bag = read_whole_bag(path)
            known: dict[str, Any] = {**bag.recording.channels, **bag.others}
            if double := sorted(set(known) & set(self.descriptions)):
                raise InputError(f"{path}: has {double[0]}, which a bag named before has, too")
            for topic, numbers in bag.recording.channels.items():
                self._channels[topic] = numbers
                self.descriptions[topic] = bag.descriptions.get(topic) or TopicDescription.of(topic, numbers.kind)
                add(topic, numbers.received, [row.tobytes() for row in cdr.encode_channel(numbers)])
            for topic, raw in bag.others.items():
                self.descriptions[topic] = bag.descriptions.get(topic) or TopicDescription("", "", "")
                add(topic, raw.times, raw.payloads)
                if topic.endswith(_LATCHED) and raw.payloads:
                    self.latched[topic] = raw.payloads[-1]
            begins = [times[-1 - i] for i in range(len(known)) if len(times[-1 - i])]
            spans.append((path, min(int(t.min()) for t in begins), max(int(t.max()) for t in begins)))
        for path, begin, end in spans[1:]:
            if begin > spans[0][2] or end < spans[0][1]:
                raise InputError(f"{path}: has no time in common with {spans[0][0]}")
        if vehicle is not None:
            self._add_frames(vehicle, add)
        order = np.argsort(np.concatenate(times), kind="stable")
        self.times = np.concatenate(times)[order]
        self._order, self._topic_of = order, np.concatenate(topic_of)[order]

    def _add_frames(self, vehicle: Vehicle, add: Any) -> None:
        odometry = self._channels.get(_ODOMETRY)
        if odometry is None or "tf" in self.descriptions:
            return
        names = {frame: frame for frame in ("map", "odom", "base_link")}
        transforms = Transforms(vehicle, names)
        steering = self._steering(vehicle, odometry.stamp)
        moving = [transforms.moving(odometry.sample(i), float(steering[i])) for i in range(len(odometry))]
        for topic in ("tf", "tf_static"):
            self.descriptions[topic] = TopicDescription.of(topic, "tf2_msgs/msg/TFMessage")
        self.descriptions["robot_description"] = TopicDescription("std_msgs/msg/String", "string data\n", "")
        add("tf", odometry.received, moving)
        self.latched["tf_static"] = transforms.static()
        self.latched["robot_description"] = cdr_messages.encode_text(urdf(vehicle))

    def _steering(self, vehicle: Vehicle, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
        """Steering angles of the front wheels at these times [rad]; zero where the bags have none."""
        for sensor in vehicle.sensing().values():
            channel = self._channels.get(sensor.topic)
            if channel is None or "steering" not in sensor.measures or not len(channel):
                continue
            angles, out, variance = np.zeros(len(channel)), np.zeros(1), np.zeros(1)
            for i in range(len(channel)):
                sensor.read(channel.names, {k: v[i] for k, v in channel.columns.items()}, out, variance)
                angles[i] = out[0]
            good = np.isfinite(angles)
            if good.any():
                return np.interp(stamps, channel.stamp[good], angles[good])
        return np.zeros(len(stamps))

    def __len__(self) -> int:
        return len(self.times)

    def between(self, first: int, last: int) -> Iterator[tuple[int, str, bytes]]:
        """Time [ns], topic and bytes of the messages number `first` to `last`, without the last."""
        for i in range(first, last):
            yield int(self.times[i]), self._topics[self._topic_of[i]], self._payloads[self._order[i]]

    def newest(self, position: int) -> list[tuple[int, str, bytes]]:
        """The newest message of each topic before a place, if it is not older than three seconds."""
        begin = int(np.searchsorted(self.times, self.times[min(position, len(self) - 1)] - _BEFORE))
        newest = {topic: (at, topic, data) for at, topic, data in self.between(begin, position)}
        return list(newest.values())

    def kind(self, topic: str) -> str:
        """Type of a topic that becomes numbers; empty for another."""
        channel = self._channels.get(topic)
        return "" if channel is None else channel.kind


class Playback:
    """Serves a timeline until `stop`."""

    def __init__(
        self,
        timeline: Timeline,
        vehicle: Vehicle | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        loop: bool = False,
        name: str = "vsense",
    ) -> None:
        self.timeline, self._loop = timeline, loop
        self._scene = Scene(vehicle)
        self._condition = threading.Condition()
        self._playing, self._speed, self._now = True, 1.0, int(timeline.times[0])
        self._sought: int | None = None
        self._ended = False
        span = int(timeline.times[0]), int(timeline.times[-1])
        self.server = FoxgloveServer(name, host, port, span=span, control=self._on_request)
        self._known, self.unknown = described(timeline.descriptions.items(), self.server)
        for topic, data in timeline.latched.items():
            if topic in self._known:
                self.server.send(topic, data, span[0], latched=True)

    def run(self) -> None:
        """Play whenever a viewer wants it to."""
        position, last = 0, time.monotonic()
        published, watched = None, False
        while not self._ended:
            now = time.monotonic()
            passed, last = min(now - last, _LONGEST_PAUSE), now
            watched = watched or self.server.is_watched
            with self._condition:
                sought, self._sought = self._sought, None
                if sought is not None:
                    self._now = sought
                elif self._playing and watched:
                    self._now = min(self._now + round(passed * self._speed * NANO), int(self.timeline.times[-1]))
                until = int(np.searchsorted(self.timeline.times, self._now, side="right"))
                state = self._state()
            # Nothing is sent with the lock held, for which a viewer's wish may be waiting.
            if sought is not None:
                position = self._show_from(sought)
            self._send(position, until)
            position = max(position, until)
            self.server.tell_time(self._now)
            if state.status != published:
                published = state.status
                self.server.tell_state(state)
            with self._condition:
                if position == len(self.timeline) and self._loop and self._playing:
                    self._sought = int(self.timeline.times[0])
                elif not self._ended and self._sought is None:
                    self._condition.wait(_TICK)

    def _show_from(self, moment: int) -> int:
        """Show how things were before a moment [ns], from which on it plays; the place of its first message."""
        self._scene.forget()
        position = int(np.searchsorted(self.timeline.times, moment))
        for at, topic, data in self.timeline.newest(position):
            self._send_one(at, topic, data)
        return position

    def _send(self, first: int, last: int) -> None:
        for at, topic, data in self.timeline.between(first, last):
            self._send_one(at, topic, data)

    def _send_one(self, at: int, topic: str, data: bytes) -> None:
        if topic not in self._known:
            return
        self.server.send(topic, data, at)
        kind = self.timeline.kind(topic) if topic.startswith("vsense/") else ""
        if kind:
            for drawn, scene in self._scene.add(cdr.decode(kind, data, topic, at)):
                self.server.draw(drawn, scene, at, latched=drawn == PATH)

    def _state(self, seek: bool = False, request: str | None = None) -> PlaybackState:
        at_end = self._now >= int(self.timeline.times[-1])
        status = PlaybackStatus.Ended if at_end else PlaybackStatus.Playing if self._playing else PlaybackStatus.Paused
        return PlaybackState(status, self._now, self._speed, seek, request)

    def _on_request(self, request: PlaybackControlRequest) -> PlaybackState:
        with self._condition:
            self._playing = request.playback_command == PlaybackCommand.Play
            self._speed = min(max(float(request.playback_speed), 0.01), 100.0)
            seek = request.seek_time is not None
            if request.seek_time is not None:
                times = self.timeline.times
                self._sought = self._now = min(max(int(request.seek_time), int(times[0])), int(times[-1]))
            self._condition.notify_all()
            return self._state(seek, request.request_id)

    def stop(self) -> None:
        """End it."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()
        self.server.stop()
