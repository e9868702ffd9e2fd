"""The observer's link to an accelerator over topics."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, UInt8MultiArray

from vsense_ros.accelerator.frame import LABEL, FrameError, parse
from vsense_ros.accelerator.kernels import BY_NUMBER

REQUEST, RESPONSE = "accelerator/request", "accelerator/response"
_NEWEST = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=16)


def as_message(data: bytes) -> UInt8MultiArray:
    """A frame as a message, whose label says what it is."""
    try:
        name = BY_NUMBER[parse(data).kernel].name
    except (FrameError, KeyError):
        name = "unknown"
    layout = MultiArrayLayout(dim=[MultiArrayDimension(label=f"{LABEL} {name}", size=len(data), stride=len(data))])
    return UInt8MultiArray(layout=layout, data=data)


def as_bytes(message: UInt8MultiArray) -> bytes:
    """The frame of a message."""
    return bytes(message.data)


class TopicLink:
    """A `Transport` of `accelerator.client` over topics, with a node and an executor of its own: the observer's node
    waits within one of its callbacks, where its own executor cannot turn."""

    def __init__(self, owner: Node) -> None:
        context = owner.context
        self._node = rclpy.create_node(
            f"{owner.get_name()}_accelerator_link", namespace=owner.get_namespace(), context=context,
            use_global_arguments=False,
        )  # fmt: skip
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._came: list[bytes] = []
        self._closed = False
        self._publisher = self._node.create_publisher(UInt8MultiArray, REQUEST, _NEWEST)
        self._node.create_subscription(UInt8MultiArray, RESPONSE, lambda m: self._came.append(as_bytes(m)), _NEWEST)

    def now(self) -> float:
        return time.monotonic()

    def exchange(self, data: bytes, deadline: float, wanted: Callable[[bytes], bool]) -> list[bytes]:
        seen: list[bytes] = []
        if self._closed:  # the last steps, when the node has ended: those are the processor's
            return seen
        self._publisher.publish(as_message(data))
        while True:
            while self._came:
                answer = self._came.pop(0)
                seen.append(answer)
                if wanted(answer):
                    return seen
            left = deadline - time.monotonic()
            if left <= 0:
                return seen
            self._executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        self._closed = True
        self._executor.remove_node(self._node)
        self._node.destroy_node()
