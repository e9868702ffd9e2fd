"""Recorder: records topics of any type to an MCAP bag, as the bytes that arrive, with a delay of at most a second.

In a namespace it records, unless configured otherwise, the topics below the namespace, and the transforms and
diagnostics of all. Its services are those of rosbag2's recorder: `~/pause`, `~/resume`, `~/toggle_paused`,
`~/is_paused`, `~/split_bagfile` and, with `snapshot_mode`, `~/snapshot`.
"""

from __future__ import annotations

import sys
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

from pydantic import Field
from rclpy.qos import DurabilityPolicy

from vsense_ros.bag import BagWriter, TopicDescription
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.node import rosbag2
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.convert import describe, message_type
from vsense_ros.node.parameters import NodeParameters, parameter, path_parameter
from vsense_ros.node.qos import offered_text
from vsense_ros.node.reader import Reader
from vsense_ros.node.replay_answers import is_between_nodes
from vsense_ros.node.timers import steady_timer


@dataclass(frozen=True)
class RecorderSettings:
    """How the recorder writes: decisions of this project."""

    step_back: int = 1_000_000_000  # [ns] by which a clock was set back; by less it only ticks coarsely or late
    write_every: float = 0.5  # [s]
    most_held: int = 1000


SETTINGS = RecorderSettings()

_OF_ALL = ("/tf", "/tf_static", "/diagnostics", "/diagnostics_agg")
_NOT_BY_ITSELF = ("/clock", "/rosout", "/parameter_events")


class RecorderParameters(NodeParameters):
    """What and where."""

    bag: str = path_parameter("folder to write the bag into; where it holds something already, BAG_1, BAG_2 …")
    topics: tuple[str, ...] = Field((), description="topics to record; empty: all that appear")
    overwrite: bool = Field(False, description="replace an existing bag, at the first message")
    max_bagfile_size: int = parameter(0, "byte", "size after which the next file of the bag begins; 0: never", ge=0)
    max_bagfile_duration: float = parameter(
        0.0, "s", "duration after which the next file of the bag begins; 0: never", ge=0
    )
    snapshot_mode: bool = Field(False, description="write only when ~/snapshot is called, what is in memory then")
    max_cache_size: int = parameter(
        100_000_000, "byte", "size of the messages in memory for a snapshot", ge=1000, le=10**10
    )
    snapshot_duration: float = parameter(30.0, "s", "duration of the messages in memory for a snapshot", gt=0, le=3600)


