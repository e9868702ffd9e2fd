"""How long a system takes on its way to the accelerator's node and back."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import rclpy
from numpy.typing import NDArray

from vsense_ros.accelerator.client import Client
from vsense_ros.node.accelerator_link import TopicLink
from vsense_ros.node.processes import NodeProcess, free_domain, ros_environment

RATE, REQUESTS = 250, 1500


def through_topics(backend: str, progress: Callable[[float], None]) -> NDArray[np.float64]:
    """Times [ms] of solutions of 14 × 14 systems through the topics of the accelerator's node, at 250 Hz."""
    domain = free_domain()
    with NodeProcess("accelerator", {"backend": backend, "kernels": ["solve14"]}, ros_environment(domain)) as node:
        node.wait_until_active()
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        owner = rclpy.create_node("asking", context=context)
        link = TopicLink(owner)
        client = Client(link, deadline=1.0)
        random = np.random.default_rng(2)
        matrix = np.eye(14) * 10 + random.standard_normal((14, 14))
        times = []
        while not client.counts["accelerated"]:  # until both have found each other
            client.solve(matrix, np.ones(14))
        begun = time.perf_counter()
        for i in range(REQUESTS):
            time.sleep(max(0.0, begun + i / RATE - time.perf_counter()))
            began = time.perf_counter()
            client.solve(matrix, random.standard_normal(14))
            times.append(1e3 * (time.perf_counter() - began))
            if i % 50 == 0:
                progress(i / REQUESTS)
        link.close()
        owner.destroy_node()
        rclpy.shutdown(context=context)
    return np.array(times)
