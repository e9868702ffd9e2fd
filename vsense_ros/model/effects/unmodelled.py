"""Forces for which no physics is known: what is fitted where nothing else explains a car."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
from pydantic import create_model

from vsense_ros.model.coordinates import ROLL_RATE, SPEED_X, SPEED_Y, STEERING, TORQUES, TRAVEL, WHEELS, YAW_RATE
from vsense_ros.model.effects.base import AXLES, CORNERS, Effect, size
from vsense_ros.model.moving_car import Corner, MovingCar
from vsense_ros.model.sensors import SensorBase

SLOWEST = 1.0  # [m/s] for side slip, so that a car may rest


@dataclass(frozen=True)
class Channel:
    """Where a term acts: a component of the force on the chassis about `cog`, in body axes, against the compression of
    one suspension, between the wheels of an axle, or on the angle of the front wheels."""

    words: str
    unit: str
    row: int  # of moments and forces on the chassis; of a suspension, of its travel among the coordinates; of an axle
    typical: float  # size where its feature has its typical size


@dataclass(frozen=True)
class Feature:
    """What a term follows; `typical` is a size it often has, in `unit`."""

    words: str
    unit: str  # of what the term is divided by; empty for none
    typical: float
    value: Callable[[MovingCar], ca.SX]
    by_torque: bool = False  # whether it needs the wheel torques


def _lateral(car: MovingCar) -> ca.SX:
    return car.u[SPEED_X] * car.u[YAW_RATE]


def _demand(car: MovingCar) -> ca.SX:
    """Acceleration that the wheel torques ask for [m/s²]."""
    p = car.parameters
    return ca.sum1(car.inputs[TORQUES]) / (p.chassis.mass * p.front.unloaded_radius)


def _travel(row: int) -> dict[str, Feature]:
    """Features of a force that follows the travel of a wheel relative to the body, or its rate."""
    return {
        "rate": Feature("that follows its speed, as a damper", "m/s", 0.1, lambda car: car.u[row]),
        "travel": Feature("that follows its travel, as a spring", "m", 0.02, lambda car: car.q[row]),
    }


CHASSIS = {
    "longitudinal_force": Channel("a longitudinal force", "N", 3, 200.0),
    "lateral_force": Channel("a lateral force", "N", 4, 300.0),
    "yaw_moment": Channel("a yaw moment", "N m", 2, 300.0),
    "roll_moment": Channel("a roll moment", "N m", 0, 300.0),
}
_SUSPENSIONS = [f"suspension_force_{wheel}" for wheel in WHEELS]
STEERING_ANGLE = "front_angle"
_ACROSS = [f"torque_across_{axle}" for axle in AXLES]
CHANNELS = (
    CHASSIS
    | {
        name: Channel(f"a force in the {place} suspension", "N", TRAVEL.start + i, 50.0)
        for i, (name, place) in enumerate(zip(_SUSPENSIONS, CORNERS.values(), strict=True))
    }
    | {
        name: Channel(f"a torque from the left to the right {axle} wheel", "N m", i, 50.0)
        for i, (name, axle) in enumerate(zip(_ACROSS, AXLES, strict=True))
    }
    | {STEERING_ANGLE: Channel("an angle of the front wheels", "rad", 0, 0.003)}
)
CONSTANT = Feature("that is always there", "", 1.0, lambda car: ca.SX(1))
SPEED = Feature("that grows with the speed", "m/s", 20.0, lambda car: car.u[SPEED_X])
SQUARE = Feature("that grows with the square of the speed", "m²/s²", 500.0, lambda car: car.u[SPEED_X] ** 2)
DRIVING = Feature("that grows with the drive torque", "m/s²", 2.0, lambda car: ca.fmax(_demand(car), 0), True)
BRAKING = Feature("that grows with the brake torque", "m/s²", 3.0, lambda car: ca.fmax(-_demand(car), 0), True)
EVEN = {
    "constant": CONSTANT,
    "speed": SPEED,
    "speed_squared": SQUARE,
    "driving": DRIVING,
    "braking": BRAKING,
    "cornering": Feature("that grows with cornering to either side", "m/s²", 4.0, lambda car: ca.fabs(_lateral(car))),
}
TURNING = {
    "lateral": Feature("that follows the lateral acceleration", "m/s²", 4.0, _lateral),
    "lateral_squared": Feature(
        "that follows the square of the lateral acceleration", "m²/s⁴", 20.0,
        lambda car: _lateral(car) * ca.fabs(_lateral(car)),
    ),
    "lateral_speed": Feature(
        "that follows lateral acceleration times speed", "m²/s³", 80.0, lambda car: _lateral(car) * car.u[SPEED_X]
    ),
    "lateral_driving": Feature(
        "that follows the lateral acceleration under drive torque", "m²/s⁴", 6.0,
        lambda car: _lateral(car) * ca.fmax(_demand(car), 0), True,
    ),
    "lateral_braking": Feature(
        "that follows the lateral acceleration under brake torque", "m²/s⁴", 10.0,
        lambda car: _lateral(car) * ca.fmax(-_demand(car), 0), True,
    ),
    "steering": Feature("that follows the steering angle", "rad", 0.05, lambda car: car.inputs[STEERING]),
    "side_slip": Feature(
        "that follows the side slip", "rad", 0.04, lambda car: car.u[SPEED_Y] / ca.fmax(car.u[SPEED_X], SLOWEST)
    ),
    "yaw_rate": Feature("that follows the yaw rate", "rad/s", 0.2, lambda car: car.u[YAW_RATE]),
    "roll_rate": Feature("that follows the roll rate", "rad/s", 0.1, lambda car: car.u[ROLL_RATE]),
}  # fmt: skip
ASYMMETRIC = {"constant": CONSTANT, "speed": SPEED, "driving": DRIVING, "braking": BRAKING}
TO_ONE_SIDE = {"driving": DRIVING, "braking": BRAKING} | {
    name: TURNING[name] for name in ("lateral", "lateral_driving", "lateral_braking", "steering")
}
# What the wheels are turned by follows inputs alone: an observer asks for forces of the road without the speeds.
STEERED = {
    "steering_squared": Feature(
        "that follows the square of the steering angle", "rad²", 0.0025,
        lambda car: car.inputs[STEERING] * ca.fabs(car.inputs[STEERING]),
    )
}  # fmt: skip
TERMS = (
    {
        "longitudinal_force": EVEN,
        "lateral_force": ASYMMETRIC | TURNING,
        "yaw_moment": ASYMMETRIC | TURNING,
        "roll_moment": {"constant": CONSTANT} | TURNING,
    }
    | {name: _travel(CHANNELS[name].row) for name in _SUSPENSIONS}
    | dict.fromkeys(_ACROSS, TO_ONE_SIDE)
    | {STEERING_ANGLE: STEERED}
)


def axle_of_torque(name: str) -> str | None:
    """The axle between whose wheels a term of this dotted name is a torque that does not come from brakes; None for
    other terms."""
    field = name.rsplit(".", 1)[-1]
    if field.endswith("braking"):
        return None
    return next((axle for axle, across in zip(AXLES, _ACROSS, strict=True) if field.startswith(across)), None)


def _field(channel: Channel, feature: Feature) -> Any:
    per = f"({feature.unit})" if "/" in feature.unit else feature.unit
    unit = f"{channel.unit}/{per}" if per else channel.unit
    typical = channel.typical / feature.typical
    return float, size(unit, f"{channel.words} {feature.words}", typical=typical, high=100 * typical)


class _Unmodelled(Effect):
    """A sum of terms, each a force or moment on the chassis, a force in a suspension, a torque between the wheels of an
    axle or an angle of the front wheels, that is proportional to something which the car does."""

    id: ClassVar[str] = "unmodelled"
    sentence: ClassVar[str] = "a force for which no physics is known"
    known: ClassVar[bool] = False

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        added = ca.SX.zeros(6)
        for name, channel in CHASSIS.items():
            added[channel.row] += self._sum(name, car)
        return force + added

    def front_angle(self, angle: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        return angle + self._sum(STEERING_ANGLE, car)

    def suspension_force(self, force: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        return force + self._sum(_SUSPENSIONS[corner.index], car)

    def wheel_torque(self, torque: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        to_the_right = -1 if corner.index % 2 == 0 else 1
        return torque + to_the_right * self._sum(_ACROSS[corner.index // 2], car)

    def left_out_of_observer(self, sensors: Collection[SensorBase]) -> str:
        if any("torques" in sensor.measures for sensor in sensors):
            return ""
        asking = [
            f"{channel}_{name}"
            for channel, features in TERMS.items()
            for name, feature in features.items()
            if feature.by_torque and getattr(self, f"{channel}_{name}")
        ]
        return f"{', '.join(asking)}, as no sensor measures the wheel torques" if asking else ""

    def _sum(self, channel: str, car: MovingCar) -> ca.SX:
        terms = (getattr(self, f"{channel}_{feature}") * term.value(car) for feature, term in TERMS[channel].items())
        return sum(terms, ca.SX(0))


Unmodelled: type[Effect] = create_model(
    "Unmodelled",
    __base__=_Unmodelled,
    **{f"{c}_{f}": _field(CHANNELS[c], content) for c, features in TERMS.items() for f, content in features.items()},
)
