"""Cars that back up, by the kinematics of a car that does not slip; no model of ours drives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray

from drives import FIX, IMU, SECOND, STEERING, VELOCITY, WHEELS, feed, messages, seconds
from vsense_ros.evaluate import faults
from vsense_ros.evaluate.faults import ACCELEROMETER, GYRO, Fault
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner

Array = NDArray[np.float64]
PLACE = 48.0, 11.0, 500.0
# Times [s], speeds [m/s] and angles of the road wheels [rad]: ahead through a bend, a stop, and back through one.
TIMES = (0.0, 2.0, 5.0, 9.0, 11.0, 13.0, 15.5, 40.0)
SPEEDS = (0.0, 0.0, 6.0, 6.0, 0.0, 0.0, -4.0, -4.0)
TURNING = (0.0, 5.0, 6.0, 8.0, 9.0, 15.0, 16.0, 40.0)
ANGLES = (0.0, 0.0, 0.12, 0.12, 0.0, 0.0, 0.2, 0.2)


def backing_up(vehicle: Vehicle, like: Recording, *, signed: bool) -> tuple[Recording, Array]:
    """The drive as the sensors of a recording would have measured it, with little noise, and its headings (n,) at
    1 kHz [rad]; wheel speeds have a sign or not."""
    numbers, physics = car_numbers(vehicle), vehicle.physics
    to_rear, length = numbers["to_rear"], numbers["to_rear"] + numbers["to_front"]
    t = np.arange(0.0, TIMES[-1], 1e-3)
    speed, angle = np.interp(t, TIMES, SPEEDS), np.interp(t, TURNING, ANGLES)
    rate = speed * np.tan(angle) / length
    yaw = np.cumsum(rate) * 1e-3
    across = rate * to_rear
    velocity = np.stack([speed * np.cos(yaw) - across * np.sin(yaw), speed * np.sin(yaw) + across * np.cos(yaw)])
    way = np.cumsum(velocity, axis=1) * 1e-3
    felt = np.stack([np.gradient(speed, t) - rate * across, np.gradient(across, t) + rate * speed])
    nothing = np.zeros_like(t)
    half = np.array([-1.0, 1.0, -1.0, 1.0])[:, None] * 0.5 * physics.rear.track
    radii = np.array([[axle.unloaded_radius] for axle in (physics.front, physics.rear)])
    rolled = (speed + rate * half) / radii.repeat(2, axis=0)
    latitude, longitude, _ = pymap3d.enu2geodetic(*way, nothing, *PLACE)
    measured: Mapping[str, Mapping[str, Array]] = {
        IMU: {GYRO: np.stack([nothing, nothing, rate]), ACCELEROMETER: np.stack([*felt, nothing + 9.81])},
        WHEELS: {"velocity": rolled if signed else np.abs(rolled)},
        STEERING: {"position": angle[None] * physics.steering.ratio},
        FIX: {"latitude": latitude[None], "longitude": longitude[None], "altitude": nothing[None] + PLACE[2]},
        VELOCITY: {"linear": np.stack([*velocity, nothing])},
    }
    rng = np.random.default_rng(7)
    noise = {GYRO: 0.002, ACCELEROMETER: 0.05, "velocity": 0.05, "position": 0.002, "linear": 0.05}
    channels: dict[str, Channel] = {}
    for topic, columns in measured.items():
        channel = like[topic]
        every = int(np.median(np.diff(channel.stamp)))
        count = int(TIMES[-1] * SECOND / every)
        stamp = channel.stamp[0] + every * np.arange(count)
        at = (stamp - like.start) / SECOND
        whole = {name: np.repeat(values[:1], count, axis=0) for name, values in channel.columns.items()}
        for name, values in columns.items():
            read = np.stack([np.interp(at, t, one) for one in values], axis=1)
            whole[name] = read + noise.get(name, 0.0) * rng.standard_normal(read.shape)
        late = channel.received[0] - channel.stamp[0]
        channels[topic] = replace(channel, stamp=stamp, received=stamp + late, columns=whole)
    return Recording(channels), yaw


def heading_error(runner: Runner, yaw: Array) -> float:
    """By how much the heading is wrong in the end [deg]."""
    return abs((np.degrees(runner.adapter.heading - yaw[-1]) + 180.0) % 360.0 - 180.0)


@pytest.mark.parametrize("gnss", [np.inf, 11.5])
@pytest.mark.parametrize("signed", [True, False])
def test_a_car_that_backs_up_keeps_its_heading_and_its_speed_with_wheel_speeds_of_a_sign_or_without(
    vehicle: Vehicle, lane_change: Recording, signed: bool, gnss: float
) -> None:
    drive, yaw = backing_up(vehicle, lane_change, signed=signed)
    stream = (s for s in messages(drive) if s.topic not in (FIX, VELOCITY) or seconds(drive, s) < gnss)
    runner = feed(Runner(vehicle, PLACE), stream)
    assert runner.adapter.forward_speed == pytest.approx(SPEEDS[-1], abs=0.2)
    assert heading_error(runner, yaw) < 5.0


@pytest.mark.parametrize(
    ("field", "axis", "size"), [(GYRO, 2, -0.8), (GYRO, 2, 0.8), (ACCELEROMETER, 1, -6.0), (ACCELEROMETER, 1, 6.0)]
)
def test_a_car_is_not_turned_around_by_an_inertial_axis_that_is_wrong(
    vehicle: Vehicle, lane_change: Recording, field: str, axis: int, size: float
) -> None:
    drive, yaw = backing_up(vehicle, lane_change, signed=True)
    drive = Fault("", (IMU,), faults.added(field, (axis,), size), 18.0, np.inf).of(drive)
    runner = feed(Runner(vehicle, PLACE), messages(drive))
    assert runner.adapter.forward_speed == pytest.approx(SPEEDS[-1], abs=0.2)
    assert heading_error(runner, yaw) < 5.0
