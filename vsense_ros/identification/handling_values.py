"""Parameters of the handling models from a vehicle file, and identified ones back into it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.best_4dof import TYRE, roll_axis_height
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.schema.uncertainty import Uncertainty
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.tyres import TyreInput
from vsense_ros.model.tyres.similarity import Similarity
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class HandlingDefaults:
    """Values of handling models that no vehicle file gives."""

    lag: float = 0.03  # [s] of the tyre forces
    # [m] of a car tyre (Pacejka 2012, ch. 5: about the radius of the wheel to twice that)
    relaxation_length: float = 0.6
    shape: float = 1.6  # [-] of a force curve whose tyre does not give one
    curvature: float = 0.5  # [-] likewise
    speed: float = 20.0  # [m/s] at which the force of a tyre is evaluated
    largest_slip: float = 0.5  # [-] tangent of the slip angle up to which the largest force is searched


HANDLING_DEFAULTS = HandlingDefaults()


def of_vehicle(vehicle: Vehicle) -> dict[str, float]:
    """All parameters of the handling models, by name."""
    physics, chassis = vehicle.physics, vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    weight = chassis.mass * GRAVITY
    loads = weight * chassis.cog_to_rear_axle / wheelbase, weight * chassis.cog_to_front_axle / wheelbase
    front, rear = physics.front, physics.rear
    stiffness = [_roll(axle, axle.suspension_stiffness + 2 * axle.antiroll_stiffness) for axle in (front, rear)]
    damping = sum(_roll(axle, axle.suspension_damping) for axle in (front, rear))
    values = {
        "front_weight": loads[0], "rear_weight": loads[1], "front_roll_centre_height": front.roll_centre_height,
        "rear_roll_centre_height": rear.roll_centre_height, "half_track": (front.track + rear.track) / 4,
        "wheelbase": wheelbase, "friction": physics.road.friction, "lag": HANDLING_DEFAULTS.lag,
        "wheel_radius": float(rolling_radii(vehicle).mean()), "front_roll_share": stiffness[0] / sum(stiffness),
        "cog_height": chassis.cog_height, "yaw_inertia": chassis.yaw_inertia, "roll_stiffness": sum(stiffness),
        "roll_damping": damping, "relaxation_length": _relaxation_length(front, rear),
    }  # fmt: skip
    for name, axle, load in (("front", front, loads[0]), ("rear", rear, loads[1])):
        for key, value in zip(TYRE, similar(axle, load / 2), strict=True):
            values[f"{name}_{key}"] = value
    height = chassis.cog_height - float(roll_axis_height(values))
    values["roll_gradient"] = chassis.mass * height / (values["roll_stiffness"] - weight * height)
    values["roll_inertia"] = chassis.roll_inertia + chassis.mass * height**2
    return values


def deviations(vehicle: Vehicle) -> dict[str, float]:
    """Standard deviations of parameters of the handling models, by name, of those that the vehicle file states any for.

    The cornering stiffness of an axle is that of its tyre times `cornering_scale`, its largest force that times
    `grip_scale`; both relative deviations carry over.
    """
    stated, values = vehicle.deviations(), of_vehicle(vehicle)
    by_parameter = {
        name: stated[f"chassis.{name}"]
        for name in ("cog_height", "yaw_inertia")
        if stated.get(f"chassis.{name}", 0) > 0
    }
    for axle in ("front", "rear"):
        for name, scale in (("stiffness", "cornering_scale"), ("peak", "grip_scale")):
            deviation = stated.get(f"{axle}.{scale}", 0.0)
            if deviation > 0:
                relative = deviation / float(getattr(getattr(vehicle.physics, axle), scale))
                by_parameter[f"{axle}_{name}"] = relative * values[f"{axle}_{name}"]
        height = f"{axle}.roll_centre_height"
        if stated.get(height, 0.0) > 0:
            by_parameter[f"{axle}_roll_centre_height"] = stated[height]
    return by_parameter


def _relaxation_length(*axles: Axle) -> float:
    """Mean relaxation length of the similarity tyres that have one, else that of a car tyre [m]."""
    lengths = [axle.tyre.relaxation_length for axle in axles if isinstance(axle.tyre, Similarity)]
    return float(np.mean(lengths)) if any(lengths) else HANDLING_DEFAULTS.relaxation_length


def _build_up(values: Mapping[str, float]) -> dict[str, float]:
    """How forces of a similarity tyre build up: over the length of a model that has one, else in the paper's time."""
    if "relaxation_length" in values:
        return {"relaxation_length": values["relaxation_length"]}
    return {"relaxation_time": values.get("lag", HANDLING_DEFAULTS.lag)}


