"""Transforms, names, namespaces and diagnostics, as others hear them."""

from __future__ import annotations

import json
import time
from itertools import pairwise
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from vehicle.workshop import CAR, Workshop, check, transforms_in
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.urdf import urdf
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.node.convert import message_type
from vsense_ros.node.reader import LATCHED

TRANSFORMS = "tf2_msgs/msg/TFMessage"
Pose = tuple[np.ndarray, Rotation]


def hear_transforms(shop: Workshop, heard: list[Any], *, static: bool = False) -> None:
    qos, topic = (LATCHED, "/tf_static") if static else (QoSProfile(depth=4000), "/tf")
    kind = message_type(TRANSFORMS)
    shop.client.node.create_subscription(kind, topic, lambda d: heard.extend(transforms_in(d)), qos, raw=True)


def pose(numbers: tuple[float, ...]) -> Pose:
    return np.array(numbers[:3]), Rotation.from_quat(numbers[3:])


def chained(one: Pose, other: Pose) -> Pose:
    return one[0] + one[1].apply(other[0]), one[1] * other[1]


def driven(shop: Workshop, node: Any, *, seconds: float = 6.0, rate: float = 2.0, **more: Any) -> None:
    """Replay the beginning of the drive to nodes that are active, and hear it out."""
    node.wait_until_active()
    replay = shop.start("replay", bag=str(shop.drive(seconds)), rate=rate, consumers=1, wait=30.0, **more)
    shop.client.until(lambda: replay.exit_code is not None, 90.0)
    assert replay.exit_code == 0, replay.output
    shop.client.spin_for(0.5)


@check("transforms lead from the map to the car and its sensors, and agree with the odometry")
def transforms(shop: Workshop) -> str:
    moving: list[Any] = []
    static: list[Any] = []
    hear_transforms(shop, moving)
    hear_transforms(shop, static, static=True)
    odometry = shop.client.listen(Odometry, "vsense/odometry")
    described: list[String] = []
    shop.client.node.create_subscription(String, "robot_description", described.append, LATCHED)
    observer = shop.start("observer", vehicle=CAR, use_sim_time=True, frame_prefix="car/", map_frame="world")
    driven(shop, observer)
    fixed = {child: (parent, pose(numbers)) for parent, child, _, numbers in static}
    assert {"car/cog", "car/imu_link", "car/gnss_link"} <= set(fixed), set(fixed)
    to_odom = {stamp: pose(n) for parent, child, stamp, n in moving if (parent, child) == ("car/world", "car/odom")}
    to_base = {stamp: pose(n) for parent, child, stamp, n in moving if (parent, child) == ("car/odom", "car/base_link")}
    assert {child for _, child, _, _ in moving} >= {f"car/contact_{w}" for w in ("fl", "fr", "rl", "rr")}
    worst, count = 0.0, 0
    steps: list[tuple[float, float, float]] = []
    for message in odometry:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if stamp not in to_base:
            continue
        assert (message.header.frame_id, message.child_frame_id) == ("car/world", "car/cog")
        place, turned = chained(chained(to_odom[stamp], to_base[stamp]), fixed["car/cog"][1])
        p, q = message.pose.pose.position, message.pose.pose.orientation
        worst = max(worst, float(np.abs(place - [p.x, p.y, p.z]).max()))
        worst = max(worst, float((turned.inv() * Rotation.from_quat([q.x, q.y, q.z, q.w])).magnitude()))
        count += 1
    assert count > 100, f"only {count} estimates with a transform"
    assert worst < 1e-6, f"{worst} m or rad apart"
    stamps = sorted(to_base)
    speeds = {}
    for message in odometry:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        v = message.twist.twist.linear
        speeds[stamp] = float(np.hypot(v.x, v.y))
    for before, after in pairwise(stamps):
        moved = float(np.linalg.norm((to_base[after][0] - to_base[before][0])[:2]))
        if after in speeds:
            steps.append((abs(moved - 1e-9 * (after - before) * speeds[after]), 1e-9 * (after - before), moved))
    jump, gap, moved = max(steps)
    assert jump < 0.1, f"odom moves by {moved:.2f} m in {gap:.3f} s, {jump:.2f} m beside the velocity"
    assert described, "no robot_description"
    assert described[-1].data == urdf(load_vehicle(vehicle_path(CAR)), "car/")
    return f"{count} estimates within {worst:.1e} m or rad; odom within {jump:.3f} m of what the velocity says"


@check("a frame that the car does not have reaches no output, and the log says so once, with the remedy")
def frames(shop: Workshop) -> str:
    observer = shop.start("observer", vehicle=CAR)
    observer.wait_until_active()
    publisher = shop.client.node.create_publisher(Imu, "imu/data", 100)
    shop.client.until(lambda: publisher.get_subscription_count() > 0)
    for frame in ("livox_frame", "", "livox_frame", ""):
        for _ in range(50):
            message = Imu()
            message.header.frame_id = frame
            message.header.stamp = shop.client.node.get_clock().now().to_msg()
            publisher.publish(message)
        shop.client.spin_for(0.2)
    assert observer.stop() == 0
    for frame in ("'livox_frame'", "''"):
        lines = [line for line in observer.output.splitlines() if f"frame_id {frame} are refused" in line]
        assert len(lines) == 1, observer.output
        assert "expected 'imu_link': set it where they are published" in lines[0]
    return "200 messages, 2 lines"


