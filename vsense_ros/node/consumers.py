"""The consumers of a replay, which are observers and recorders: whether they listen, and how far they are."""

from __future__ import annotations

import threading
from typing import Any

from std_msgs.msg import Header

from vsense_ros.node.base import SensingNode
from vsense_ros.node.reader import LOSSLESS
from vsense_ros.node.replay_answers import LISTENING_TOPIC, PROGRESS_TOPIC, QUESTIONS
from vsense_ros.node.rosbag2 import nanoseconds
from vsense_ros.node.timers import steady_timer


class Consumers:
    """The consumers that answered a node so far. Each answer wakes those who wait for `changed`, a condition that the
    caller of `listening`, `behind` and `forget_progress` holds."""

    def __init__(self, node: SensingNode[Any], changed: threading.Condition) -> None:
        self._node, self._changed = node, changed
        self._processed: dict[str, int] = {}  # by consumer: the time up to which it has processed everything [ns]
        self._listening: set[str] = set()  # consumers that get all that is published
        self._questions: dict[str, Any] = {}  # publishers by topic
        self._timer: Any = None
        self._complete = False
        self._readers = [
            node.create_subscription(Header, PROGRESS_TOPIC, self._on_progress, LOSSLESS),
            node.create_subscription(Header, LISTENING_TOPIC, self._on_listening, LOSSLESS),
        ]

    def ask(self, every: float) -> None:
        """Ask all consumers anew whether they listen, every so many seconds until `complete` is called."""
        self._complete = False
        self._listening.clear()
        self._timer = steady_timer(self._node, every, self._ask)

    def complete(self) -> None:
        """All consumers that are waited for listen: the next question is not asked. Any thread may say so."""
        self._complete = True

    def listening(self, least: int) -> tuple[int, int]:
        """How many consumers listen, and how many are expected to: at least so many, and all that report progress."""
        return len(self._processed.keys() & self._listening), max(least, len(self._processed))

    def behind(self, moment: int) -> list[str]:
        """Names of the consumers that have not processed everything up to a `/clock` message [ns]."""
        return [name for name, processed in self._processed.items() if processed < moment]

    def forget_progress(self) -> None:
        """Wait for nobody who does not report again."""
        self._processed.clear()

    def ask_no_more(self) -> None:
        """End the questions; only the thread in which the node's timers run may do so."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = None
        for publisher in self._questions.values():
            self._node.destroy_publisher(publisher)
        self._questions.clear()

    def close(self) -> None:
        """Hear and ask nobody any more."""
        self.ask_no_more()
        for reader in self._readers:
            self._node.destroy_subscription(reader)
        self._readers.clear()

    def _ask(self) -> None:
        """Ask all consumers that can be asked whether they listen."""
        if self._complete:
            self.ask_no_more()
            return
        questions = self._node.resolve_topic_name(QUESTIONS)
        for topic, _ in self._node.get_topic_names_and_types():
            if topic.startswith(f"{questions}/") and topic not in self._questions:
                self._questions[topic] = self._node.create_publisher(Header, topic, LOSSLESS)
        for publisher in self._questions.values():
            publisher.publish(Header())

    def _on_listening(self, message: Header) -> None:
        with self._changed:
            self._listening.add(message.frame_id)
            self._changed.notify_all()

    def _on_progress(self, message: Header) -> None:
        with self._changed:
            self._processed[message.frame_id] = nanoseconds(message.stamp)
            self._changed.notify_all()
