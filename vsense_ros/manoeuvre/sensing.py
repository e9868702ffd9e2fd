"""From a simulated motion to what the sensors of the car would have recorded.

Sensors are those of the vehicle file: the same equations that the observer uses, plus white noise and constant biases
of the standard deviations that the file states, sampled, quantized and delayed as real ones are. When a sensor measures
and what its messages say, its kind knows (`model.sensors`).

Reproducible bits. Noise comes from NumPy's `RandomState`, whose stream is frozen for good (NEP 19; the stream of its
successor may change between versions). Everything that is written is rounded to a multiple of a power of two that is
far above rounding errors and far below the noise, so that another compiler, processor or linear algebra, whose results
differ in the last bits, still gives the same file, except where a value comes to lie on the very edge of a step. That
is improbable for any one bag (about one in a hundred), and shows as one step of quantization.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.pose import orientation_on_map, position_on_map
from vsense_ros.model.car.steps import sensor_functions
from vsense_ros.model.coordinates import (
    DISTURBANCES,
    MOMENT,
    RATES,
    VELOCITY,
    WHEEL_FORCES,
    WHEELS,
    YAW_RATE,
)
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive, quantized
from vsense_ros.model.simulation.closed_loop import Array, Trajectory
from vsense_ros.model.trailer import Trailer
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class SensingSettings:
    """Where and when simulated recordings are made."""

    epoch: int = 1_593_043_200_000_000_000  # [ns] 2020-06-25 00:00 UTC: a recording is always made at the same time
    # latitude [deg], longitude [deg] and height [m] of the map's origin
    origin: tuple[float, float, float] = (43.5, -8.2, 50.0)
    reference_period_ms: int = 10  # [ms] of the reference


SENSING = SensingSettings()


def record(
    trajectory: Trajectory,
    vehicle: Vehicle,
    seed: int,
    *,
    name: str,
    about: str = "",
    biased: bool = True,
    every: int | None = None,
) -> Recording:
    """Messages of the vehicle's sensors on a trajectory with steps of 1 ms, and the truth below `reference/`.

    `biased=False` leaves the constant errors out. With `every` [ms] all sensors of the car itself measure at the same
    instants, instead of each at its own. A kind without a `sampling` gives nothing. Raises `InputError` where two
    sensors have one topic.
    """
    rng = np.random.RandomState(seed)
    channels: list[Channel] = []
    of_trailer = {name: sensor for name, sensor in vehicle.sensors.items() if sensor.of_trailer}
    for sensor in (vehicle.sensing() | of_trailer).values():
        usual = sensor.simulated_sampling
        if usual is not None:
            if sensor.topic in {channel.topic for channel in channels}:
                raise InputError(
                    f"two sensors of {vehicle.name} would send on {sensor.topic} in a simulation: give the "
                    f"{sensor.kind} a topic of its own"
                )
            sampling = _sampling(usual, every)
            rows = np.arange(sampling.phase, len(trajectory.t), sampling.period)
            truth = _truth(trajectory, vehicle, sensor, rows)
            older = np.round((sensor.ages() - sensor.latency) * 1e3).astype(int)  # [ms]
            for age in set(older[older != 0].tolist()):
                then = np.clip(rows - age, 0, len(trajectory.t) - 1)
                truth[:, older == age] = _truth(trajectory, vehicle, sensor, then)[:, older == age]
            steps, limit = np.array(sampling.quantum), np.array(sampling.limit)
            place = position_on_map(trajectory.q[rows], _around(trajectory)[rows])
            climb = partial(_climb, trajectory, rows)
            drive = SimulatedDrive(truth, place, SENSING.origin, rng, float(biased), steps, climb, limit)
            channels.append(_channel(sensor, rows, sampling, sensor.simulated(drive)))
    channels += _reference(trajectory)
    if vehicle.physics.trailer is not None:
        channels.append(_articulation(trajectory, vehicle))
    latitude, longitude, height = SENSING.origin
    return Recording(
        {c.topic: c for c in channels},
        name=name,
        metadata={
            "origin_latitude_deg": f"{latitude}",
            "origin_longitude_deg": f"{longitude}",
            "origin_altitude_m": f"{height}",
            "vehicle": vehicle.name,
            "manoeuvre": about,
            "seed": f"{seed}",
        },
    )


def _sampling(usual: Sampling, every: int | None) -> Sampling:
    """When a sensor measures if all of the car do so `every` so many ms."""
    return usual if every is None or usual.own_clock else replace(usual, period=every, phase=0)


def _truth(trajectory: Trajectory, vehicle: Vehicle, sensor: SensorBase, rows: np.ndarray) -> Array:
    """What a perfect sensor would give at some instants of a trajectory, (rows, m)."""
    if sensor.inputs is not None:
        return trajectory.inputs[rows, sensor.inputs]
    if sensor.of_trailer:
        return _of_trailer(trajectory, vehicle, rows)[:, :1]
    function = sensor_functions(car_of(vehicle), (sensor,))[sensor.kind].map(len(rows))
    around = _around(trajectory)[rows].T
    biases, mounting = np.zeros((len(sensor.biases()), 1)), np.asarray(sensor.mounting(), dtype=float)[:, None]
    motion = (values[rows].T for values in (trajectory.q, trajectory.u, trajectory.udot))
    result = function(*motion, around, trajectory.inputs[rows].T, biases, mounting)[0]
    return np.array(result).reshape(-1, len(rows), order="F").T


def _of_trailer(trajectory: Trajectory, vehicle: Vehicle, rows: np.ndarray) -> Array:
    """Articulation angle [rad] and its rate [rad/s] at some instants, (rows, 2)."""
    assert trajectory.internal_state is not None
    state = trajectory.internal_state[rows, car_of(vehicle).internal_state_slices[Trailer.id]]
    return np.column_stack([state[:, 0], state[:, 1] - trajectory.u[rows, YAW_RATE]])


def _articulation(trajectory: Trajectory, vehicle: Vehicle) -> Channel:
    """The truth of a trailer."""
    rows = np.arange(0, len(trajectory.t), SENSING.reference_period_ms)
    stamp = SENSING.epoch + rows.astype(np.int64) * 1_000_000
    angle, rate = quantized(_of_trailer(trajectory, vehicle, rows), 2**-16).T
    columns = {"position": angle[:, None], "velocity": rate[:, None], "effort": np.zeros((len(rows), 0))}
    return Channel("reference/articulation", "sensor_msgs/msg/JointState", stamp, stamp, columns, "", ("hitch",))


def _climb(trajectory: Trajectory, rows: np.ndarray, point: Array) -> Array:
    """Upward velocity on the map (rows,) [m/s] of a point of the body (3,) [m], in the axes of `cog`: the difference of
    its heights a millisecond before and after."""
    before, after = (np.clip(rows + step, 0, len(trajectory.t) - 1) for step in (-1, 1))
    heights = []
    for then in (before, after):
        q, road = trajectory.q[then], _around(trajectory)[then]
        arm = Rotation.from_quat(orientation_on_map(q, road)).apply(point)
        heights.append(position_on_map(q, road)[:, 2] + arm[:, 2])
    return np.asarray((heights[1] - heights[0]) / (trajectory.t[after] - trajectory.t[before]))


def _around(trajectory: Trajectory) -> Array:
    """Disturbances (n, 7)."""
    recorded = trajectory.disturbances
    return np.zeros((len(trajectory.t), len(DISTURBANCES))) if recorded is None else recorded


def _channel(sensor: SensorBase, rows: np.ndarray, sampling: Sampling, content: Content) -> Channel:
    delay = round((sensor.latency + sampling.delay * 1e-3) * 1e9)
    stamp = SENSING.epoch + rows.astype(np.int64) * 1_000_000
    # `latency` is the age of a measurement at its stamp: the stamp is late by as much.
    return Channel(
        sensor.topic,
        sensor.message,
        stamp + round(sensor.latency * 1e9),
        stamp + delay,
        content.columns,
        sensor.frame_id,
        content.names,
    )


def _reference(trajectory: Trajectory) -> list[Channel]:
    rows = np.arange(0, len(trajectory.t), SENSING.reference_period_ms)
    stamp = SENSING.epoch + rows.astype(np.int64) * 1_000_000
    q, u = trajectory.q[rows], trajectory.u[rows]
    road = _around(trajectory)[rows]
    channels = [
        Channel(
            "reference/odometry",
            "nav_msgs/msg/Odometry",
            stamp,
            stamp,
            {
                "position": quantized(position_on_map(q, road), 2**-13),
                "orientation": quantized(orientation_on_map(q, road), 2**-20),
                "pose_covariance": np.zeros((len(rows), 36)),
                "linear": quantized(u[:, VELOCITY], 2**-14),
                "angular": quantized(u[:, RATES], 2**-16),
                "twist_covariance": np.zeros((len(rows), 36)),
            },
            "map",
            child_frame_id="cog",
        ),
        Channel(
            "reference/acceleration",
            "geometry_msgs/msg/AccelStamped",
            stamp,
            stamp,
            {
                "linear": quantized(trajectory.acceleration[rows], 2**-13),
                "angular": quantized(trajectory.udot[rows, RATES], 2**-13),
            },
            "cog",
        ),
    ]
    for i, wheel in enumerate(WHEELS):
        force, moment = (trajectory.wheels[rows, row, i] for row in (WHEEL_FORCES, MOMENT))
        torque = np.column_stack([np.zeros((len(rows), 2)), quantized(moment, 2**-9)])
        channels.append(
            Channel(
                f"reference/wheel_force/{wheel}",
                "geometry_msgs/msg/WrenchStamped",
                stamp,
                stamp,
                {"force": quantized(force, 2**-6), "torque": torque},
                f"contact_{wheel}",
            )
        )
    return channels
