"""Mistakes that people make in vehicle files, planted into files that have none."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle

GENERATED = {
    "golf": {"mass": 1395.0, "wheelbase": 2.63, "track": 1.54, "axle_load_front": 820.0, "tyre": "205/55R16 91V"},
    "van": {"mass": 2300.0, "wheelbase": 3.0, "track": 1.63, "axle_load_front": 1250.0, "tyre": "215/65R16C 109",
            "like": "van"},
    "racer": {"mass": 280.0, "wheelbase": 1.55, "track": 1.2, "axle_load_front": 135.0, "tyre": "16x7.5-10",
              "driven": "rear", "like": "formula-student"},
}  # fmt: skip


@cache
def _content(name: str) -> str:
    car = (
        new_vehicle(catalogue_values(**GENERATED[name])).vehicle
        if name in GENERATED
        else load_vehicle(vehicle_path(name))
    )
    return car.model_dump_json(exclude_unset=True)


def content(name: str) -> Any:
    """The content of a shipped vehicle file, or of a generated one, to be changed."""
    return json.loads(_content(name))


def _at(tree: Any, path: str) -> tuple[Any, Any]:
    *parents, last = path.split(".")
    for key in parents:
        tree = tree[int(key)] if isinstance(tree, list) else tree[key]
    return tree, int(last) if isinstance(tree, list) else last


def times(factor: float, *paths: str) -> Callable[[Any], None]:
    def plant(tree: Any) -> None:
        for path in paths:
            node, last = _at(tree, path)
            node[last] = [v * factor for v in node[last]] if isinstance(node[last], list) else node[last] * factor

    return plant


def put(value: Any, *paths: str) -> Callable[[Any], None]:
    def plant(tree: Any) -> None:
        for path in paths:
            node, last = _at(tree, path)
            node[last] = value

    return plant


def swap(one: str, other: str) -> Callable[[Any], None]:
    def plant(tree: Any) -> None:
        (a, i), (b, k) = _at(tree, one), _at(tree, other)
        a[i], b[k] = b[k], a[i]

    return plant


C, F, R = "physics.chassis.", "physics.front.", "physics.rear."
ARMS = swap(f"{C}cog_to_front_axle", f"{C}cog_to_rear_axle")
NOMINAL = f"{F}tyre.nominal_load", f"{R}tyre.nominal_load"
SLOPES = [f"{axle}tyre.lateral.{load}.initial_slope" for axle in (F, R) for load in ("nominal", "double")]
FORCES = [
    f"{axle}tyre.{way}.{load}.{name}" for axle in (F, R) for way in ("lateral", "longitudinal")
    for load in ("nominal", "double") for name in ("initial_slope", "maximum", "sliding")
]  # fmt: skip
# What was done, to which car, and a key that has to be named.
PLANTED: list[tuple[str, str, Callable[[Any], None], str]] = [
    ("axle distances exchanged, RAV4", "rav4", ARMS, "cog_to_front_axle"),
    ("axle distances exchanged, Golf", "golf", ARMS, "cog_to_front_axle"),
    ("axle distances exchanged, Jaguar", "jaguar_saloon", ARMS,
     "cog_to_front_axle"),
    ("mass in pounds", "golf", times(2.2046, f"{C}mass"), "chassis.mass"),
    ("mass in newtons", "genesis", times(9.80665, f"{C}mass"), "chassis.mass"),
    ("mass in tonnes", "rav4", times(1e-3, f"{C}mass"), "mass"),
    ("roll and yaw inertia exchanged", "genesis", swap(f"{C}roll_inertia", f"{C}yaw_inertia"), "yaw_inertia"),
    ("inertias in slug ft²", "jaguar_saloon", times(1 / 1.3558, f"{C}yaw_inertia"), "yaw_inertia"),
    ("yaw inertia in lb ft²", "golf", times(23.73, f"{C}yaw_inertia"), "yaw_inertia"),
    ("half the track", "rav4", times(0.5, f"{F}track", f"{R}track"), "track"),
    ("height of the centre of gravity in dm", "prototype_model", times(10.0, f"{C}cog_height"), "cog_height"),
    ("diameter for radius", "golf", times(2.0, f"{F}unloaded_radius", f"{R}unloaded_radius"), "unloaded_radius"),
    ("diameter for radius, one axle", "genesis", times(2.0, f"{R}unloaded_radius"), "rear.unloaded_radius"),
    ("springs in N/mm", "golf", times(1e-3, f"{F}suspension_stiffness", f"{R}suspension_stiffness"),
     "suspension_stiffness"),
    ("dampers in N s/mm", "rav4", times(1e-3, f"{F}suspension_damping", f"{R}suspension_damping"),
     "suspension_damping"),
    ("tyre stiffness in N/mm", "jaguar_saloon", times(1e-3, f"{F}tyre_stiffness", f"{R}tyre_stiffness"),
     "tyre_stiffness"),
    ("tyre stiffness in N/cm", "golf", times(1e-2, f"{F}tyre_stiffness", f"{R}tyre_stiffness"), "tyre_stiffness"),
    ("cornering stiffness in N/deg", "golf", times(0.0174533, *SLOPES), "tyre"),
    ("forces in kN", "genesis", times(1e-3, *FORCES), "tyre"),
    ("nominal load in kg", "rav4", times(1 / 9.80665, *NOMINAL), "nominal_load"),
    ("hub mass in grams", "golf", times(1e3, f"{F}hub_mass", f"{R}hub_mass"), "hub"),
    ("hub mass of an axle in newtons", "genesis", times(9.80665, f"{F}hub_mass", f"{R}hub_mass"), "hub"),
    ("wheel inertia in kg dm²", "van", times(1e2, f"{F}wheel_spin_inertia", f"{R}wheel_spin_inertia"), "wheel"),
    ("spin and diametral inertia exchanged", "racer", swap(f"{F}wheel_spin_inertia", f"{F}wheel_diametral_inertia"),
     "front.wheel"),
    ("tyres of the axles exchanged", "genesis", swap(f"{F}tyre", f"{R}tyre"), "tyre"),
    ("mounting in degrees", "rav4", put([0.7, 4.2, 0.0], "sensors.imu.attitude"), "imu.attitude"),
    ("mounting in degrees, a little", "golf", put([0.0, -1.9, 0.0], "sensors.imu.attitude"), "imu.attitude"),
    ("places with z down", "golf", times(-1.0, "sensors.position.position", "sensors.velocity.position"), "position"),
    ("place in cm", "rav4", put([60.0, 0.0, 30.0], "sensors.imu.position"), "imu.position"),
    ("latency in ms", "genesis", put(30.0, "sensors.imu.latency"), "imu.latency"),
    ("latency in hundredths", "jaguar_saloon", put(3.0, "sensors.imu.latency"), "imu.latency"),
    ("gyro noise in deg/s", "golf", put([0.3, 0.3, 0.3], "sensors.imu.rate_noise"), "imu.rate_noise"),
    ("gravity as an offset", "rav4", put([0.0, 0.0, 9.81], "sensors.imu.force_offset"), "imu.force_offset"),
    ("gyro offset in deg/s", "genesis", put([0.0, 0.0, 0.4], "sensors.imu.rate_offset"), "imu.rate_offset"),
    ("steering ratio inverted", "golf", put(1 / 15.2, "physics.steering.ratio"), "steering.ratio"),
    ("steering gain in degrees", "genesis", times(0.0174533, "sensors.steering.gain"), "steering.gain"),
    ("friction in per cent", "jaguar_saloon", put(80.0, "physics.road.friction"), "friction"),
    ("rolling resistance in per cent", "van", put(1.0, f"{F}rolling_resistance", f"{R}rolling_resistance"),
     "rolling_resistance"),
    ("rolling resistance in per cent, small tyre", "racer", put(0.12, f"{F}rolling_resistance"), "rolling_resistance"),
    ("bank of the road in degrees", "rav4", put(1.5, "observer.surroundings.bank"), "bank"),
    ("steering offset in degrees", "golf", put(0.3, "observer.surroundings.steering_offset"), "steering_offset"),
    ("radius error in per cent", "genesis", put(1.5, "observer.surroundings.radius_error"), "radius_error"),
    ("drag area in square feet", "golf", times(10.764, "physics.aerodynamics.drag_area"), "drag_area"),
]  # fmt: skip
