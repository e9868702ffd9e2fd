"""Message types by name. Messages themselves travel as CDR bytes, which `vsense_ros.messages.cdr` turns into samples.

rclpy publishes bytes as they are and hands them over to raw subscriptions, so that a sample meets no message object on
its way: converting one field by field costs some 30 µs, its bytes a third of that.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from vsense_ros.errors import InputError


@cache
def message_type(kind: str) -> Any:
    """The class of `package/msg/Name`; `InputError` if it is not installed."""
    package, _, name = kind.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError):
        raise InputError(f"message type {kind!r} is not installed; expected such as 'sensor_msgs/msg/Imu'") from None
