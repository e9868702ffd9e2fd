"""Minutes of driving with nothing wrong, and with something that goes wrong on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import DISTURBANCES, GRADE, GRADE_CHANGE, INPUTS, TORQUES
from vsense_ros.model.effects import Effects
from vsense_ros.model.effects.aero_drag import AeroDrag
from vsense_ros.model.effects.crosswind import Crosswind
from vsense_ros.model.sensors import WheelTorques
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop
from vsense_ros.model.vehicle import Vehicle

STEP = 1e-3  # [s]
RADIUS = 0.27  # [m]
HILL = 40.0  # [m] along which the road bends upwards
# Speed [m/s], road-wheel angle [rad] and acceleration [m/s²] by time.
DRIVES: dict[str, tuple[float, Callable, Callable]] = {
    "slalom": (16.0, lambda t: 0.05 * np.sin(2 * np.pi * 0.4 * t), lambda t: 0.3 * np.sin(0.6 * t)),
    "traffic": (22.0, lambda t: 0.02 * np.sin(2 * np.pi * 0.15 * t), lambda t: 2.0 * np.sin(0.6 * t)),
}


@cache
def prototype() -> Vehicle:
    """A car on straight guides whose wheel torques are known."""
    vehicle = load_vehicle(vehicle_path("prototype_real"))
    sensors = {**vehicle.sensors, "torques": WheelTorques()}
    return vehicle.model_copy(update={"suspension": None, "linkage": None, "sensors": sensors})


@cache
def afflicted() -> Vehicle:
    """A car with effects that its vehicle file lacks, of size zero."""
    vehicle = prototype()
    physics = vehicle.physics.model_copy(update={"effects": Effects(aero_drag=AeroDrag(), crosswind=Crosswind())})
    return vehicle.model_copy(update={"physics": physics})


@cache
def driven(
    name: str,
    seed: int,
    duration: float = 40.0,
    drag: float = 0.0,
    begin: float = 0.0,
    effect: str = "",
    size: float = 0.0,
    grade: float = 0.0,
) -> Recording:
    """A drive in which, from a time [s] on, the front left brake drags with a torque [N m], an effect has this size
    (`crosswind.north`), or the road goes uphill [rad]."""
    speed, angle, acceleration = DRIVES[name]
    vehicle = prototype()
    t = (np.arange(round(duration / STEP)) + 0.5) * STEP
    inputs = np.zeros((len(t), len(INPUTS)))
    inputs[:, 0] = angle(t)
    inputs[:, TORQUES] = (vehicle.physics.chassis.mass * RADIUS * acceleration(t) / 4)[:, None]
    felt, around = inputs.copy(), np.zeros((len(t), len(DISTURBANCES)))
    felt[t > begin, 1] -= drag
    change = grade / HILL * np.where((t > begin) & (t < begin + HILL / speed), 1.0, 0.0)
    around[:, GRADE_CHANGE] = change
    around[:, GRADE] = np.cumsum(change) * speed * STEP
    plant, varying = (afflicted(), {f"effects.{effect}": size * (t > begin)}) if effect else (vehicle, {})
    motion = OpenLoop(car_of(plant), keep=1).run(
        *rolling_straight(vehicle, speed), Inputs(STEP, felt, around, varying), plant.parameter_vector()
    )
    trajectory = Trajectory(
        motion.t, motion.q, motion.u, motion.udot, np.zeros((len(t), 7, 4)), inputs, disturbances=around
    )
    return record(trajectory, vehicle, seed, name=f"{name} {seed}", biased=False)


def altered(recording: Recording, topic: str, field: str, begin: float, to: Callable) -> Recording:
    """A recording in which a field of a topic is changed from a time [s] on."""
    channel: Channel = recording[topic]
    values = channel.columns[field].copy()
    late = channel.stamp > recording.start + begin * 1e9
    values[late] = to(values[late])
    changed = replace(channel, columns={**channel.columns, field: values})
    return replace(recording, channels={**recording.channels, topic: changed})
