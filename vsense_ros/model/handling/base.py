"""What a handling model is: names, equations, the tyres in it, and its parameters from a vehicle file.

Axes are those of ISO 8855: velocities and forces ahead and to the left, angles counter-clockwise, and a tyre that is
moved to the left is pushed to the right. A filter takes such a model as it is: states, inputs and parameters by name,
time derivatives by `rates`, what sensors may be compared with by `measured`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.parameter import Scalar, with_expressions
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.simulation.closed_loop import axle_of, rolling_radii
from vsense_ros.model.tyres import Linear, Tyre, TyreInput
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

AXLES = ("front", "rear")
STIFFNESSES = ("slip_stiffness", "cornering_stiffness")  # of a linear tyre: those that are parameters of a model


@dataclass(frozen=True)
class HandlingSettings:
    """Numerical settings of handling models."""

    standstill_speed: float = 0.01  # [m/s] of a linear tyre in a handling model, which leaves its stiffness as it is
    # [m/s] below which the side slip is that at this speed, so that it has a derivative at rest
    smallest_speed: float = 0.1
    slope_speed: float = 20.0  # [m/s] at which the slope of a tyre is evaluated
    slope_slip: float = 1e-4  # [-] slip for that slope


HANDLING = HandlingSettings()

TyreKind = Literal["linear", "own"]


class Scales(NamedTuple):
    """What an axle and its road make of a tyre: stiffnesses and grip over those of the tyre's parameters [-]."""

    cornering: float
    longitudinal: float
    friction: float


