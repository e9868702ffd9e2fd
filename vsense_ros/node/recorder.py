"""Recorder: topics to an MCAP bag, as the bytes that arrive."""

from __future__ import annotations

import sys
from collections import Counter
from itertools import chain, count
from pathlib import Path
from typing import Any

from pydantic import Field

from vsense_ros.bag import BagWriter
from vsense_ros.errors import InputError
from vsense_ros.messages.definitions import TYPE_HASHES
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.convert import message_type
from vsense_ros.node.parameters import NodeParameters
from vsense_ros.node.reader import Reader

_STEP_BACK = 1_000_000_000  # [ns] by which a clock was set back; by less it only ticks coarsely or late


class RecorderParameters(NodeParameters):
    """What and where."""

    bag: str = Field("", description="folder to write the bag into; where it holds something already, BAG_1, BAG_2 …")
    topics: tuple[str, ...] = Field((), description="topics to record; empty: all of known types that appear")
    overwrite: bool = Field(False, description="replace a bag that is there already")


class Recorder(SensingNode[RecorderParameters]):
    """See the module."""

    _writer: BagWriter | None = None

    def configure(self) -> None:
        if not self.parameters.bag:
            raise InputError("parameter bag is empty: expected the folder to write the bag into")
        self.recorded: Counter[str] = Counter()
        self.before_clock = 0
        self._kinds: dict[str, str] = {}
        self._last_time = 0
        self._inputs: dict[str, Reader] = {}
        self._search: Any = None
        self._folder = self._free_folder()
        self._failure = ""
        try:
            self._writer = BagWriter(self._folder, overwrite=self.parameters.overwrite)
        except OSError as error:
            raise InputError(f"{self._folder}: cannot be written: {error.strerror}") from None

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
        self._search = self.create_steady_timer(0.1, self._look_for_topics)
        self._look_for_topics()

    def stop(self) -> None:
        if self._writer is None:
            return
        if self._search is not None:
            self.destroy_timer(self._search)
            self._search = None
        for reader in self._inputs.values():
            reader.close()
        self._inputs.clear()

    def release(self) -> None:
        self.stop()
        if self._writer is not None and not self._failure:
            try:
                self._writer.close()
            except OSError as error:
                self._give_up(self._writer, error)
        self._writer = None

    def _give_up(self, writer: BagWriter, error: OSError) -> None:
        """End the recording but not the node, which would be started again and fill the disk with new bags."""
        writer.abandon()
        self._failure = f"{self._folder}: cannot be written any more: {error.strerror}"
        self.get_logger().error(self._failure)
        self.exit_code = 1

    def _look_for_topics(self) -> None:
        wanted = {self.resolve_topic_name(topic) for topic in self.parameters.topics}
        for topic, kinds in self.get_topic_names_and_types():
            if topic in self._inputs or (wanted and topic not in wanted):
                continue
            kind = kinds[0]
            if kind in TYPE_HASHES:
                self._inputs[topic] = self._subscribe(topic, kind)
            elif topic in wanted:
                self.get_logger().error(f"{topic}: messages of type {kind} cannot be recorded", once=True)

    def _subscribe(self, topic: str, kind: str) -> Reader:
        self._kinds[topic] = kind
        name = topic.removeprefix("/")

        def receive(data: bytes) -> None:
            if self._writer is None or self._failure:
                return
            now = self.now()
            if now <= 0:  # no /clock yet: the bag would begin in 1970
                self.before_clock += 1
                return
            # A bag is in order of arrival, as long as nobody sets the clock.
            if not 0 < self._last_time - now < _STEP_BACK:
                self._last_time = now
            try:
                self._writer.write_raw(name, kind, self._last_time, data)
            except OSError as error:
                self._give_up(self._writer, error)
                return
            self.recorded[name] += 1

        return Reader(self, message_type(kind), topic, receive, raw=True)

    def _missing(self) -> str:
        """What of the wanted topics does not come, and why; empty if all do."""
        heard = {t for t in self.parameters.topics if self.recorded[self.resolve_topic_name(t).removeprefix("/")]}
        nobody = [t for t in self.parameters.topics if not self.count_publishers(t)]
        silent = [t for t in self.parameters.topics if t not in {*heard, *nobody}]
        reasons = (("nobody publishes", nobody), ("nothing came yet on", silent))
        return "; ".join(f"{why} {', '.join(topics)}" for why, topics in reasons if topics)

    def on_clock(self, stamp: int) -> None:
        if self.state == "active":
            self.report_progress(stamp)

    def diagnostics(self) -> list[Diagnostic]:
        values = {"messages": str(sum(self.recorded.values())), "topics": str(len(self._kinds))}
        if self.before_clock:
            values["dropped before the first /clock message"] = str(self.before_clock)
        if self._failure:
            return [Diagnostic("recorder", Level.ERROR, self._failure, values)]
        if self.now() <= 0:
            return [Diagnostic("recorder", Level.WARN, "no /clock message yet: nothing is recorded", values)]
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
