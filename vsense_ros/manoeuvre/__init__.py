"""Generated test drives, one file each: what a car with known forces would have recorded.

To add one: write its file, add it here.
"""

from __future__ import annotations

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.manoeuvre import (
    accelerate_and_brake,
    banked_oval,
    brake_in_turn,
    coast_down,
    double_lane_change,
    hills,
    leung_tracks,
    rear_step_steer,
    sine_with_dwell,
    slow_ramp_steer,
    steady_state_circle,
    steering_sweep,
    step_steer,
    stop_and_go,
    throttle_and_steer,
    trailer_sway,
)
from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.coordinates import ROLL
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.simulation.full_car import simulate_full_car
from vsense_ros.model.vehicle import Vehicle

STANDARD = tuple(
    module.MANOEUVRE for module in (double_lane_change, step_steer, sine_with_dwell, steady_state_circle, brake_in_turn)
)
ON_ROADS = (hills.MANOEUVRE, banked_oval.MANOEUVRE)
IN_BAGS = (*STANDARD, *ON_ROADS)  # those that stand in bags/
# Those that a test of a car may be made of.
TESTS = (
    *STANDARD,
    *(m.MANOEUVRE for m in (accelerate_and_brake, coast_down, slow_ramp_steer, steering_sweep)),
)
_OTHERS = (
    *(module.MANOEUVRE for module in (stop_and_go, rear_step_steer, trailer_sway)),
    *throttle_and_steer.MANOEUVRES,
    *leung_tracks.MANOEUVRES,
)
MANOEUVRES = {m.name: m for m in (*TESTS, *ON_ROADS, *_OTHERS)}
STEP = 1e-3  # [s] of the simulation
_OVERTURNED = 1.0  # [rad] of roll, from which no car comes back

__all__ = ["IN_BAGS", "MANOEUVRES", "STANDARD", "TESTS", "Manoeuvre", "drive", "generate", "recorded", "upright_drive"]


def drive(name: str | Manoeuvre, vehicle: Vehicle, *, step: float = STEP) -> Trajectory:
    """What `vehicle` does in a manoeuvre, every millisecond, in steps of `step` [s], of which a millisecond has a whole
    number. Raises `InputError` for an unknown name."""
    manoeuvre = _find(name) if isinstance(name, str) else name
    if manoeuvre.friction is not None:
        vehicle = vehicle.with_parameters({"road.friction": manoeuvre.friction})
    q, u = rolling_straight(vehicle, manoeuvre.speed)
    surface = manoeuvre.surface() if manoeuvre.surface is not None else None
    simulated = simulate_full_car if surface is not None and vehicle.linkage is not None else simulate
    recorded_step, duration = round(STEP / step), manoeuvre.duration
    return simulated(
        vehicle, manoeuvre.driver(vehicle), duration, step=step, keep_every=recorded_step, q=q, u=u, surface=surface
    )


def generate(name: str, vehicle: Vehicle, seed: int = 0) -> Recording:
    """What the sensors of `vehicle` record in a manoeuvre, with the truth below `reference/`.

    The same arguments give the same recording to the last bit (see `sensing`). Raises `InputError` as `upright_drive`.
    """
    return recorded(name, upright_drive(name, vehicle), vehicle, seed)


def recorded(name: str, trajectory: Trajectory, vehicle: Vehicle, seed: int) -> Recording:
    """What the sensors of `vehicle` record on a trajectory of a manoeuvre, with noise and biases of a seed."""
    manoeuvre = _find(name)
    about = f"{manoeuvre.title}: {manoeuvre.source}"
    return record(trajectory, vehicle, seed, name=name, about=about, biased=manoeuvre.biased)


def upright_drive(name: str, vehicle: Vehicle) -> Trajectory:
    """What `vehicle` does in a manoeuvre. Raises `InputError` for an unknown name, where the car overturns, and where
    the motion leaves the model's range."""
    try:
        trajectory = drive(name, vehicle)
    except FloatingPointError as error:
        raise InputError(f"{error} of {name}; is there a value in the vehicle file that no car has?") from None
    overturned = np.flatnonzero(np.abs(trajectory.q[:, ROLL]) > _OVERTURNED)
    if len(overturned):
        seconds = trajectory.t[overturned[0]]
        raise InputError(f"{vehicle.name} overturns at {seconds:.1f} s of {name}: take a slower one, or another car")
    return trajectory


def _find(name: str) -> Manoeuvre:
    if name not in MANOEUVRES:
        raise InputError(f"no manoeuvre {name!r}; known are {', '.join(MANOEUVRES)}")
    return MANOEUVRES[name]
