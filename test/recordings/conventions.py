"""Drives in which one or two sensors follow another convention of axes and signs, and what mending makes of them.

A mend is right where every channel is again as it was measured. It does harm where the side slip that is estimated
afterwards is worse than before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from recordings import planted
from recordings.planted import FIX, IMU, STEERING, VELOCITY, WHEELS, Change, both, changed, scaled, values
from vsense_ros.api.estimation import estimate
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.mending import mends
from vsense_ros.messages.recording import Channel, Recording

HARM = 0.02  # [deg] by which side slip may become worse
RATES, FORCES = "angular_velocity", "linear_acceleration"


def turned(matrix: list[list[float]], *fields: str) -> Change:
    """Vectors as a sensor gives them whose axes are the rows of `matrix`, in those of the car."""
    return both(*(values(field, lambda v: v @ np.array(matrix).T) for field in fields))


def sides(channel: Channel) -> Channel:
    swap = {"wheel_fl": "wheel_fr", "wheel_fr": "wheel_fl", "wheel_rl": "wheel_rr", "wheel_rr": "wheel_rl"}
    return replace(channel, names=tuple(swap[name] for name in channel.names))


DOWN, RIGHT_FORWARD = [[1, 0, 0], [0, -1, 0], [0, 0, -1]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
NORTH_EAST_DOWN = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
SINGLE: dict[str, tuple[tuple[str, Change], ...]] = {
    "IMU in SAE J670, aerospace axes": ((IMU, turned(DOWN, RATES, FORCES)),),
    "IMU in the axes of a phone (ENU)": ((IMU, turned(RIGHT_FORWARD, RATES, FORCES)),),
    "accelerometer reversed": ((IMU, scaled(FORCES, -1.0)),),
    "accelerometer alone in SAE J670": ((IMU, turned(DOWN, FORCES)),),
    "lateral acceleration reversed": ((IMU, scaled(FORCES, (1.0, -1.0, 1.0))),),
    "gyro alone in SAE J670": ((IMU, turned(DOWN, RATES)),),
    "velocity in north, east, down": ((VELOCITY, turned(NORTH_EAST_DOWN, "linear")),),
    "velocity positive to the west": ((VELOCITY, scaled("linear", (-1.0, 1.0, 1.0))),),
    "steering positive to the right": ((STEERING, scaled("position", -1.0)),),
    "left and right wheels exchanged": ((WHEELS, sides),),
    "wheels negative forwards": ((WHEELS, scaled("velocity", -1.0)),),
}
_PAIRS = (
    ("IMU in SAE J670, aerospace axes", "velocity in north, east, down"),
    ("IMU in SAE J670, aerospace axes", "steering positive to the right"),
    ("IMU in SAE J670, aerospace axes", "left and right wheels exchanged"),
    ("IMU in the axes of a phone (ENU)", "steering positive to the right"),
    ("velocity in north, east, down", "steering positive to the right"),
    ("accelerometer reversed", "steering positive to the right"),
    ("gyro alone in SAE J670", "velocity in north, east, down"),
    ("steering positive to the right", "wheels negative forwards"),
    ("accelerometer reversed", "left and right wheels exchanged"),
)
EVERY = SINGLE | {" and ".join(pair): SINGLE[pair[0]] + SINGLE[pair[1]] for pair in _PAIRS}
_DRIVES = (("double_lane_change", "prototype_real"), ("brake_in_turn", "prototype_model"), ("steering_sweep", "rav4"))


@dataclass(frozen=True)
class Size:
    """A car of another size: what the wheel speeds and steering angles of the generated one are multiplied by."""

    name: str
    spin: float
    steering: float

    def of(self, recording: Recording, *, back: bool = False) -> Recording:
        """The recording as the other car would give it, or back to the generated one."""
        power = -1.0 if back else 1.0
        for topic, field, factor in ((WHEELS, "velocity", self.spin), (STEERING, "position", self.steering)):
            if topic in recording:
                recording = changed(recording, topic, scaled(field, factor**power))
        return recording


SIZES = (Size("car", 1.0, 1.0), Size("small car", 1.22, 0.8), Size("truck", 0.62, 1.4))


def without_gnss(recording: Recording) -> Recording:
    return replace(recording, channels={t: c for t, c in recording.channels.items() if t not in (FIX, VELOCITY)})


@dataclass(frozen=True)
class Wrong:
    """A recording with other conventions, and the same with the expected ones."""

    name: str
    right: Recording
    wrong: Recording
    vehicle: str
    size: Size


def drives() -> Iterator[Wrong]:
    """Forty recordings: each of the twenty faults in two drives, cars of three sizes, half of them without GNSS where
    it concerns no GNSS."""
    for index, (name, changes) in enumerate(EVERY.items()):
        for turn in (0, 1):
            manoeuvre, vehicle = _DRIVES[(index + turn) % len(_DRIVES)]
            size = SIZES[(index + 2 * turn) % len(SIZES)]
            drive = size.of(planted.drive(manoeuvre, vehicle, 0))
            gnss = turn == 0 or any(topic in (FIX, VELOCITY) for topic, _ in changes)
            drive = drive if gnss else without_gnss(drive)
            wrong = drive
            for topic, change in changes:
                wrong = changed(wrong, topic, change)
            where = f"{name}: {manoeuvre} of {vehicle}, {size.name}{'' if gnss else ', without GNSS'}"
            yield Wrong(where, drive, wrong, vehicle, size)


def same(one: Recording, other: Recording) -> bool:
    """True if two recordings have the same values on the topics of sensors."""
    return all(
        one[topic].names == other[topic].names
        and all(np.allclose(one[topic].columns[f], v, equal_nan=True) for f, v in other[topic].columns.items())
        for topic in other.channels
        if not topic.startswith("reference/")
    )


def side_slip(recording: Recording, vehicle: str) -> float:
    """Root mean square error of the side slip that is estimated [deg]; infinite where nothing comes of it."""
    rmse = estimate(recording, vehicle)["side_slip"].rmse
    return np.inf if rmse is None else float(np.degrees(rmse))


def judged(one: Wrong, harm: Callable[[Recording, str], float] = side_slip) -> tuple[bool, bool]:
    """Two flags: the mend gives the right recording; the mend makes the side slip worse than it was without."""
    after = mended(one.wrong, mends(one.wrong))
    if same(after, one.right):
        return True, False
    if same(after, one.wrong):
        return False, False
    before_mend, after_mend = (harm(one.size.of(r, back=True), one.vehicle) for r in (one.wrong, after))
    return False, after_mend > before_mend + HARM
