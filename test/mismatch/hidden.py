"""Recordings of a car with something hidden, made without a driver's skill: sines of steering and torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import BANK, BANK_CHANGE, DISTURBANCES, INPUTS, TORQUES, YAW
from vsense_ros.model.effects import Effects
from vsense_ros.model.sensors import WheelTorques
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop
from vsense_ros.model.vehicle import Vehicle

STEP = 1e-3  # [s]
# Name: speed [m/s], road-wheel angle [rad] and acceleration [m/s²] by time.
MANOEUVRES = {
    "sweep": (20.0, lambda t: 0.03 * np.sin(2 * np.pi * (0.2 * t + 0.06 * t**2)), lambda t: 0.3 * np.sin(0.6 * t)),
    "slalom": (16.0, lambda t: 0.05 * np.sin(2 * np.pi * 0.4 * t), lambda t: 0.3 * np.sin(0.6 * t)),
    "at the limit": (20.0, lambda t: 0.08 * np.sin(2 * np.pi * 0.25 * t), lambda t: 1.2 + 0.0 * t),
    "bend": (15.0, lambda t: 0.05 * np.minimum(t, 1.0), lambda t: 0.3 * np.sin(0.6 * t)),
    "bend at the limit": (15.0, lambda t: 0.12 * np.minimum(t, 1.0), lambda t: 2.0 + 0.0 * t),
    "straight": (20.0, lambda t: 0.0 * t, lambda t: 0.0 * t + 0.33),
    "brake": (22.0, lambda t: 0.02 * np.sin(2 * np.pi * 0.15 * t), lambda t: 2.0 * np.sin(0.6 * t)),
    "brake again": (20.0, lambda t: 0.02 * np.sin(2 * np.pi * 0.15 * t), lambda t: np.where(t % 4 < 3, 1.5, -4.0)),
}


@cache
def prototype() -> Vehicle:
    """A car on straight guides whose wheel torques are known."""
    vehicle = load_vehicle(vehicle_path("prototype_real"))
    sensors = {**vehicle.sensors, "torques": WheelTorques()}
    return vehicle.model_copy(update={"suspension": None, "linkage": None, "sensors": sensors})


def having(vehicle: Vehicle, **effects: dict[str, float]) -> Vehicle:
    return vehicle.model_copy(
        update={"physics": vehicle.physics.model_copy(update={"effects": Effects.model_validate(effects)})}
    )


def wrong(vehicle: Vehicle) -> Vehicle:
    """A vehicle file as engineers have it: mass and tyres are off."""
    return vehicle.with_parameters(
        {
            "chassis.mass": 1.08 * vehicle.values()["chassis.mass"],
            "front.cornering_scale": 0.9,
            "rear.cornering_scale": 1.1,
        }
    )


def driven(
    vehicle: Vehicle,
    manoeuvre: str,
    duration: float = 13.0,
    seed: int = 0,
    bank: Callable[[np.ndarray], np.ndarray] = np.zeros_like,
    front: float = 0.5,
) -> Recording:
    """A recording that begins at one place, to the east; the road has a `bank` [rad] by the way to the east [m], and
    the front wheels have a share of the torques. It is made once for each car, so its columns cannot be changed."""
    key = (vehicle.model_dump_json(), manoeuvre, duration, seed, bank, front)
    if key not in _DRIVEN:
        _DRIVEN[key] = _driven(vehicle, manoeuvre, duration, seed, bank, front)
        for channel in _DRIVEN[key].channels.values():
            for column in channel.columns.values():
                column.setflags(write=False)
    return _DRIVEN[key]


_DRIVEN: dict[tuple[object, ...], Recording] = {}


def _driven(
    vehicle: Vehicle,
    manoeuvre: str,
    duration: float,
    seed: int,
    bank: Callable[[np.ndarray], np.ndarray],
    front: float,
) -> Recording:
    speed, angle, acceleration = MANOEUVRES[manoeuvre]
    t = (np.arange(round(duration / STEP)) + 0.5) * STEP
    inputs = np.zeros((len(t), len(INPUTS)))
    inputs[:, 0] = angle(t)
    inputs[:, TORQUES] = np.outer(600.0 * 0.27 * acceleration(t) / 2, [front, front, 1 - front, 1 - front])
    loop, parameters = OpenLoop(car_of(vehicle), keep=1), vehicle.parameter_vector()
    around = np.zeros((len(t), len(DISTURBANCES)))
    motion = loop.run(*rolling_straight(vehicle, speed), Inputs(STEP, inputs, around), parameters)
    if bank is not np.zeros_like:  # of places where the car has been without it, which is metres beside them
        way = motion.q[:, 0]
        around[:, BANK] = bank(way)
        around[:, BANK_CHANGE] = (bank(way + 0.5) - bank(way - 0.5)) * np.cos(motion.q[:, YAW])
        motion = loop.run(*rolling_straight(vehicle, speed), Inputs(STEP, inputs, around), parameters)
    trajectory = Trajectory(motion.t, motion.q, motion.u, motion.udot, np.zeros((len(t), 7, 4)), inputs, around)
    return record(trajectory, vehicle, seed, name=manoeuvre, biased=False)


def seconds(recording: Recording, topic: str) -> np.ndarray:
    """Times of the messages of a topic since the recording begins [s]."""
    first = min(int(channel.stamp.min()) for channel in recording.channels.values())
    return (recording[topic].stamp - first) * 1e-9


def silent(recording: Recording, begin: float, end: float, *topics: str) -> Recording:
    """Without the messages of some topics between two times [s]."""
    channels = dict(recording.channels)
    for topic in topics:
        t, channel = seconds(recording, topic), recording[topic]
        rows = (t < begin) | (t > end)
        columns = {name: value[rows] for name, value in channel.columns.items()}
        channels[topic] = replace(channel, stamp=channel.stamp[rows], received=channel.received[rows], columns=columns)
    return replace(recording, channels=channels)


def without(vehicle: Vehicle, *kinds: str) -> Vehicle:
    """The car without sensors of these kinds."""
    sensors = {name: sensor for name, sensor in vehicle.sensors.items() if sensor.kind not in kinds}
    return vehicle.model_copy(update={"sensors": sensors})


def unheard(recording: Recording, *topics: str) -> Recording:
    """The recording without some of its topics."""
    return replace(recording, channels={k: c for k, c in recording.channels.items() if k not in topics})
