"""What a node tells a replay: that it listens, and how far it has worked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from uuid import uuid4

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header

from vsense_ros.node.reader import LOSSLESS, Reader

PROGRESS_TOPIC = "vsense/progress"
LISTENING_TOPIC = "vsense/listening"
QUESTIONS = "vsense/do_you_listen"  # the topics below it


class ReplayAnswers:
    """The answers of one node to replays; `listens` is true while it has all the subscriptions that it wants."""

    def __init__(self, node: Node, listens: Callable[[], bool]) -> None:
        self._node, self._listens = node, listens
        self.question: Reader | None = None
        self._progress: Any = None
        self._listening: Any = None

    def open(self) -> None:
        """Announce the topics of the answers."""
        self._progress = self._node.create_publisher(Header, PROGRESS_TOPIC, LOSSLESS)
        self._listening = self._node.create_publisher(Header, LISTENING_TOPIC, LOSSLESS)

    def close(self) -> None:
        """Take the topics back, if they are announced."""
        self.stop_expecting()
        for publisher in (self._progress, self._listening):
            if publisher is not None:
                self._node.destroy_publisher(publisher)
        self._progress = self._listening = None

    def expect_question(self) -> None:
        """Let a replay ask whether the node listens, on a topic with a name that is new.

        Subscriptions are announced in the order in which they are made: whoever asks there knows all others too, and
        what he publishes comes. A message on a topic with a known name says less. It reaches each reader of it in
        this process, also while its sender knows only one that is older than all the others, as rclpy's of `/clock`.
        """
        self.stop_expecting()
        topic = f"{QUESTIONS}/of_{uuid4().hex}"  # a part of a topic's name begins with a letter
        # In a task: the answer may be to make this subscription anew.
        self.question = Reader(self._node, Header, topic, lambda _: self._node.executor.create_task(self.answer, topic))

    def stop_expecting(self) -> None:
        """Let no replay ask any more."""
        if self.question is not None:
            self.question.close()
        self.question = None

    def answer(self, topic: str) -> None:
        """Say that the node listens, if it does and was asked on the newest topic."""
        asked = self.question is not None and self.question.topic == topic
        if asked and self._listens():
            self._listening.publish(Header(frame_id=self._node.get_fully_qualified_name()))

    def report_progress(self, stamp: int) -> None:
        """Say that everything up to the clock message `stamp` [ns] of a replay has been worked off here."""
        if self._progress is not None:
            seconds, nanoseconds = divmod(stamp, 1_000_000_000)
            stamp_there = Time(sec=seconds, nanosec=nanoseconds)
            self._progress.publish(Header(stamp=stamp_there, frame_id=self._node.get_fully_qualified_name()))


def is_between_nodes(topic: str) -> bool:
    """True if nodes talk there of replays or of their lifecycle: nothing to record or to look at."""
    last = (f"/{PROGRESS_TOPIC}", f"/{LISTENING_TOPIC}", "/transition_event")
    return topic.endswith(last) or f"/{QUESTIONS}/" in topic
