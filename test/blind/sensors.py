"""What the sensors of a car record of a logged motion: noise, steps, delays, wrong mountings; two grades of sensors.

The noise is that of Leung 2010, tables B.1 and B.2 ("simple"), and a fifth of it as in cars of today ("automotive").
Leung's constant biases (1 °/s, 5° at the steering wheel) are hidden effects here; what is left of a bias after the
usual zeroing at rest is small and stated in the vehicle file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymap3d

from blind.knobs import KNOBS
from blind.plants.log import PERIOD, rotation
from vsense_ros.messages.recording import Channel, Recording

EPOCH = 1_600_000_000_000_000_000  # [ns]
ORIGIN = (48.1, 11.6, 500.0)  # latitude, longitude [deg], height [m]
WHEELS = ("fl", "fr", "rl", "rr")


@dataclass(frozen=True)
class Grade:
    """Standard deviations; biases are what zeroing at rest has left."""

    gyro: float  # [rad/s]
    gyro_bias: float
    accelerometer: float  # [m/s²]
    accelerometer_bias: float
    handwheel: float  # [rad]
    handwheel_bias: float
    wheel: float  # [rad/s]
    position: float  # [m]
    velocity: float  # [m/s]


GRADES = {
    "automotive": Grade(3.5e-4, 4e-4, 0.10, 0.02, 0.0035, 0.0035, 0.03, 0.6, 0.025),
    "simple": Grade(1.75e-3, 9e-4, 0.50, 0.04, 0.0175, 0.007, 0.06, 3.0, 0.025),
}

GNSS_LATENCY = 0.12  # [s] from measurement to arrival
POSITION_TIME = 40.0  # [s] over which errors of GNSS positions persist
STEPS = {"gyro": 2**-12, "force": 2**-9, "wheel": 2**-6, "handwheel": 2**-10, "torque": 2.0, "velocity": 2**-10}


@dataclass(frozen=True)
class Recorder:
    """How a recording is made, whatever the sensors are."""

    gnss_period: float = 0.1  # [s]
    coarse: int = 1  # steps of CAN signals, over those of `STEPS`

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Recorder:
        return cls(1 / float(rng.choice((1.0, 2.0, 5.0, 10.0, 25.0))), int(rng.choice((1, 4, 16))))


AS_USUAL = Recorder()


@dataclass(frozen=True)
class Mounting:
    """Where the vehicle file says that the sensors are, from cog [m]."""

    imu: tuple[float, float, float]
    gnss: tuple[float, float, float]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Mounting:
        return cls(
            (round(rng.uniform(-0.2, 0.4), 2), 0.0, round(rng.uniform(-0.25, 0.1), 2)),
            (round(rng.uniform(-0.9, 0.3), 2), 0.0, round(rng.uniform(0.8, 1.0), 2)),
        )


@dataclass(frozen=True)
class Biases:
    """What is constant in one case, over all its recordings."""

    gyro: np.ndarray
    accelerometer: np.ndarray
    handwheel: float

    @classmethod
    def drawn(cls, grade: Grade, rng: np.random.Generator) -> Biases:
        return cls(
            grade.gyro_bias * rng.standard_normal(3),
            grade.accelerometer_bias * rng.standard_normal(3),
            grade.handwheel_bias * rng.standard_normal(),
        )


class Bench:
    """The sensors of one case."""

    def __init__(self, grade: str, mounting: Mounting, biases: Biases, values, recorder: Recorder = AS_USUAL) -> None:
        self.grade, self.mounting, self.biases, self.recorder = GRADES[grade], mounting, biases, recorder
        self.knobs = {name: np.array(values.get(name, np.zeros(n) if n > 1 else 0.0)) for name, (n, _) in KNOBS.items()}

    def record(self, lane, name: str, start: int, rng: np.random.Generator, *, gnss: bool = True) -> Recording:
        """Messages of one lane of a log; `start` counts the recordings, each a minute after the one before."""
        clock = EPOCH + start * 120_000_000_000
        end = (len(lane["position"]) - 1) * PERIOD
        channels = [
            self._imu(lane, clock, end, rng),
            self._joints(lane, clock, end, rng, "wheel_speeds", 0.02, 0.003, "wheel_delay", 0.002),
            self._joints(lane, clock, end, rng, "steering", 0.01, 0.005, "steering_delay", 0.002),
            self._joints(lane, clock, end, rng, "wheel_torques", 0.02, 0.007, None, 0.002),
        ]
        if gnss:
            channels += self._gnss(lane, clock, end, rng)
        latitude, longitude, height = ORIGIN
        origin = {"latitude_deg": latitude, "longitude_deg": longitude, "altitude_m": height}
        metadata = {f"origin_{key}": f"{value}" for key, value in origin.items()} | {"manoeuvre": name}
        return Recording({c.topic: c for c in channels}, name=name, metadata=metadata)

    def _times(self, end: float, period: float, phase: float) -> np.ndarray:
        return np.arange(phase, end + 1e-9, period)

    def _imu(self, lane, clock, end, rng) -> Channel:
        t = self._times(end, 0.01, 0.0)
        at = t - self.knobs["imu_delay"]
        rates, turning, force = (_at(lane[name], at) for name in ("rates", "turning", "force"))
        place = np.array(self.mounting.imu) + self.knobs["imu_place"]
        force = force + np.cross(turning, place) + np.cross(rates, np.cross(rates, place))
        lean = self.knobs["imu_roll_sense"] * _at(lane["angles"], at)[:, 0]
        across, upward = force[:, 1].copy(), force[:, 2].copy()
        force[:, 1] = np.cos(lean) * across + np.sin(lean) * upward
        force[:, 2] = np.cos(lean) * upward - np.sin(lean) * across
        turned = rotation(*self.knobs["imu_attitude"])
        acceleration = force.copy()
        rates, force = rates @ turned, force @ turned
        rates = rates * (1 + self.knobs["gyro_scale"]) + self.knobs["gyro_bias"] + self.biases.gyro
        rates[:, 2] += self.knobs["gyro_by_acceleration"] * acceleration[:, 1]
        force[:, :2] += self.knobs["accelerometer_square"] * force[:, :2] * np.abs(force[:, :2])
        force = force + self.knobs["accelerometer_bias"] + self.biases.accelerometer
        rates = rates + self.grade.gyro * rng.standard_normal(rates.shape)
        force = force + self.grade.accelerometer * rng.standard_normal(force.shape)
        columns = {
            "orientation": _repeated([0, 0, 0, 1], len(t)),
            "orientation_covariance": _repeated([-1, *[0] * 8], len(t)),
            "angular_velocity": _stepped(rates, STEPS["gyro"]),
            "angular_velocity_covariance": _repeated(np.eye(3).ravel() * self.grade.gyro**2, len(t)),
            "linear_acceleration": _stepped(force, STEPS["force"]),
            "linear_acceleration_covariance": _repeated(np.eye(3).ravel() * self.grade.accelerometer**2, len(t)),
        }
        return _channel("imu/data", "sensor_msgs/msg/Imu", clock, t, 0.001, columns, "imu_link")

    def _joints(self, lane, clock, end, rng, kind, period, phase, delay, arrival) -> Channel:
        t = self._times(end, period, phase)
        at = t - (self.knobs[delay] if delay else 0.0)
        names = tuple(f"wheel_{wheel}" for wheel in WHEELS)
        columns = {field: np.zeros((len(t), 0)) for field in ("position", "velocity", "effort")}
        if kind == "wheel_speeds":
            value = _at(lane["spin"], at)
            columns["velocity"] = self._on_can(value + self.grade.wheel * rng.standard_normal(value.shape), "wheel")
        elif kind == "steering":
            names = ("steering_wheel",)
            value = _at(lane["handwheel"], at) + self.biases.handwheel
            value = value + self.grade.handwheel * rng.standard_normal(value.shape)
            columns["position"] = self._on_can(value, "handwheel")
        else:
            columns["effort"] = self._on_can(_at(lane["torque"], at), "torque")
        return _channel(f"vehicle/{kind}", "sensor_msgs/msg/JointState", clock, t, arrival, columns, "", names)

    def _on_can(self, value: np.ndarray, signal: str) -> np.ndarray:
        return _stepped(value, self.recorder.coarse * STEPS[signal])

    def _gnss(self, lane, clock, end, rng) -> list[Channel]:
        t = self._times(end, self.recorder.gnss_period, 0.0)
        at = t - self.knobs["gnss_delay"]
        position, velocity, rates = (_at(lane[name], at) for name in ("position", "velocity", "rates"))
        place = np.array(self.mounting.gnss) + self.knobs["gnss_place"]
        to_map = rotation(*_at(lane["angles"], at).T)
        antenna = position + np.einsum("ijn,j->ni", to_map, place)
        moving = np.einsum("ijn,nj->ni", to_map, velocity + np.cross(rates, place))
        sigma = self.grade.position * np.array([1, 1, 2])
        antenna = antenna + sigma * _persistent(len(t), self.recorder.gnss_period, rng)
        moving = moving + self.grade.velocity * np.array([1, 1, 2]) * rng.standard_normal(moving.shape)
        geodetic = [np.asarray(c)[:, None] for c in pymap3d.enu2geodetic(*antenna.T, *ORIGIN)]
        fix = {
            "status": np.zeros((len(t), 1)),
            "service": np.ones((len(t), 1)),
            "latitude": _stepped(geodetic[0], 2**-27),
            "longitude": _stepped(geodetic[1], 2**-27),
            "altitude": _stepped(geodetic[2], 2**-10),
            "position_covariance": _repeated(np.diag(sigma**2).ravel(), len(t)),
            "position_covariance_type": _repeated([2], len(t)),
        }
        covariance = np.zeros(36)
        covariance[[0, 7, 14]] = np.square(self.grade.velocity * np.array([1, 1, 2]))
        twist = {
            "linear": _stepped(moving, STEPS["velocity"]),
            "angular": np.zeros((len(t), 3)),
            "covariance": _repeated(covariance, len(t)),
        }
        late = GNSS_LATENCY
        return [
            _channel("gps/fix", "sensor_msgs/msg/NavSatFix", clock, t, late, fix, "gnss_link"),
            _channel("gps/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped", clock, t, late, twist, "map"),
        ]


def _at(columns: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Linear interpolation of a log between its rows; the first row stands before the start."""
    place = np.clip(times / PERIOD, 0, len(columns) - 1)
    row = np.minimum(place.astype(int), len(columns) - 2)
    share = (place - row)[:, None]
    return columns[row] * (1 - share) + columns[row + 1] * share


def _persistent(count: int, period: float, rng: np.random.Generator) -> np.ndarray:
    """Unit variance, correlated over `POSITION_TIME` for the most part, (count, 3)."""
    keep = np.exp(-period / POSITION_TIME)
    noise = rng.standard_normal((count, 3)) * np.sqrt(1 - keep**2)
    noise[0] = rng.standard_normal(3)
    for i in range(1, count):
        noise[i] += keep * noise[i - 1]
    return 0.95 * noise + np.sqrt(1 - 0.95**2) * rng.standard_normal((count, 3))


def _stepped(value: np.ndarray, step: float) -> np.ndarray:
    return np.rint(value / step) * step + 0.0


def _repeated(row, count: int) -> np.ndarray:
    return np.tile(np.asarray(row, dtype=float), (count, 1))


def _channel(topic, kind, clock, times, arrival, columns, frame="", names=()) -> Channel:
    stamp = clock + np.rint(times * 1e9).astype(np.int64)
    return Channel(topic, kind, stamp, stamp + round(arrival * 1e9), columns, frame, names)
