"""A filter step by step, for loops of other people: measurements in, state and standard deviations out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsense_ros.api.result import read_estimates
from vsense_ros.api.vehicle import load_vehicle
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.estimates import quaternion
from vsense_ros.messages.recording import FIELDS, Recording, Sample
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.run import as_recording
from vsense_ros.runner.runner import Runner

Array = NDArray[np.float64]

_NANOSECONDS = 1e9  # in one second
_FIRST_STAMP = 1_000_000_000  # [ns] of the time 0: no message has a stamp of 0 or less
_JOINT_STATE = "sensor_msgs/msg/JointState"
# Fields of a message that make up the value of a sensor, by message type, and the one of their covariances.
_VALUES = {
    "sensor_msgs/msg/Imu": ("angular_velocity", "linear_acceleration"),
    "sensor_msgs/msg/NavSatFix": ("latitude", "longitude", "altitude"),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("linear",),
    "geometry_msgs/msg/TwistStamped": ("linear",),
}


class Filter:
    """One filter of one vehicle, driven step by step.

        filter = vs.Filter("genesis", filter="error_ekf")
        while driving:
            filter.step(0.01)
            filter.correct("imu", [*rates, *specific_forces])
            filter.correct("wheel_speeds", spin_speeds)
            if filter.started:
                print(filter.state["side_slip"], filter.sigma["side_slip"])

    It is what the ROS node and `vs.estimate` use: measurements that come late are used at the time they were made, what
    cannot be true is refused, faulty sensors are left out, a filter that diverges is restored.

    Args:
        vehicle: a vehicle, its file, or the name of one that comes with the project; its `sensors` have the names that
            `correct` takes.
        filter: its name, as `vsense filters` lists them; by default that of the vehicle.
        map_origin: latitude, longitude [deg] and height [m] of the origin of positions; by default the first GNSS fix.

    Raises `InputError` as `load_vehicle` does, for a filter that does not exist, and for sensors that do not suffice.
    """

    def __init__(
        self,
        vehicle: str | Path | Vehicle,
        filter: str = "",
        *,
        map_origin: tuple[float, float, float] | None = None,
    ) -> None:
        self.vehicle = load_vehicle(vehicle)
        self._runner = Runner(self.vehicle, map_origin, every_filter()[filter].make if filter else None)
        self._now = _FIRST_STAMP
        self._newest: tuple[int, dict[str, float], dict[str, float]] | None = None
        self._units: dict[str, str] = {}

    @property
    def time(self) -> float:
        """Time of the filter [s], from 0 or as `correct` was given it."""
        return (self._now - _FIRST_STAMP) / _NANOSECONDS

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors that `correct` takes."""
        return self._runner.names

    @property
    def started(self) -> bool:
        """True once the measurements suffice for a state; before, `state` is empty."""
        return self._runner.started

    def step(self, dt: float) -> None:
        """Let time go on by `dt` [s]. Raises `InputError` for a step that is negative or not finite."""
        if not 0 <= dt < np.inf:
            raise InputError(f"step: expected seconds, 0 or more, found {dt}")
        self._now += round(dt * _NANOSECONDS)
        self._newest = None

    def correct(
        self,
        sensor: str,
        value: ArrayLike | Mapping[str, ArrayLike],
        time: float | None = None,
        sigma: ArrayLike | None = None,
    ) -> None:
        """Use a measurement.

        Args:
            sensor: its name in the vehicle file.
            value: its numbers, in SI units and the axes of the sensor; NaN for one that is absent. `imu`: three rates
                [rad/s], three specific forces [m/s²]. Wheel speeds [rad/s], torques [N m] and the like: fl, fr, rl, rr.
                Steering: angle of the steering wheel [rad]. GNSS position: latitude, longitude [deg], height [m]; GNSS
                velocity: east, north, up [m/s]; GNSS heading: yaw from east [rad]. Speed: forward [m/s]. Or a mapping
                from names of joints (`road_wheel_front`, `wheel_fl`) or of the fields of the sensor's message.
            time: of the measurement [s]; by default the present one. A later one lets time go on.
            sigma: standard deviations of the numbers, one or as many; by default those of the vehicle file. Not for
                sensors whose messages state none (joints, speed).

        Raises `InputError` for a sensor that the filter does not have, and numbers of another count than it gives. A
        measurement that cannot be true raises nothing: `diagnostics` say why it was refused.
        """
        chosen = self._runner.sensors.get(sensor)
        if chosen is None:
            raise InputError(f"correct: no sensor {sensor!r}; the filter uses {', '.join(self.sensors)}")
        stamp = self._now if time is None else round(time * _NANOSECONDS) + _FIRST_STAMP
        self._now = max(self._now, stamp)
        names, fields = _message(sensor, chosen, value, sigma)
        sample = Sample(chosen.topic, chosen.message, stamp, fields, chosen.frame_id, names, received=self._now)
        self._runner.add(sample)
        self._newest = None

    @property
    def state(self) -> dict[str, float]:
        """The estimated signals at the present time, by the names that `Result` has (`side_slip`, `yaw_rate`, …), with
        `position_x` to the east and `position_y` to the north; units, SI, are in `units`. Empty before the start."""
        return self._present()[1]

    @property
    def units(self) -> dict[str, str]:
        """Units of the signals in `state`."""
        self._present()
        return self._units

    @property
    def sigma(self) -> dict[str, float]:
        """Their standard deviations, as far as the filter states them; infinite where the value means nothing."""
        return self._present()[2]

    @property
    def diagnostics(self) -> list[Diagnostic]:
        """A line for the filter (before the start: what it waits for), and one for each sensor."""
        return self._runner.diagnostics(self._now)

    def _present(self) -> tuple[int, dict[str, float], dict[str, float]]:
        if self._newest is not None:
            return self._newest
        state: dict[str, float] = {}
        sigma: dict[str, float] = {}
        snapshot = self._runner.snapshot_at(self._now) if self.started else None
        if snapshot is not None and self.started:
            output = as_recording(self._runner.adapter, [snapshot], Recording({}))
            for signal in read_estimates(output).values():
                for column in (c for c in signal.columns() if not c.name.endswith("_sigma")):
                    state[column.name], self._units[column.name] = float(column.value[0]), column.unit
                    if signal.sigma is not None:
                        sigma[column.name] = float(signal.sigma[0])
        self._newest = self._now, state, sigma
        return self._newest