def _roll(axle: Axle, at_wheel: float) -> float:
    """Moment per roll of an axle [N m/rad] of a rate at each wheel [N/m]."""
    return at_wheel * axle.track**2 / 2


def similar(axle: Axle, load: float) -> tuple[float, float, float, float, float]:
    """Stiffness, longitudinal ratio, shape, peak and curvature of the similarity tyre that has the slopes and the
    largest force of an axle's tyre under a wheel load [N]."""
    tyre = axle.tyre
    cornering = float(tyre.cornering_stiffness_at(load)) * axle.cornering_scale
    slope = float(tyre.steepest_slope(load)) * axle.longitudinal_scale
    if isinstance(tyre, Similarity):
        return tyre.stiffness * axle.cornering_scale, slope / cornering, tyre.shape, tyre.peak, tyre.curvature
    slips = np.linspace(0.01, HANDLING_DEFAULTS.largest_slip, 60)
    forces = [
        float(
            tyre.forces(
                TyreInput(load, HANDLING_DEFAULTS.speed, -slip * HANDLING_DEFAULTS.speed, HANDLING_DEFAULTS.speed)
            ).lateral
        )
        for slip in slips
    ]
    peak = max(max(forces) / load * axle.grip_scale, 0.2)
    return cornering / peak, slope / cornering, HANDLING_DEFAULTS.shape, peak, HANDLING_DEFAULTS.curvature


def changes(vehicle: Vehicle, values: Mapping[str, float], determined: Iterable[str]) -> Vehicle:
    """The vehicle with the identified parameters `determined` of a handling model in place of its own.

    Tyres of an axle become similarity tyres where their stiffness is determined, or its product with the peak. Roll
    stiffness and damping scale what the file has of springs, bars and dampers. Raises `ValueError` if there can be no
    such car.
    """
    determined, before = set(determined), of_vehicle(vehicle)
    data = vehicle.model_dump(mode="json")
    physics, chassis = data["physics"], data["physics"]["chassis"]
    chassis |= {name: values[name] for name in ("cog_height", "yaw_inertia") if name in determined}
    for name in ("front", "rear"):
        axle = physics[name]
        if f"{name}_roll_centre_height" in determined:
            axle["roll_centre_height"] = values[f"{name}_roll_centre_height"]
        if "roll_stiffness" in determined:
            factor = values["roll_stiffness"] / before["roll_stiffness"]
            axle["suspension_stiffness"] *= factor
            axle["antiroll_stiffness"] *= factor
        if "roll_damping" in determined:
            axle["suspension_damping"] *= values["roll_damping"] / before["roll_damping"]
        if f"{name}_stiffness" in determined:
            tyre = {key: values[f"{name}_{key}"] for key in TYRE}
            tyre["shape"] = min(max(tyre["shape"], 1.0), 2.5)
            axle["tyre"] = {"model": "similarity", **_build_up(values), **tyre}
            axle |= {"grip_scale": 1.0, "cornering_scale": 1.0, "longitudinal_scale": 1.0}
    replaced = {
        f"physics.{name}.{scale}"
        for name in ("front", "rear") if f"{name}_stiffness" in determined
        for scale in ("grip_scale", "cornering_scale", "longitudinal_scale")
    }  # fmt: skip
    data["uncertainty"] = {path: deviation for path, deviation in data["uncertainty"].items() if path not in replaced}
    for sensor in data["sensors"].values():
        if sensor["kind"] == "steering":
            if "steering_gain" in determined:
                sensor["gain"] *= values["steering_gain"]
            if "steering_delay" in determined:
                sensor["latency"] += values["steering_delay"]
    return Vehicle.model_validate(data)


def with_uncertainty(vehicle: Vehicle, deviations: Mapping[str, float], source: str) -> Vehicle:
    """The vehicle whose section `uncertainty` has these standard deviations, by dotted path, and their source."""
    stated = {
        path: Uncertainty(deviation=float(f"{deviation:.2g}"), source=source)
        for path, deviation in deviations.items()
        if deviation > 0
    }
    return vehicle.model_copy(update={"uncertainty": {**vehicle.uncertainty, **stated}})
