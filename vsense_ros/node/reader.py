"""Subscriptions that lose nothing where the publisher does not either."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# Nothing good is lost: a reader may fall this many messages behind (a second or more) before the oldest go.
_DEPTH = 4000
LOSSLESS = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=_DEPTH)
LATCHED = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
_BEST_EFFORT = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=_DEPTH)


class Reader:
    """A subscription that is reliable until a publisher appears that is not, as those of many sensors and of `/clock`.

    A reliable subscription hears nothing of a publisher that offers best effort alone; BEST_AVAILABLE asks only once,
    when it is made, who publishes.
    """

    def __init__(
        self,
        node: Node,
        message: type,
        topic: str,
        receive: Callable[[Any], None],
        *,
        raw: bool = False,
        latched: bool = False,
        made_anew: Callable[[], None] = lambda: None,
    ) -> None:
        """`receive` is called with each message, or with its bytes if it is wanted `raw`; of a `latched` topic also
        with what was published before; `made_anew` once it is best effort."""
        self._made_anew = made_anew
        self._node, self._message, self.topic, self._receive, self._raw = node, message, topic, receive, raw
        self._subscription: Any = None
        self._subscribe(LATCHED if latched else LOSSLESS)

    def _subscribe(self, qos: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible)
        self._subscription = self._node.create_subscription(
            self._message, self.topic, self._receive, qos, event_callbacks=events, raw=self._raw
        )

    def _on_incompatible(self, _: Any) -> None:
        # In a task of its own: this is a callback of the subscription that has to go.
        self._node.executor.create_task(self._ask_for_less)

    def _ask_for_less(self) -> None:
        if self._subscription is not None:
            self.close()
            self._subscribe(_BEST_EFFORT)
            self._made_anew()
            self._node.get_logger().info(f"{self.topic}: a publisher offers best effort; messages may be lost")

    def close(self) -> None:
        """End it."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
