"""The diagnostics of a node, once a second, with who publishes the time that it goes by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from vsense_ros.messages import cdr_messages
from vsense_ros.messages.diagnostic import Diagnostic, Level


class Health:
    """The publisher of the `statuses` of a node at the time `now` [ns]; `by_clock` is true while the node goes by
    `/clock`, or publishes it itself."""

    def __init__(
        self,
        node: Node,
        statuses: Callable[[], list[Diagnostic]],
        now: Callable[[], int],
        by_clock: Callable[[], bool],
    ) -> None:
        self._node, self._statuses, self._now, self._by_clock = node, statuses, now, by_clock
        self._publisher: Any = None

    @property
    def is_open(self) -> bool:
        """True if the node is configured."""
        return self._publisher is not None

    def open(self) -> None:
        """Announce the topic."""
        self._publisher = self._node.create_publisher(DiagnosticArray, "diagnostics", 10)

    def close(self) -> None:
        """Take the topic back, if it is announced."""
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
        self._publisher = None

    def publish(self) -> None:
        """Publish what the node says of itself now."""
        node, statuses = self._node, self._statuses()
        if statuses and self._publisher is not None:
            if len(clocks := self._clock_sources()) > 1:
                text = f"{len(clocks)} nodes publish {node.resolve_topic_name('/clock')}: {', '.join(clocks)}; stop one"
                statuses = [*statuses, Diagnostic("clock", Level.ERROR, text)]
            own = node.get_fully_qualified_name()
            statuses = [replace(status, name=f"{own}: {status.name}") for status in statuses]
            self._publisher.publish(cdr_messages.encode_diagnostics(self._now(), statuses, hardware_id=node.get_name()))

    def _clock_sources(self) -> list[str]:
        """Who publishes the time that the node goes by, or publishes itself; reported once where these are several."""
        if not self._by_clock():
            return []
        publishers = self._node.get_publishers_info_by_topic("/clock")
        publishing = [f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in publishers]
        if len(publishing) > 1:
            self._node.get_logger().error(
                f"{len(publishing)} nodes publish the time ({', '.join(publishing)}): it will jump to and fro; stop one"
                " of them",
                once=True,
            )
        return publishing
