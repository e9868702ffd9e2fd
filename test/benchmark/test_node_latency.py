"""From a sensor's stamp to `vsense/odometry`, across two processes at 250 Hz.

The observer runs as its own process. Each round stamps and publishes an IMU message (every third with wheel speeds and
steering, every 25th with GNSS) on the grid of 4 ms, and ends when the estimate made of it has arrived here.
"""

from __future__ import annotations

import os
import threading
import time
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
from rclpy.qos import QoSProfile
from rclpy.task import Future

from vsense_ros.driver import samples
from vsense_ros.messages import cdr
from vsense_ros.messages.recording import Sample
from vsense_ros.node.convert import message_type
from vsense_ros.node.processes import NodeProcess, free_domain, ros_environment
from vsense_ros.node.spin import EventsExecutor

PERIOD = 0.004  # [s]
ROUNDS = 5000
SPEED = 20.0  # [m/s] straight ahead, to the east
WHEELS = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")


def measurements(count: int, stamp: int) -> list[Sample]:
    """What the sensors of a car at constant speed say; the IMU last."""
    due: list[Sample] = []
    if count % 25 == 0:
        fix = {"latitude": 48.0, "longitude": 11.0 + count * PERIOD * SPEED / 74_600, "altitude": 500.0}
        values = {name: np.array([value]) for name, value in fix.items()}
        values |= {name: np.array([1.0]) for name in ("status", "service", "position_covariance_type")}
        values["position_covariance"] = samples.diagonal([1.0, 1.0, 2.0])
        due.append(Sample("gps/fix", "sensor_msgs/msg/NavSatFix", stamp, values, "gnss_link"))
        twist = {"linear": np.array([SPEED, 0.0, 0.0]), "angular": np.zeros(3), "covariance": np.zeros(36)}
        kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
        due.append(Sample("gps/velocity", kind, stamp, twist, "map"))
    if count % 3 == 0:
        wheels = dict.fromkeys(WHEELS, SPEED / 0.35)
        due.append(samples.joint_state("vehicle/wheel_speeds", stamp, "velocity", wheels))
        due.append(samples.joint_state("vehicle/steering", stamp, "position", {"steering_wheel": 0.0}))
    noise = 1e-3 * np.random.default_rng(count).normal(size=6)
    due.append(
        samples.imu(
            "imu/data",
            stamp,
            "imu_link",
            angular_velocity=noise[:3],
            angular_velocity_covariance=samples.diagonal([1e-5] * 3),
            linear_acceleration=np.array([0.0, 0.0, 9.81]) + noise[3:],
            linear_acceleration_covariance=samples.diagonal([1e-2] * 3),
        )
    )
    return due


@pytest.mark.benchmark(group="through ROS", min_rounds=1)
def test_sensor_stamp_to_odometry_at_250_hz(benchmark: Any) -> None:
    environment = ros_environment(free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("bench", context=context)
    arrived = threading.Event()
    node.create_subscription(
        message_type("nav_msgs/msg/Odometry"), "vsense/odometry", lambda _: arrived.set(), 100, raw=True
    )
    publishers = {
        s.topic: node.create_publisher(message_type(s.kind), s.topic, QoSProfile(depth=100)) for s in measurements(0, 0)
    }
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    end: Future = Future()
    spinning = threading.Thread(target=executor.spin_until_future_complete, args=(end, 1e8))
    with NodeProcess("observer", {"vehicle": "rav4"}, environment) as observer:
        observer.wait_until_active()
        spinning.start()
        while any(publisher.get_subscription_count() == 0 for publisher in publishers.values()):
            time.sleep(0.05)
        began = time.perf_counter()
        sent = missed = 0

        def wait_for_the_next_tick() -> None:
            nonlocal sent
            sent += 1
            # A tick that was missed is left out, as a sensor would: two at once are not what is asked about.
            time.sleep(PERIOD - (time.perf_counter() - began) % PERIOD)

        def measure() -> None:
            nonlocal missed
            arrived.clear()
            stamp = time.time_ns()
            for sample in measurements(sent, stamp):
                publishers[sample.topic].publish(cdr.encode(sample))
            missed += not arrived.wait(0.1)

        for _ in range(500):  # until the observer has started and settled
            wait_for_the_next_tick()
            measure()
        missed = 0
        benchmark.pedantic(measure, setup=wait_for_the_next_tick, rounds=ROUNDS, iterations=1)
    end.set_result(None)
    spinning.join()
    node.destroy_node()
    rclpy.shutdown(context=context)
    assert missed < ROUNDS // 100
    latencies = np.array(benchmark.stats.stats.data)
    for q in (50, 90, 99, 99.9):
        benchmark.extra_info[f"p{q:g}_ms"] = round(float(np.percentile(latencies, q)) * 1e3, 3)
    benchmark.extra_info["missed"] = missed
    print(benchmark.extra_info)
