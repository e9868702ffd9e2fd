"""Timers that do not depend on a replay."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def steady_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """A timer [s] that also runs before a replay has begun to publish `/clock`, and while it pauses."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
