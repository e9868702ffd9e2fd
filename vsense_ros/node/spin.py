"""One executor per process, and a clean end of it."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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


@dataclass(frozen=True)
class SpinSettings:
    """How long a node waits at its end: decisions of this project."""

    forever: float = 1e8  # [s]
    grace: float = 1.5  # [s] for a job that is interrupted to come to an end
    last: float = 1.0  # [s] for what has arrived before the end was asked for


SETTINGS = SpinSettings()

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stopped(BaseException):
    """The end of the process was asked for in the middle of a long job."""


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
        self._asked = False
        self._in_long_job = False
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        for number in _SIGNALS:
            signal.signal(number, self._on_signal)
        threading.Thread(target=self._wait, name="signals", daemon=True).start()

    def _on_signal(self, *_: object) -> None:
        self._asked = True
        if self._in_long_job:
            raise Stopped

    def _wait(self) -> None:
        while data := self._reader.recv(16):
            if any(number in _SIGNALS for number in data):
                self()
                if self._in_long_job:
                    threading.Thread(target=self._end_anyway, name="end anyway", daemon=True).start()

    def _end_anyway(self) -> None:
        """What has not come back from a library by now is left where it is; no file is half written by that, as files
        take their place when they are whole."""
        time.sleep(SETTINGS.grace)
        if self._in_long_job:
            os._exit(0)

    def __call__(self) -> None:
        """Ask for the end."""
        self._asked = True
        if not self.future.done():
            self.future.set_result(None)

    @contextmanager
    def long_job(self) -> Iterator[None]:
        """Within, a signal raises `Stopped` in the main thread; also one that came just before."""
        self._in_long_job = True
        try:
            if self._asked:
                raise Stopped
            yield
        finally:
            self._in_long_job = False


def spin(nodes: Sequence[Node], stop: Stop) -> None:
    """Run the callbacks of `nodes` in order of arrival until `stop`, and those of messages that have arrived by then.

    `EventsExecutor.spin()` never calls anything in the PyPI wheels of Jazzy, and every call of
    `spin_until_future_complete` leaves a task behind: hence the two calls here, with a future for the end.
    """
    executor: Any = EventsExecutor() if EventsExecutor is not None else SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    worked_off: Future = Future()
    try:
        executor.spin_until_future_complete(stop.future, timeout_sec=SETTINGS.forever)
        executor.create_task(worked_off.set_result, None)  # which queues up behind what waits
        executor.spin_until_future_complete(worked_off, timeout_sec=SETTINGS.last)
    finally:
        for node in nodes:
            executor.remove_node(node)