@check("two cars in one domain keep to themselves: topics, clocks, frames, diagnostics, recordings")
def two_cars(shop: Workshop) -> str:
    statuses: list[Any] = []
    shop.client.node.create_subscription(
        DiagnosticArray, "diagnostics", lambda m: statuses.extend(m.status), QoSProfile(depth=1000)
    )
    moving: list[Any] = []
    hear_transforms(shop, moving)
    odometry = {car: shop.client.listen(Odometry, f"{car}/vsense/odometry") for car in ("car1", "car2")}
    observers, recorders, replays = {}, {}, {}
    for car in odometry:
        remap = {"diagnostics": "/diagnostics"}
        observers[car] = shop.start(
            "observer", namespace=car, vehicle=CAR, use_sim_time=True, frame_prefix=f"{car}/", remap=remap
        )
        recorders[car] = shop.start(
            "recorder", namespace=car, bag=str(shop.folder / car), use_sim_time=True, remap=remap
        )
    for node in (*observers.values(), *recorders.values()):
        node.wait_until_active()
    for car, seconds in (("car1", 4.0), ("car2", 6.0)):
        # The bags' times differ by nothing, the clocks by when each began.
        replays[car] = shop.start("replay", namespace=car, bag=str(shop.drive(seconds)), rate=1.0, consumers=2)
        shop.client.spin_for(1.0)
    for replay in replays.values():
        shop.client.until(lambda: replay.exit_code is not None, 60.0)  # noqa: B023
        assert replay.exit_code == 0, replay.output
    shop.client.spin_for(1.2)
    for car, messages in odometry.items():
        assert len(messages) > 100, car
        assert {m.header.frame_id for m in messages} == {f"{car}/map"}
        assert recorders[car].stop() == 0
        metadata = (shop.folder / car / "metadata.yaml").read_text()
        other = "car2" if car == "car1" else "car1"
        assert f"/{car}/vsense/odometry" in metadata
        assert f"/{other}/" not in metadata
    assert {child.partition("/")[0] for _, child, _, _ in moving} == {"car1", "car2"}
    names = {status.name for status in statuses}
    for car in odometry:
        assert f"/{car}/observer: observer" in names, names
        assert f"/{car}/observer: imu" in names, names
    assert not any(name.endswith(": clock") for name in names), "clocks are taken for two of one"
    return f"{sum(map(len, odometry.values()))} estimates, {len(names)} statuses"


@check("the observer's headline names a sensor that it needs and that is dead")
def headline(shop: Workshop) -> str:
    statuses: list[Any] = []
    shop.client.node.create_subscription(
        DiagnosticArray, "diagnostics", lambda m: statuses.extend(m.status), QoSProfile(depth=1000)
    )
    observer = shop.start("observer", vehicle=CAR, use_sim_time=True)
    topics = ["vehicle/steering", "vehicle/wheel_speeds", "gps/fix", "gps/velocity", "imu/data"]
    observer.wait_until_active()
    whole = shop.start("replay", bag=str(shop.drive(3.0)), topics=topics, rate=1.0, consumers=1)
    shop.client.until(lambda: whole.exit_code is not None, 60.0)
    # The same without the IMU, later in the recording.
    rest = shop.start(
        "replay", bag=str(shop.drive()), topics=topics[:-1], start_offset=3.0, duration=4.0, rate=1.0, consumers=1
    )
    shop.client.until(lambda: rest.exit_code is not None, 60.0)
    own = [s for s in statuses if s.name == "/observer: observer"]
    told = [s for s in own if "imu" in s.message and s.level != b"\x00"]
    assert told, sorted({s.message for s in own})
    return told[-1].message


@check("a respawned observer keeps its map, and one that does not says so")
def origin(shop: Workshop) -> str:
    file = shop.folder / "origin.json"
    places = []
    for round_ in range(2):
        heard: list[Any] = []
        subscription = shop.client.node.create_subscription(
            Odometry, "vsense/odometry", heard.append, QoSProfile(depth=4000)
        )
        observer = shop.start("observer", vehicle=CAR, use_sim_time=True, map_origin_file=str(file))
        observer.wait_until_active()
        # The second begins elsewhere on the way.
        replay = shop.start("replay", bag=str(shop.drive(6.0)), start_offset=2.0 * round_, rate=2.0, consumers=1)
        shop.client.until(lambda: replay.exit_code is not None, 60.0)  # noqa: B023
        shop.client.spin_for(0.3)
        p = heard[-1].pose.pose.position
        places.append(np.array([p.x, p.y]))
        observer.signal(9)
        observer.wait_until_ended(10.0)
        shop.client.node.destroy_subscription(subscription)
    assert set(json.loads(file.read_text())) == {"latitude_deg", "longitude_deg", "height_m"}
    apart = float(np.linalg.norm(places[1] - places[0]))
    assert apart < 2.0, f"the same place is {apart:.1f} m away after the respawn"
    observer = shop.start("observer", vehicle=CAR, use_sim_time=True)
    driven(shop, observer, seconds=3.0)
    assert "set map_origin, or map_origin_file" in observer.output
    return f"the same place within {apart:.2f} m"


@check("two sources of /clock are noticed")
def clocks(shop: Workshop) -> str:
    statuses: list[Any] = []
    shop.client.node.create_subscription(
        DiagnosticArray, "diagnostics", lambda m: statuses.extend(m.status), QoSProfile(depth=1000)
    )
    recorder = shop.start("recorder", bag=str(shop.folder / "bag"), use_sim_time=True)
    recorder.wait_until_active()
    shop.start("replay", name="first", bag=str(shop.drive(6.0)))
    shop.start("replay", name="second", bag=str(shop.drive(6.0)))
    began = time.monotonic()
    shop.client.until(lambda: any(s.name == "/recorder: clock" for s in statuses), 20.0)
    took = time.monotonic() - began
    (status, *_) = [s for s in statuses if s.name == "/recorder: clock"]
    assert "/first" in status.message
    assert "/second" in status.message
    return f"after {took:.1f} s, by name"
