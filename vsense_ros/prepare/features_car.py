"""Figures of the whole car: weight, centre of gravity, inertias, how it steers and rolls."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees

from vsense_ros.manoeuvre.driver import understeer_gradient
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.sensors import Steering
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.features import Feature

_CHASSIS = "physics.chassis."
ARMS = (f"{_CHASSIS}cog_to_front_axle", f"{_CHASSIS}cog_to_rear_axle")
_TRACKS = ("physics.front.track", "physics.rear.track")
_BARS = tuple(
    f"physics.{axle}.{name}" for axle in ("front", "rear") for name in ("suspension_stiffness", "antiroll_stiffness")
)


def of_body(car: Vehicle) -> Iterator[Feature]:
    """Mass, centre of gravity and inertias."""
    chassis, front, rear = car.physics.chassis, car.physics.front, car.physics.rear
    ahead, behind = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    wheelbase, track = ahead + behind, (front.track + rear.track) / 2
    share = behind / wheelbase
    mass, height, yaw = f"{_CHASSIS}mass", f"{_CHASSIS}cog_height", f"{_CHASSIS}yaw_inertia"
    pitch, roll = f"{_CHASSIS}pitch_inertia", f"{_CHASSIS}roll_inertia"
    yield Feature("mass_over_footprint", chassis.mass / wheelbase / track, (mass, *ARMS, *_TRACKS))
    yield Feature("wheelbase_over_track", wheelbase / track, (*ARMS, *_TRACKS))
    yield Feature("front_share", share, ARMS)
    if car.drivetrain.driven == "front":
        yield Feature("front_share_driven_at_front", share, ARMS)
    yield Feature("cog_height_over_track", chassis.cog_height / track, (height, *_TRACKS))
    yield Feature("yaw_inertia_over_arms", chassis.yaw_inertia / chassis.mass / ahead / behind, (yaw, mass, *ARMS))
    yield Feature("pitch_over_yaw_inertia", chassis.pitch_inertia / chassis.yaw_inertia, (pitch, yaw))
    gyration = (chassis.roll_inertia / chassis.mass) ** 0.5 / track
    yield Feature("roll_gyration_over_track", gyration, (roll, mass, *_TRACKS))
    unsprung = 2 * sum(axle.hub_mass + axle.wheel_mass for axle in (front, rear)) / chassis.mass
    masses = tuple(f"physics.{a}.{part}" for a in ("front", "rear") for part in ("hub_mass", "wheel_mass"))
    yield Feature("unsprung_share", unsprung, (*masses, mass))
    yield Feature("tracks_apart", rear.track / front.track, _TRACKS)
    yield Feature("drag_area", car.physics.aerodynamics.drag_area, ("physics.aerodynamics.drag_area",))


def of_handling(car: Vehicle) -> Iterator[Feature]:
    """How the car steers and rolls in a steady turn."""
    chassis, front, rear = car.physics.chassis, car.physics.front, car.physics.rear
    arms = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    share = arms[1] / sum(arms)
    stiffness = [(a.suspension_stiffness + 2 * a.antiroll_stiffness) * a.track**2 / 2 for a in (front, rear)]
    unsprung = 2 * sum(a.hub_mass + a.wheel_mass for a in (front, rear))
    height = chassis.cog_height - (share * front.roll_centre_height + (1 - share) * rear.roll_centre_height)
    moment = (chassis.mass - unsprung) * GRAVITY * height
    gradient = degrees(moment / max(sum(stiffness) - moment, 1e-6))
    yield Feature("roll_gradient", gradient, (*_BARS, "physics.chassis.cog_height", "physics.chassis.mass"))
    yield Feature("front_roll_share", stiffness[0] / sum(stiffness), _BARS)
    scales = ("physics.front.cornering_scale", "physics.rear.cornering_scale")
    tyres = ("physics.front.tyre", "physics.rear.tyre")
    yield Feature("understeer_gradient", degrees(understeer_gradient(car) * GRAVITY), (*tyres, *scales, *ARMS))
    yield Feature("steering_ratio", car.physics.steering.ratio, ("physics.steering.ratio",))
    for name, sensor in car.sensors.items():
        if isinstance(sensor, Steering):
            yield Feature("steering_gain", sensor.gain, (f"sensors.{name}.gain",), name)
            if sensor.ratio is not None:
                yield Feature("steering_ratio", sensor.ratio, (f"sensors.{name}.ratio",), name)
