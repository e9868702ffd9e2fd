"""Figures of an axle: how its body and wheels swing, what its tyres carry and do at their load."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi, sqrt

from vsense_ros.identification.handling_values import similar
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.base import slopes, static_loads
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.tyres import TMeasy
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.features import Feature

AXLES = ("front", "rear")
_LEAST_APART = 0.03  # [-] relative difference of nominal loads that were measured for each axle


def of_axles(car: Vehicle) -> Iterator[Feature]:
    """Springs, dampers, wheels and tyres of both axles."""
    frequencies = []
    for axle, part, load in zip(AXLES, (car.physics.front, car.physics.rear), static_loads(car), strict=True):
        frequencies.append(_frequency(part, load))
        yield from _suspension(axle, part, load)
        yield from _wheel(axle, part, load)
        yield from _tyre(axle, part, load, car.physics.road.friction)
    springs = tuple(f"physics.{axle}.suspension_stiffness" for axle in AXLES)
    arms = ("physics.chassis.cog_to_front_axle", "physics.chassis.cog_to_rear_axle")
    yield Feature("bounce_ratio", frequencies[1] / frequencies[0], (*springs, *arms))
    yield from _balance(car, arms)


def _sprung(part: Axle, load: float) -> float:
    """Mass on one suspension [kg], at least a tenth of that on the wheel."""
    return max(load / GRAVITY - part.hub_mass - part.wheel_mass, 0.1 * load / GRAVITY)


def _frequency(part: Axle, load: float) -> float:
    """Natural frequency of the body on suspension and tyre [Hz]."""
    ride = 1 / (1 / part.suspension_stiffness + 1 / part.tyre_stiffness)
    return sqrt(ride / _sprung(part, load)) / (2 * pi)


def _suspension(axle: str, part: Axle, load: float) -> Iterator[Feature]:
    prefix = f"physics.{axle}."
    spring, damper, tyre = f"{prefix}suspension_stiffness", f"{prefix}suspension_damping", f"{prefix}tyre_stiffness"
    yield Feature("bounce_frequency", _frequency(part, load), (spring, tyre, "physics.chassis.mass"), axle)
    ratio = part.suspension_damping / (2 * sqrt(part.suspension_stiffness * _sprung(part, load)))
    yield Feature("damping_ratio", ratio, (damper, spring), axle)
    unsprung = part.hub_mass + part.wheel_mass
    hop = sqrt((part.suspension_stiffness + part.tyre_stiffness) / unsprung) / (2 * pi)
    yield Feature("wheel_hop_frequency", hop, (tyre, spring, f"{prefix}hub_mass", f"{prefix}wheel_mass"), axle)
    yield Feature("roll_centre_height", part.roll_centre_height, (f"{prefix}roll_centre_height",), axle)


def _wheel(axle: str, part: Axle, load: float) -> Iterator[Feature]:
    prefix = f"physics.{axle}."
    radius, spin = f"{prefix}unloaded_radius", f"{prefix}wheel_spin_inertia"
    yield Feature("wheel_radius", part.unloaded_radius, (radius,), axle)
    yield Feature(
        "tyre_deflection", load / part.tyre_stiffness / part.unloaded_radius, (f"{prefix}tyre_stiffness",), axle
    )
    gyration = sqrt(part.wheel_spin_inertia / part.wheel_mass) / part.unloaded_radius
    yield Feature("wheel_gyration", gyration, (spin, f"{prefix}wheel_mass", radius), axle)
    across = part.wheel_diametral_inertia / part.wheel_spin_inertia
    yield Feature("diametral_over_spin", across, (f"{prefix}wheel_diametral_inertia", spin), axle)


def _tyre(axle: str, part: Axle, load: float, friction: float) -> Iterator[Feature]:
    tyre, prefix = f"physics.{axle}.tyre", f"physics.{axle}."
    along, across = slopes(part, load)
    yield Feature("cornering_per_load", across / load, (tyre, f"{prefix}cornering_scale"), axle)
    yield Feature("slip_stiffness_per_load", along / load, (tyre, f"{prefix}longitudinal_scale"), axle)
    if part.tyre.model != "linear":
        grip = _grip(part, load) * friction
        yield Feature("grip", grip, (tyre, f"{prefix}grip_scale", "physics.road.friction"), axle)
    if isinstance(part.tyre, TMeasy):
        yield Feature("tyre_nominal_load", load / part.tyre.nominal_load, (f"{tyre}.nominal_load",), axle)
        yield Feature("trail", part.tyre.pneumatic_trail, (f"{tyre}.pneumatic_trail",), axle)
    yield Feature("rolling_resistance", part.rolling_resistance, (f"{prefix}rolling_resistance",), axle)


def _grip(part: Axle, load: float) -> float:
    """Largest lateral force of a tyre over its load [N] on the road for which its parameters are."""
    if isinstance(part.tyre, TMeasy):
        return float(part.tyre.lateral.at(load / part.tyre.nominal_load, 1.0).maximum) / load * part.grip_scale
    return similar(part, load)[3]


def _balance(car: Vehicle, arms: tuple[str, ...]) -> Iterator[Feature]:
    """The ratio of the axles' loads over that of the loads for which their tyres were measured, if these differ."""
    tyres = [part.tyre for part in (car.physics.front, car.physics.rear)]
    front, rear = tyres
    if not (isinstance(front, TMeasy) and isinstance(rear, TMeasy)):
        return
    if abs(front.nominal_load / rear.nominal_load - 1) < _LEAST_APART:
        return
    loads = static_loads(car)
    ratio = loads[0] / front.nominal_load / (loads[1] / rear.nominal_load)
    keys = tuple(f"physics.{axle}.tyre.nominal_load" for axle in AXLES)
    yield Feature("nominal_load_balance", ratio, (*arms, *keys))
