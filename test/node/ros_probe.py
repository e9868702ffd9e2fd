"""A client in the tests' own process for services, parameters and messages of the nodes under test."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile


class Probe:
    """One node in its own context; spins only while it waits."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=int(environment["ROS_DOMAIN_ID"]))
        self.node = rclpy.create_node("probe", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def until(self, condition: Callable[[], bool], timeout: float = 15.0) -> None:
        """Spin until the condition holds; fails the test after `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, "timeout"
            self.executor.spin_once(timeout_sec=0.05)

    def spin_for(self, seconds: float) -> None:
        """Take what arrives in this time."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)

    def call(self, service_type: Any, name: str, request: Any, timeout: float = 15.0) -> Any:
        """The answer of a service."""
        client = self.node.create_client(service_type, name)
        self.until(client.service_is_ready, timeout)
        future = client.call_async(request)
        self.until(future.done, timeout)
        self.node.destroy_client(client)
        return future.result()

    def ask(self, service_type: Any, name: str, request: Any, times: int = 3) -> Any:
        """The answer of a service that changes nothing. It is asked again after 5 s: ROS 2 loses the answer where the
        server has not yet discovered who asks, although who asks has discovered the server."""
        for _ in range(times - 1):
            with suppress(AssertionError):
                return self.call(service_type, name, request, timeout=5.0)
        return self.call(service_type, name, request)

    def listen(self, message_type: Any, topic: str) -> list[Any]:
        """A list that grows with the messages of a topic while the probe spins."""
        heard: list[Any] = []
        self.node.create_subscription(message_type, topic, heard.append, QoSProfile(depth=1000))
        return heard


@contextmanager
def probe(environment: Mapping[str, str]) -> Iterator[Probe]:
    """A probe in the domain of an environment."""
    before = {key: os.environ.get(key) for key in ("ROS_AUTOMATIC_DISCOVERY_RANGE",)}
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    one = Probe(environment)
    try:
        yield one
    finally:
        one.node.destroy_node()
        rclpy.shutdown(context=one.context)
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