class Recorder(SensingNode[RecorderParameters]):
    """See the module."""

    consumes = True
    _writer: BagWriter | None = None
    _servers: tuple[Any, ...] = ()

    def configure(self) -> None:
        if not self.parameters.bag:
            raise InputError("parameter bag is empty: expected the folder to write the bag into")
        self.recorded: Counter[str] = Counter()
        self.before_clock = 0
        self.while_paused = 0
        self._held: list[tuple[Callable[[bytes], None], bytes]] = []  # latched messages from before the clock's first
        self._kinds: dict[str, str] = {}
        self._descriptions: dict[str, TopicDescription] = {}
        self._refused: set[str] = set()
        self._last_time = 0
        self._inputs: dict[str, Reader] = {}
        self._timers_of_recording: list[Any] = []
        self._memory: deque[tuple[str, str, int, bytes]] = deque()
        self._remembered = 0  # [byte]
        self._paused = False
        self._failure = ""
        self._folder = self._free_folder()
        self._make(self._folder)
        if not self.parameters.overwrite:
            self._open()
        services = [
            ("pause", "Pause", lambda: self._pause(True)),
            ("resume", "Resume", lambda: self._pause(False)),
            ("toggle_paused", "TogglePaused", lambda: self._pause(not self._paused)),
            ("is_paused", "IsPaused", lambda: self._paused),
            ("split_bagfile", "SplitBagfile", self._split),
        ]
        if self.parameters.snapshot_mode:
            services.append(("snapshot", "Snapshot", self._snapshot))
        self._servers = tuple(rosbag2.offer(self, *service) for service in services)

    def _open(self) -> BagWriter:
        p = self.parameters
        try:
            self._writer = BagWriter(
                self._folder,
                overwrite=p.overwrite,
                split_size=p.max_bagfile_size,
                split_duration=p.max_bagfile_duration,
            )
        except OSError as error:
            raise InputError(f"{self._folder}: cannot be written: {error.strerror}") from None
        return self._writer

    @staticmethod
    def _make(folder: Path) -> None:
        """Refuse early what could not be written later; what is to be overwritten stays until the first message."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise InputError(
                f"{folder}: a bag is a folder, but a file of this name exists; choose another name"
            ) from None
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
        if any(not (f.name == "metadata.yaml" or f.suffix == ".mcap") for f in folder.iterdir()):
            raise InputError(f"{folder}: holds files that are no bag, so it is not overwritten")

    def _free_folder(self) -> Path:
        """The first that is free: a recorder that is started again, by a launch file or by the lifecycle, goes on."""
        bag = Path(self.parameters.bag)
        if self.parameters.overwrite:
            return bag
        folders = chain([bag], (Path(f"{bag}_{number}") for number in count(1)))
        free = next(folder for folder in folders if not folder.is_dir() or not any(folder.iterdir()))
        if free != bag:
            self.get_logger().info(f"{bag} holds something already; recording to {free}")
        return free

    def start(self) -> None:
        self._timers_of_recording = [
            steady_timer(self, 0.1, self._look),
            steady_timer(self, SETTINGS.write_every, self._write),
        ]
        self._look_for_topics()

    def stop(self) -> None:
        for timer in getattr(self, "_timers_of_recording", ()):
            self.destroy_timer(timer)
        self._timers_of_recording = []
        for reader in getattr(self, "_inputs", {}).values():
            reader.close()
        self._inputs = {}

    def release(self) -> None:
        self.stop()
        for server in self._servers:
            self.destroy_service(server)
        self._servers = ()
        if self._writer is not None and not self._failure:
            try:
                self._writer.close()
            except OSError as error:
                self._give_up(error)
        self._writer = None

    def _give_up(self, error: Exception) -> None:
        """End the recording but not the node, which would be started again and fill the disk with new bags."""
        if self._writer is not None:
            self._writer.abandon()
        self._failure = f"{self._folder}: cannot be written any more: {getattr(error, 'strerror', None) or error}"
        self.get_logger().error(self._failure)
        self.exit_code = 1

    def _write(self) -> None:
        """Whatever happens to this process, what came before is in the file."""
        if self._writer is not None and not self._failure:
            try:
                self._writer.flush()
            except OSError as error:
                self._give_up(error)

    def _wants(self, topic: str) -> bool:
        if self.parameters.topics:
            return topic in {self.resolve_topic_name(name) for name in self.parameters.topics}
        namespace = self.get_namespace().rstrip("/")
        if topic in _NOT_BY_ITSELF or is_between_nodes(topic):
            return False
        return topic.startswith(f"{namespace}/") or topic in _OF_ALL

    def _look(self) -> None:
        self._look_for_topics()

    def _look_for_topics(self) -> bool:
        """Listen to topics that have appeared; whether there were any."""
        known = len(self._inputs)
        for topic, kinds in self.get_topic_names_and_types():
            if topic in self._inputs or topic in self._refused or not self._wants(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            kind, type_hash = publishers[0].topic_type, str(publishers[0].topic_type_hash)
            if len(kinds) > 1:
                self.get_logger().error(f"{topic} has several types ({', '.join(kinds)}); {kind} is recorded")
            try:
                accepted = message_type(kind, type_hash)
            except InputError as error:
                self._refused.add(topic)
                self.get_logger().error(f"{topic} is not recorded: {error}")
                continue
            latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
            description = describe(kind, type_hash, offered_text([p.qos_profile for p in publishers]))
            self._inputs[topic] = self._subscribe(topic, description, accepted, latched)
        if len(self._inputs) == known:
            return False
        self.answers.expect_question()
        return True

    def _subscribe(self, topic: str, description: TopicDescription, accepted: Any, latched: bool) -> Reader:
        kind = self._kinds[topic] = description.kind
        name = topic.removeprefix("/")

        def receive(data: bytes) -> None:
            if self._failure:
                return
            now = self.now()
            if now <= 0:  # no /clock yet: the bag would begin in 1970
                if latched and len(self._held) < SETTINGS.most_held:
                    self._held.append((receive, data))
                else:
                    self.before_clock += 1
                return
            if self._paused:
                self.while_paused += 1
                return
            # A bag is in order of arrival, as long as nobody sets the clock.
            if not 0 < self._last_time - now < SETTINGS.step_back:
                self._last_time = now
            if self.parameters.snapshot_mode:
                self._remember(name, kind, self._last_time, data)
                return
            try:
                writer = self._writer or self._open()
                writer.describe(name, description)
                writer.write_raw(name, kind, self._last_time, data)
            except (OSError, InputError) as error:
                self._give_up(error)
                return
            self.recorded[name] += 1

        self._descriptions[name] = description
        return Reader(self, accepted, topic, receive, raw=True, latched=latched, made_anew=self.answers.expect_question)

    # Snapshots, pauses, files

    def _remember(self, name: str, kind: str, now: int, data: bytes) -> None:
        self._memory.append((name, kind, now, data))
        self._remembered += len(data)
        oldest = now - round(self.parameters.snapshot_duration * 1e9)
        while self._remembered > self.parameters.max_cache_size or self._memory[0][2] < oldest:
            self._remembered -= len(self._memory.popleft()[3])

    def _snapshot(self) -> bool:
        try:
            writer = self._writer or self._open()
            for name, kind, time, data in self._memory:
                writer.describe(name, self._descriptions[name])
                writer.write_raw(name, kind, time, data)
                self.recorded[name] += 1
            writer.flush()
        except (OSError, InputError) as error:
            self._give_up(error)
            return False
        self.get_logger().info(f"snapshot: {len(self._memory)} messages to {self._folder}")
        self._memory.clear()
        self._remembered = 0
        return True

    def _pause(self, paused: bool) -> None:
        self._paused = paused
        self.get_logger().info("paused" if paused else "recording")

    def _split(self) -> None:
        if self._writer is not None:
            self._writer.split()

    def _missing(self) -> str:
        """What of the wanted topics does not come, and why; empty if all do."""
        heard = {t for t in self.parameters.topics if self.recorded[self.resolve_topic_name(t).removeprefix("/")]}
        nobody = [t for t in self.parameters.topics if not self.count_publishers(t)]
        silent = [t for t in self.parameters.topics if t not in {*heard, *nobody}]
        reasons = (("nobody publishes", nobody), ("nothing came yet on", silent))
        return "; ".join(f"{why} {', '.join(topics)}" for why, topics in reasons if topics)

    def on_clock(self, stamp: int) -> None:
        if self.state != "active":
            return
        if self._held and self.now() > 0:
            held, self._held = self._held, []
            for receive, data in held:
                receive(data)
        self.answers.report_progress(stamp)

    def hears_all(self) -> bool:
        """A replay announces its topics before it asks, so that they are known here."""
        return not self._look_for_topics()

    def diagnostics(self) -> list[Diagnostic]:
        values = {"messages": str(sum(self.recorded.values())), "topics": str(len(self._kinds))}
        if self.before_clock:
            values["dropped before the first /clock message"] = str(self.before_clock)
        if self.while_paused:
            values["left out while paused"] = str(self.while_paused)
        if self._refused:
            values["topics of unknown types"] = ", ".join(sorted(self._refused))
        if self._failure:
            return [Diagnostic("recorder", Level.ERROR, self._failure, values)]
        if self._paused:
            return [Diagnostic("recorder", Level.WARN, "paused", values)]
        if self.now() <= 0:
            return [Diagnostic("recorder", Level.WARN, "no /clock message yet: nothing is recorded", values)]
        if self.parameters.snapshot_mode:
            values |= {"messages in memory": str(len(self._memory)), "bytes in memory": str(self._remembered)}
            return [Diagnostic("recorder", Level.OK, "waiting for ~/snapshot", values)]
        if missing := self._missing():
            return [Diagnostic("recorder", Level.WARN, missing, values)]
        return [Diagnostic("recorder", Level.OK, f"recording to {self._folder}", values)]

    def summary(self) -> dict[str, Any]:
        return {**super().summary(), "recorded": dict(self.recorded), "before_clock": self.before_clock}


def main() -> int:
    """Entry point of `ros2 run vsense_ros recorder`."""
    return run_node(Recorder, RecorderParameters)


if __name__ == "__main__":
    sys.exit(main())
