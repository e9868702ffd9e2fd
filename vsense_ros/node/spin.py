"""One executor per process, and a clean end of it."""

from __future__ import annotations

import signal
import socket
import threading
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before 7.1.3
    EventsExecutor = None

_FOREVER = 1e8  # [s]


def init(args: list[str]) -> None:
    """`rclpy.init` that leaves signals to `Stop`, whose end of a process includes the node's own."""
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


class Stop:
    """The end of spinning: asked for by SIGINT, by SIGTERM or by the program, from any thread.

    A Python signal handler only runs when the main thread gets back to Python, which an idle executor does not. The
    interpreter's wake-up descriptor is written at once, so a thread waits there.
    """

    def __init__(self) -> None:
        self.future: Future = Future()
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: None)
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._wait, name="signals", daemon=True).start()

    def _wait(self) -> None:
        while data := self._reader.recv(16):
            if any(number in (signal.SIGINT, signal.SIGTERM) for number in data):
                self()

    def __call__(self) -> None:
        """Ask for the end."""
        if not self.future.done():
            self.future.set_result(None)


def spin(node: Node, stop: Stop) -> None:
    """Run the callbacks of `node` until `stop`.

    `EventsExecutor.spin()` never calls anything in the PyPI wheels of Jazzy, and every call of
    `spin_until_future_complete` leaves a task behind: hence the one call here, with a future for the end.
    """
    executor: Any = EventsExecutor() if EventsExecutor is not None else SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin_until_future_complete(stop.future, timeout_sec=_FOREVER)
    finally:
        executor.remove_node(node)