def _message(
    name: str, sensor: SensorBase, value: ArrayLike | Mapping[str, ArrayLike], sigma: ArrayLike | None
) -> tuple[tuple[str, ...], dict[str, Array]]:
    """Names of joints and fields of the message with which a sensor would say this."""
    if sensor.message == _JOINT_STATE:
        if sigma is not None:
            raise _without_sigma(name)
        return _joint_state(name, sensor, value)
    if isinstance(value, Mapping):
        return (), {field: np.atleast_1d(np.asarray(numbers, float)) for field, numbers in value.items()}
    if "heading" in sensor.measures:
        return (), _heading(name, value, sigma)
    fields = _VALUES[sensor.message]
    lengths = [FIELDS[sensor.message][field] for field in fields]
    numbers = _numbers(name, value, sum(lengths))
    parts = np.split(numbers, np.cumsum(lengths)[:-1])
    return (), {**dict(zip(fields, parts, strict=True)), **_covariances(name, sensor.message, lengths, sigma)}


def _numbers(name: str, value: Any, count: int) -> Array:
    """As many numbers as a message has; those at the end that are not given are absent."""
    numbers = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    if not 1 <= len(numbers) <= count:
        raise InputError(f"correct: {name} gives {count} numbers, found {len(numbers)}")
    return np.concatenate([numbers, np.full(count - len(numbers), np.nan)])


def _joint_state(
    name: str, sensor: SensorBase, value: ArrayLike | Mapping[str, ArrayLike]
) -> tuple[tuple[str, ...], dict[str, Array]]:
    field = getattr(sensor, "field", "position")
    joints = sensor.joints or ("steering_wheel",)
    if isinstance(value, Mapping):
        joints = tuple(value)
        numbers = np.array([float(np.asarray(value[joint])) for joint in joints])
    else:
        # Joints that are not given are left out: an absent angle would hide the one that is there.
        numbers = _numbers(name, value, len(joints))[: np.size(value)]
        joints = joints[: len(numbers)]
    empty = np.zeros(0)
    return joints, {"position": empty, "velocity": empty, "effort": empty, field: numbers}


def _heading(name: str, value: ArrayLike, sigma: ArrayLike | None) -> dict[str, Array]:
    yaw = float(_numbers(name, value, 1)[0])
    covariance = np.zeros(9)
    if sigma is not None:
        covariance[8] = float(_numbers(name, sigma, 1)[0]) ** 2
    return {"orientation": quaternion(np.array([0.0, 0.0, yaw])), "orientation_covariance": covariance}


def _covariances(name: str, message: str, lengths: list[int], sigma: ArrayLike | None) -> dict[str, Array]:
    """The fields of covariances, of which zeros say that they are not known."""
    count = sum(lengths)
    variance = np.zeros(count)
    if sigma is not None:
        deviations = np.atleast_1d(np.asarray(sigma, dtype=float)).ravel()
        if len(deviations) not in (1, count) or not (deviations > 0).all():
            raise InputError(f"correct: {name} takes one positive sigma or {count}, found {deviations.tolist()}")
        variance = np.broadcast_to(deviations**2, count)
    if message == "sensor_msgs/msg/Imu":
        return {
            "angular_velocity_covariance": np.diag(variance[:3]).ravel(),
            "linear_acceleration_covariance": np.diag(variance[3:]).ravel(),
        }
    if message == "sensor_msgs/msg/NavSatFix":
        return {"position_covariance": np.diag(variance).ravel()}
    if message == "geometry_msgs/msg/TwistWithCovarianceStamped":
        return {"covariance": np.diag(np.concatenate([variance, np.zeros(3)])).ravel()}
    if sigma is not None:
        raise _without_sigma(name)
    return {}


def _without_sigma(name: str) -> InputError:
    return InputError(f"correct: {name} takes no sigma, as its messages state none; set its noise in the vehicle file")
