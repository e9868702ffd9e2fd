"""The services of rosbag2's player and recorder, under their names and types.

Where rosbag2_interfaces is not installed, as with the wheels of PyPI, types of the same layout stand in for its own.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64, UInt64
from std_srvs.srv import Empty

from vsense_ros.node.raw_type import service_like

_NOTHING = ("", None, "")
_SUCCESS = ("success", Bool, "data")
# By service: name of the field in request and response, the type that has the same layout, and its field's name.
_SERVICES: dict[str, tuple[tuple[str, Any, str], tuple[str, Any, str]]] = {
    "Pause": (_NOTHING, _NOTHING),
    "Resume": (_NOTHING, _NOTHING),
    "TogglePaused": (_NOTHING, _NOTHING),
    "Stop": (_NOTHING, _NOTHING),
    "SplitBagfile": (_NOTHING, _NOTHING),
    "IsPaused": (_NOTHING, ("paused", Bool, "data")),
    "GetRate": (_NOTHING, ("rate", Float64, "data")),
    "SetRate": (("rate", Float64, "data"), _SUCCESS),
    "PlayNext": (_NOTHING, _SUCCESS),
    "Burst": (("num_messages", UInt64, "data"), ("actually_burst", UInt64, "data")),
    "Seek": (("time", Clock, "clock"), _SUCCESS),
    "Snapshot": (_NOTHING, _SUCCESS),
}


def service_type(name: str) -> tuple[Any, str, str]:
    """The type of a service, and what the one field of its request and of its response is called, empty for none."""
    (asked, like_request, asked_here), (answered, like_response, answered_here) = _SERVICES[name]
    try:
        return getattr(import_module("rosbag2_interfaces.srv"), name), asked, answered
    except (ImportError, AttributeError):
        request = Empty.Request if like_request is None else like_request
        response = Empty.Response if like_response is None else like_response
        return service_like(f"rosbag2_interfaces/srv/{name}", request, response), asked_here, answered_here


def offer(node: Node, name: str, type_name: str, answer: Callable[..., Any]) -> Any:
    """Serve `~/name`: `answer` is called with the value of the request, if it has one, and gives that of the response,
    if that has one."""
    kind, asked, answered = service_type(type_name)

    def respond(request: Any, response: Any) -> Any:
        value = answer(getattr(request, asked)) if asked else answer()
        if answered:
            setattr(response, answered, value)
        return response

    return node.create_service(kind, f"~/{name}", respond)


def nanoseconds(time: Time) -> int:
    """A time of ROS [ns]."""
    return time.sec * 1_000_000_000 + time.nanosec
