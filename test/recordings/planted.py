"""Faults planted in generated drives, each in drives in which it can be seen.

A fault is named rightly where a finding about its topic has one of the kinds that it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from vsense_ros.checks.inspect import inspect
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Channel, Recording

IMU, WHEELS, STEERING = "imu/data", "vehicle/wheel_speeds", "vehicle/steering"
FIX, VELOCITY = "gps/fix", "gps/velocity"
Change = Callable[[Channel], Channel]

_TURNING = ("double_lane_change", "steering_sweep", "sine_with_dwell")
_CIRCLE = ("steady_state_circle", "slow_ramp_steer", "step_steer")
_BRAKING = ("brake_in_turn", "accelerate_and_brake")
_MIXED = ("brake_in_turn", *_TURNING)
_PLACE = ("latitude", "longitude")
_ANY = ("double_lane_change", "steady_state_circle", "accelerate_and_brake")


@cache
def drive(manoeuvre: str, vehicle: str, seed: int) -> Recording:
    """A generated drive."""
    return generate(manoeuvre, load_vehicle(vehicle_path(vehicle)), seed)


def changed(recording: Recording, topic: str, change: Change) -> Recording:
    """A recording with a fault in one topic."""
    return replace(recording, channels={**recording.channels, topic: change(recording[topic])})


def values(field: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """A fault in the values of one field."""
    return lambda c: replace(c, columns={**c.columns, field: change(c.columns[field].copy())})


def scaled(field: str, factor: float | tuple[float, ...]) -> Change:
    return values(field, lambda v: v * np.array(factor))


def both(*changes: Change) -> Change:
    def change(channel: Channel) -> Channel:
        for one in changes:
            channel = one(channel)
        return channel

    return change


def later(seconds: float) -> Change:
    shift = round(seconds * 1e9)
    return lambda c: replace(c, stamp=c.stamp + shift, received=c.received + shift)


def held(every: int) -> Change:
    """Values that are kept for some messages."""

    def change(channel: Channel) -> Channel:
        rows = np.arange(len(channel)) // every * every
        return replace(channel, columns={name: v[rows] for name, v in channel.columns.items()})

    return change


def repeated(times: int) -> Change:
    """As a table of a higher rate has them."""

    def change(channel: Channel) -> Channel:
        rows = np.repeat(np.arange(len(channel) - 1), times)
        step = np.repeat(np.diff(channel.stamp), times) // times * np.tile(np.arange(times), len(channel) - 1)
        found = channel.select(rows)
        return replace(found, stamp=found.stamp + step, received=found.received + step)

    return change


def jump(field: str, column: int, size: float, rows: int | None = 1) -> Change:
    """A jump in the middle, for some rows or to the end."""

    def change(v: np.ndarray) -> np.ndarray:
        middle = len(v) // 2
        v[middle : None if rows is None else middle + rows, column] += size
        return v

    return values(field, change)


def rounded(field: str, step: float) -> Change:
    return values(field, lambda v: np.round(v / step) * step)


def in_axes_of_car(channel: Channel) -> Channel:
    return values("linear", lambda v: np.column_stack([np.hypot(v[:, 0], v[:, 1]), 0 * v[:, 0], v[:, 2]]))(channel)


def north_east(channel: Channel) -> Channel:
    return values("linear", lambda v: v[:, [1, 0, 2]])(channel)


def exchanged_fix(channel: Channel) -> Channel:
    latitude, longitude = channel.columns["latitude"], channel.columns["longitude"]
    return replace(channel, columns={**channel.columns, "latitude": longitude, "longitude": latitude})


def quarter_turn(v: np.ndarray) -> np.ndarray:
    return v[:, [1, 0, 2]] * [1, -1, 1]


def fast_clock(channel: Channel) -> Channel:
    since = (channel.stamp - channel.stamp[0]) * 1.01
    return replace(channel, stamp=channel.stamp[0] + since.astype(np.int64))


def set_clock(channel: Channel) -> Channel:
    return replace(channel, stamp=channel.stamp + np.where(np.arange(len(channel)) > len(channel) // 2, 10**9, 0))


def twice(channel: Channel) -> Channel:
    return channel.select(np.sort(np.concatenate([np.arange(len(channel)), np.arange(0, len(channel), 7)])))


def stuck_wheel(channel: Channel) -> Channel:
    def change(v: np.ndarray) -> np.ndarray:
        v[len(v) // 3 :, 2] = v[len(v) // 3, 2]
        return v

    return values("velocity", change)(channel)


def stuck_steering(channel: Channel) -> Channel:
    def change(v: np.ndarray) -> np.ndarray:
        v[len(v) // 3 :] = v[len(v) // 3]
        return v

    return values("position", change)(channel)


@dataclass(frozen=True)
class Fault:
    """A fault: where it is, what it does, how it may be called, and in which manoeuvres it can be seen."""

    name: str
    topic: str
    change: Change
    kinds: tuple[str, ...]
    manoeuvres: tuple[str, ...]


_BOTH = ("angular_velocity", "linear_acceleration")
_LEFT, _RIGHT, _AXES = [1, 0, 2], [1, 0, 3, 2], ("axes",)
FAULTS = (
    Fault("sign of the lateral acceleration", IMU, scaled(_BOTH[1], (1, -1, 1)), ("sign", "axes"), _TURNING),
    Fault("sign of the longitudinal acceleration", IMU, scaled(_BOTH[1], (-1, 1, 1)), ("sign", "axes"), _BRAKING),
    Fault("sign of the yaw rate", IMU, scaled(_BOTH[0], -1.0), ("sign",), _CIRCLE),
    Fault("sign of the steering", STEERING, scaled("position", -1.0), ("sign",), _TURNING),
    Fault("sign of the wheel speeds", WHEELS, scaled("velocity", -1.0), ("sign",), _ANY),
    Fault("IMU turned by 180°", IMU, both(*(scaled(f, (-1, -1, 1)) for f in _BOTH)), ("axes", "sign"), _MIXED),
    Fault("IMU turned by 90°", IMU, both(*(values(f, quarter_turn) for f in _BOTH)), _AXES, _TURNING),
    Fault("x and y of the accelerometer exchanged", IMU, values(_BOTH[1], lambda v: v[:, _LEFT]), _AXES, _MIXED),
    Fault("IMU upside down", IMU, both(*(scaled(f, (1, -1, -1)) for f in _BOTH)), ("axes", "sign"), _ANY),
    Fault("wheels left and right exchanged", WHEELS, values("velocity", lambda v: v[:, _RIGHT]), _AXES, _CIRCLE),
    Fault("yaw rate in deg/s", IMU, scaled(_BOTH[0], 180 / np.pi), ("unit",), _TURNING),
    Fault("accelerations in g", IMU, scaled(_BOTH[1], 1 / 9.80665), ("unit",), _ANY),
    Fault("steering in degrees", STEERING, scaled("position", 180 / np.pi), ("unit",), _TURNING),
    Fault("GNSS velocity in km/h", VELOCITY, scaled("linear", 3.6), ("unit",), _ANY),
    Fault("one wheel 30 % too fast", WHEELS, values("velocity", lambda v: v * [1, 1, 1.3, 1]), ("unit",), _ANY),
    Fault("IMU 0.3 s late", IMU, later(0.3), ("lag",), _TURNING),
    Fault("GNSS velocity 0.5 s late", VELOCITY, later(0.5), ("lag",), _TURNING),
    Fault("steering 0.5 s late", STEERING, later(0.5), ("lag",), ("double_lane_change", "steering_sweep")),
    Fault("GNSS held in a table of 100 Hz", VELOCITY, repeated(10), ("held",), _ANY),
    Fault("IMU held for 5 messages", IMU, held(5), ("held",), _ANY),
    Fault("steering jumps by 0.5 rad", STEERING, jump("position", 0, 0.5), ("jump",), _TURNING),
    Fault("fix jumps by 20 m and stays", FIX, jump("latitude", 0, 20 / 111_200, None), ("jump",), _ANY),
    Fault("yaw rate in steps of 1 deg/s", IMU, rounded(_BOTH[0], np.radians(1.0)), ("quantised",), _TURNING),
    Fault("fix in steps of 1e-5 deg", FIX, both(*(rounded(f, 1e-5) for f in _PLACE)), ("quantised",), _ANY),
    Fault("the clock of the IMU 1 % fast", IMU, fast_clock, ("clock",), _ANY),
    Fault("the clock of the wheels set by 1 s", WHEELS, set_clock, ("clock",), _ANY),
    Fault("GNSS velocity in the axes of the car", VELOCITY, in_axes_of_car, ("frame",), _ANY[:2]),
    Fault("GNSS velocity north, east", VELOCITY, north_east, ("frame",), _ANY),
    Fault("latitude and longitude exchanged", FIX, exchanged_fix, ("axes", "frame"), _ANY),
    Fault("messages that come twice", WHEELS, twice, ("duplicates",), _ANY),
    Fault("the second half of the wheels missing", WHEELS, lambda c: c.select(slice(0, len(c) // 2)), ("cut",), _ANY),
    Fault("GNSS velocity 5 s late as a whole", VELOCITY, later(5.0), ("clock", "lag"), _ANY),
    Fault("a fix that steps by 10 m", FIX, jump("latitude", 0, 10 / 111_200, None), ("jump",), _ANY[:2]),
    Fault("a steering angle that is frozen", STEERING, stuck_steering, ("frozen",), ("double_lane_change",)),
    Fault("a wheel that is frozen", WHEELS, stuck_wheel, ("frozen",), ("double_lane_change", "steady_state_circle")),
)  # fmt: skip


def is_named(fault: Fault, recording: Recording) -> bool:
    """True if the fault, planted in a recording, is detected and called what it is."""
    found = inspect(changed(recording, fault.topic, fault.change))
    if any(f.topic == fault.topic and f.kind in fault.kinds for f in found.findings):
        return True
    return "duplicates" in fault.kinds and any(p.startswith(fault.topic) and "time stamp" in p for p in found.problems)


def planted(
    vehicles: tuple[str, ...] = ("prototype_real", "rav4"), seed: int = 0
) -> Iterator[tuple[Fault, str, Recording]]:
    """Every fault with the drives in which it can be seen."""
    for fault in FAULTS:
        for manoeuvre in fault.manoeuvres:
            for vehicle in vehicles:
                recording = drive(manoeuvre, vehicle, seed)
                if fault.topic in recording:
                    yield fault, f"{vehicle}, {manoeuvre}", recording
