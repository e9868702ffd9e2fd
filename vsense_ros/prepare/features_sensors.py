"""Figures of the sensors and of the observer's settings: places, tilts, noise levels, latencies."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

from vsense_ros.model.sensors import Imu
from vsense_ros.model.sensors.base import SensorBase
from vsense_ros.model.sensors.gnss import Antenna
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.features import Feature

_NOISE = {"wheel_speeds": "wheel_noise", "gnss_position": "position_noise", "gnss_velocity": "velocity_noise"}


def of_sensors(car: Vehicle) -> Iterator[Feature]:
    """Where sensors are, how they lean, how late and how noisy they are."""
    for name, sensor in car.sensors.items():
        prefix = f"sensors.{name}."
        yield Feature("latency", sensor.latency, (f"{prefix}latency",), name)
        if isinstance(sensor, Imu | Antenna):
            yield from _place(car, name, sensor, sensor.position)
        if isinstance(sensor, Imu):
            yield from _inertial(name, sensor)
        if sensor.kind in _NOISE and (noise := getattr(sensor, "noise", None)) is not None:
            yield Feature(_NOISE[sensor.kind], noise, (f"{prefix}noise",), name)


def _place(car: Vehicle, name: str, sensor: SensorBase, position: tuple[float, float, float]) -> Iterator[Feature]:
    chassis, key = car.physics.chassis, (f"sensors.{name}.position",)
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    yield Feature("place_along", position[0] / wheelbase, key, name)
    yield Feature("place_beside", position[1] / car.physics.front.track, key, name)
    yield Feature("place_over_road", position[2] + chassis.cog_height, key, name)
    if isinstance(sensor, Antenna):
        yield Feature("antenna_over_cog", position[2], key, name)


def _inertial(name: str, sensor: Imu) -> Iterator[Feature]:
    prefix = f"sensors.{name}."
    for angle in sensor.attitude[:2]:
        yield Feature("tilt", beside_quarter_turns(angle), (f"{prefix}attitude",), name)
    for figure, values in (
        ("gyro_noise", sensor.rate_noise),
        ("force_noise", sensor.force_noise),
        ("gyro_offset", sensor.rate_offset),
        ("force_offset", sensor.force_offset),
    ):
        field = figure.replace("gyro", "rate")
        for value in values:
            yield Feature(figure, value, (f"{prefix}{field}",), name)


def beside_quarter_turns(angle: float) -> float:
    """What an angle [rad] is beside the quarter turn that somebody wrote with three digits; else the angle itself."""
    remainder = angle - round(angle / (pi / 2)) * pi / 2
    return remainder if abs(remainder) < 2e-3 else angle


def of_observer(car: Vehicle) -> Iterator[Feature]:
    """Settings of the observer that are angles or shares."""
    around, prefix = car.observer.surroundings, "observer.surroundings."
    for field in ("grade", "bank"):
        yield Feature("road_slope", getattr(around, field), (f"{prefix}{field}",), field)
    yield Feature("offset_of_steering", around.steering_offset, (f"{prefix}steering_offset",))
    yield Feature("error_of_radius", around.radius_error, (f"{prefix}radius_error",))
    yield Feature("load_share", around.load / car.physics.chassis.mass, (f"{prefix}load", "physics.chassis.mass"))
