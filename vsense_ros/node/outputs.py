"""The topics on which a node sends: announced before the first message, and closed once readers have the last one."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile

from vsense_ros.messages import cdr
from vsense_ros.messages.recording import Sample
from vsense_ros.node.convert import message_type
from vsense_ros.node.reader import LOSSLESS

_LAST = 0.5  # [s] for readers to take what was published before the end


class Outputs:
    """Publishers of a lifecycle node by topic, and how many messages each has sent."""

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._publishers: dict[str, Any] = {}
        self.published: Counter[str] = Counter()
        self._connected = False

    def create(self, topic: str, kind: str, qos: QoSProfile = LOSSLESS, type_hash: str = "") -> None:
        """Announce a topic on which messages will be sent, so that its subscribers are found before the first one."""
        if topic not in self._publishers:
            kind_of_message = message_type(kind, type_hash)
            self._publishers[topic] = self._node.create_lifecycle_publisher(kind_of_message, topic, qos)

    def publish(self, sample: Sample) -> None:
        """Send a sample; dropped while the node is not active."""
        self.publish_bytes(sample.topic, sample.kind, cdr.encode(sample))

    def publish_bytes(self, topic: str, kind: str, data: bytes) -> None:
        """Send a message that is CDR bytes already."""
        if topic not in self._publishers:
            self.create(topic, kind)
        self._publishers[topic].publish(data)
        self.published[topic] += 1

    @property
    def unheard(self) -> list[str]:
        """Announced topics that nobody subscribes to."""
        return [topic for topic, publisher in self._publishers.items() if publisher.get_subscription_count() == 0]

    def activate(self) -> None:
        """Let publishers send, before rclpy does: what a node starts with may already send."""
        for publisher in self._publishers.values():
            publisher.on_activate(None)
        self._connected = False

    def look_for_subscribers(self) -> None:
        """Log once that every topic has a subscriber."""
        if not self._connected and self._publishers and not self.unheard:
            self._connected = True
            self._node.get_logger().info("connected: every topic has a subscriber")

    def close(self) -> None:
        """Destroy the publishers. What was published is lost with them, as long as a reader has not taken it."""
        deadline = time.monotonic() + _LAST
        for topic, publisher in self._publishers.items():
            if self.published[topic]:
                publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)
        self._publishers.clear()