@dataclass(frozen=True)
class Tyres:
    """Tyres by their place in a model: an axle, or a wheel.

    `free` are those numbers of a tyre (dotted as in a vehicle file) that are parameters of the model; the others stand
    in its equations as they are.
    """

    at: Mapping[str, Tyre]
    free: tuple[str, ...] = ()
    scales: Mapping[str, Scales] = field(default_factory=dict)  # of an axle and its road over those of the tyre

    @classmethod
    def of_vehicle(cls, vehicle: Vehicle, places: Sequence[str], kind: TyreKind = "linear") -> Tyres:
        """Linear ones with the stiffnesses that the vehicle's tyres have at zero slip and under their static loads, or
        those of the vehicle file."""
        of_axle = (vehicle.physics.front, vehicle.physics.rear)
        axles = [of_axle[_axle_index(place)] for place in places]
        if kind == "own":
            grip = vehicle.physics.road.friction
            scales = [Scales(axle.cornering_scale, axle.longitudinal_scale, grip * axle.grip_scale) for axle in axles]
            tyre_by_place = {place: axle.tyre for place, axle in zip(places, axles, strict=True)}
            return cls(tyre_by_place, scales=dict(zip(places, scales, strict=True)))
        loads = static_loads(vehicle)
        linear = [linear_tyre(axle, loads[_axle_index(place)]) for place, axle in zip(places, axles, strict=True)]
        return cls(dict(zip(places, linear, strict=True)), STIFFNESSES)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters of a model: the place and the number, without dots."""
        return tuple(_parameter(place, name) for place in self.at for name in self.free)

    def numbers(self) -> dict[str, float]:
        """Values of `parameters`."""
        return {
            _parameter(place, name): float(_number(tyre, name)) for place, tyre in self.at.items() for name in self.free
        }

    def forces(self, place: str, wheel: TyreInput, p: Any) -> tuple[Scalar, Scalar]:
        """Forces of the tyre at a place, along and across the wheel [N]."""
        tyre = self.at[place]
        if self.free:
            tyre = with_expressions(tyre, {name: p[_parameter(place, name)] for name in self.free})
        scale = self.scales.get(place)
        if scale is not None:
            sliding = wheel.rolling_speed - wheel.speed_x
            wheel = replace(
                wheel,
                speed_y=scale.cornering * wheel.speed_y,
                rolling_speed=wheel.speed_x + scale.longitudinal * sliding,
                friction=scale.friction,
            )
        forces = tyre.forces(wheel)
        return forces.longitudinal, forces.lateral


class HandlingModel(ABC):
    """Names and equations of one model. Arguments of its methods give values by attribute or by key; values and results
    are CasADi expressions or numbers."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    driven: tuple[str, ...] = ()  # inputs that keep a speed, the same value for all of them

    @abstractmethod
    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Time derivatives of the states, (n,)."""

    @abstractmethod
    def measured(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Outputs, (m,)."""

    @abstractmethod
    def rolling(self, speed: float, p: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """States and inputs by name of a car that rolls straight on at `speed` [m/s], without any force; what is left
        out is zero."""

    def following(self, x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Inputs by name that in a car on the road follow its motion, such as the spin of wheels that roll freely; in
        straight running they are as in `u`."""
        return {}

    def numbers(self, vehicle: Vehicle) -> dict[str, float]:
        """Parameters from a vehicle file, by name [SI]."""
        values = car_numbers(vehicle) | self.tyre_numbers()
        return {name: values[name] for name in self.parameters}

    def tyre_numbers(self) -> dict[str, float]:
        """Parameters that are numbers of tyres."""
        return {}


def loads_at_rest(p: Any) -> tuple[Scalar, Scalar]:
    """Wheel loads at rest of one front and one rear wheel [N]."""
    half = p.mass * GRAVITY / (p.to_front + p.to_rear) / 2
    return half * p.to_rear, half * p.to_front


def static_loads(vehicle: Vehicle) -> tuple[float, float]:
    """Wheel loads at rest of one front and one rear wheel of a vehicle [N]."""
    chassis = vehicle.physics.chassis
    a, b = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    half = chassis.mass * GRAVITY / (a + b) / 2
    return half * b, half * a


def slopes(axle: Axle, load: float) -> tuple[float, float]:
    """Slopes of one tyre at small slips: longitudinal force per slip [N], lateral force per slip angle [N/rad]."""
    driven, braked = (
        axle.tyre.forces(TyreInput(load, HANDLING.slope_speed, 0.0, HANDLING.slope_speed * (1 + slip))).longitudinal
        for slip in (HANDLING.slope_slip, -HANDLING.slope_slip)
    )
    along = (float(driven) - float(braked)) / (2 * HANDLING.slope_slip) * axle.longitudinal_scale
    return along, cornering_stiffness(axle, load)


def cornering_stiffness(axle: Axle, load: float) -> float:
    """Slope of the lateral force of one tyre at small slip angles [N/rad]."""
    return float(axle.tyre.cornering_stiffness_at(load)) * axle.cornering_scale


def linear_tyre(axle: Axle, load: float) -> Linear:
    """The linear tyre that an axle's tyre is at small slips under a load [N]."""
    along, across = slopes(axle, load)
    return Linear(
        model="linear", slip_stiffness=along, cornering_stiffness=across, standstill_speed=HANDLING.standstill_speed
    )


def car_numbers(vehicle: Vehicle) -> dict[str, float]:
    """What a vehicle file says of chassis, wheels and axle stiffnesses, by the names of the models' parameters [SI].

    Stiffnesses are those of both tyres of an axle, radii the effective rolling radii under static load.
    """
    physics, loads, radii = vehicle.physics, static_loads(vehicle), rolling_radii(vehicle)
    values = {
        "mass": physics.chassis.mass,
        "yaw_inertia": physics.chassis.yaw_inertia,
        "to_front": physics.chassis.cog_to_front_axle,
        "to_rear": physics.chassis.cog_to_rear_axle,
        "air_density": AIR_DENSITY,
        "drag_area": physics.aerodynamics.drag_area,
    }
    for i, (name, axle) in enumerate(zip(AXLES, (physics.front, physics.rear), strict=True)):
        values[f"{name}_stiffness"] = 2 * cornering_stiffness(axle, loads[i])
        values[f"{name}_half_track"] = axle.track / 2
        values[f"{name}_radius"] = float(radii[2 * i])
        values[f"{name}_spin_inertia"] = 2 * axle.wheel_spin_inertia
    for i, wheel in enumerate(WHEELS):
        values[f"radius_{wheel}"] = float(radii[i])
        values[f"spin_inertia_{wheel}"] = axle_of(vehicle, i).wheel_spin_inertia
    return values


def rear_slip(car: Mapping[str, float]) -> float:
    """Slip angle of the rear axle per lateral acceleration [rad s²/m], of numbers as `car_numbers` has them."""
    share = car["to_front"] / (car["to_front"] + car["to_rear"])
    return car["mass"] * share / car["rear_stiffness"]


def _axle_index(place: str) -> int:
    """0 for the front axle or one of its wheels, 1 for the rear."""
    return 0 if place in ("front", *WHEELS[:2]) else 1


def _parameter(place: str, name: str) -> str:
    return f"{place}_{name.replace('.', '_')}"


def _number(tyre: Tyre, dotted: str) -> Any:
    attribute: Any = tyre
    for part in dotted.split("."):
        attribute = getattr(attribute, part)
    return attribute
