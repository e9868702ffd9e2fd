"""Mass of a car or truck and grade of its road, from what drives and brakes it, over minutes of whatever road.

    Σ T / R (1 + k) = (m + Σ J / R²) v̇ + m g (s + c) + d v²,      f = (1 + p) v̇ + g s + b,      w = v s

with torques T at the wheels, wheels of radius R and inertia J, the specific force f along the car, and the vertical
speed w by GNSS. Mass m, rolling resistance c, drag d, bias b of the accelerometer, how much more it reads as the body
pitches (p), and the scale error k of the torques are constants; the sine s of the grade changes along the road, and v̇
is a new number in each second. Torques and mass have their scale in common, so that the mass is never better known than
the torques are. It is not known at all from a steady drive on a level road, nor without torques; then there is none.
After Vahidi, Stefanopoulou & Peng (2005, Vehicle System Dynamics 43), who forget instead of stating what is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.identification.averages import AVERAGES, ByAverages, Mean
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.sensors import WheelTorques
from vsense_ros.model.vehicle import Vehicle

TOPIC = "vsense/mass_and_grade"


@dataclass(frozen=True)
class MassSettings:
    """Which driving is used, what is known before, and when a mass is published: decisions of this project."""

    least_speed: float = 3.0  # [m/s]
    largest_lateral: float = 1.5  # [m/s²] beyond which tyres drag as they slip
    largest_acceleration: float = 3.0  # [m/s²] beyond which they slip along
    mass: float = 0.5  # [-] standard deviation of the mass of the vehicle file, as a share: a load
    mass_walk: float = 1e-5  # [-/√s] by which it changes: fuel
    rolling: float = 0.004  # [-] of the rolling resistance coefficient
    drag: float = 0.3  # [-] of the drag, as a share, and
    least_drag: float = 0.2  # [N s²/m²] at least
    pitch: tuple[float, float] = (0.02, 0.02)  # [-] p: bodies pitch by about a degree per g, which is 0.02
    torque_scale: float = 0.03  # [-] of the torques
    bias: float = 0.1  # [m/s²] of the accelerometer, with its mounting
    grade: float = 0.03  # [-] standard deviation of the grade of a road
    grade_length: float = 200.0  # [m] along which it changes
    wheels: float = 0.03  # [m/s²] of an acceleration by the wheels in one second
    inertial: float = 0.05  # [m/s²] of a specific force in one second, as the body shakes
    force: float = 0.03  # [-] of the driving force in one second, as a share, and
    wind: float = 0.04  # [m/s²] times the mass: gusts, bends
    climb: float = 0.1  # [m/s] of a vertical speed, as receivers err for seconds
    determined: float = 0.08  # [-] standard deviation of a mass that is published, as a share


SETTINGS = MassSettings()


class _Straight(StateSpace):
    """See the module. Mass, drag and inertia are relative to the mass of the vehicle file."""

    names = ("mass", "rolling", "drag", "pitch", "torque_scale", "bias", "grade", "acceleration")
    inputs = ("speed",)
    parameters = ("wheel_inertia",)

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        lasting = ca.exp(-h * u.speed / SETTINGS.grade_length)
        return ca.vertcat(x.vector[:6], x.grade * lasting, x.acceleration)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        change = 1 - ca.exp(-2 * h * u.speed / SETTINGS.grade_length)
        return ca.vertcat(h * SETTINGS.mass_walk**2, ca.SX.zeros(5), change * SETTINGS.grade**2, 0)


def _force(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    """Driving force over the mass of the vehicle file [m/s²]."""
    weight = GRAVITY * (x.grade + x.rolling)
    needed = x.mass * (x.acceleration + weight) + p.wheel_inertia * x.acceleration + x.drag * u.speed**2
    return needed / (1 + x.torque_scale)


_WHEELS = Measurement("wheels", lambda x, z, u, p: x.acceleration, (SETTINGS.wheels,))
_INERTIAL = Measurement(
    "inertial", lambda x, z, u, p: (1 + x.pitch) * x.acceleration + GRAVITY * x.grade + x.bias, (SETTINGS.inertial,)
)
_TORQUES = Measurement("torques", _force, (SETTINGS.wind,), gate=5.0)
_CLIMB = Measurement("climb", lambda x, z, u, p: u.speed * x.grade, (SETTINGS.climb,), gate=5.0)


class MassAndGrade(ByAverages):
    """Mass and grade of one vehicle. `add` takes messages in order of arrival, `sample` is what is published.

    Raises `InputError` for a vehicle without wheel speeds or an inertial sensor.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        physics = vehicle.physics
        self.nominal = physics.chassis.mass
        inertia = sum(2 * one.wheel_spin_inertia / r**2 for one, r in
                      zip((physics.front, physics.rear), self.averages.radii[[0, 2]], strict=True))  # fmt: skip
        numbers = {"wheel_inertia": inertia / self.nominal}
        self._filter = Ekf(Dense(_Straight(), (_WHEELS, _INERTIAL, _TORQUES, _CLIMB), numbers))
        drag = 0.5 * AIR_DENSITY * physics.aerodynamics.drag_area
        rolling = (physics.front.rolling_resistance + physics.rear.rolling_resistance) / 2
        mean = [1.0, rolling, drag / self.nominal, SETTINGS.pitch[0], 0.0, 0.0, 0.0, 0.0]
        deviations = [
            SETTINGS.mass, SETTINGS.rolling, max(SETTINGS.drag * drag, SETTINGS.least_drag) / self.nominal,
            SETTINGS.pitch[1], SETTINGS.torque_scale, SETTINGS.bias, SETTINGS.grade, 1.0,
        ]  # fmt: skip
        self._filter.inputs[:] = SETTINGS.least_speed
        self._filter.start(Gaussian(np.array(mean), np.diag(np.square(deviations))))
        self.stamp = 0  # of the last second that was used [ns]

    def _use(self, mean: Mean) -> bool:
        speed, acceleration = float(np.median(mean.spin * self.averages.radii)), mean.acceleration
        lateral, along = abs(speed * mean.rates[2]), mean.rates[3]
        if not (
            speed > SETTINGS.least_speed
            and lateral < SETTINGS.largest_lateral
            and abs(acceleration) < SETTINGS.largest_acceleration
        ):
            return False
        filter, covariance = self._filter, self._filter.covariance
        filter.inputs[:] = speed
        filter.predict((mean.stamp - self.stamp) * 1e-9 if self.stamp else AVERAGES.length)
        covariance[-1, :] = covariance[:, -1] = 0.0  # the acceleration is a new one
        covariance[-1, -1], filter.mean[-1] = SETTINGS.largest_acceleration**2, acceleration
        filter.correct(*_WHEELS.measured([acceleration]))
        if np.isfinite(along):
            filter.correct(*_INERTIAL.measured([along]))
        climb, deviation = mean.vertical_speed
        if np.isfinite(climb):
            filter.correct(*_CLIMB.measured([climb], np.array([deviation**2 + SETTINGS.climb**2])))
        if np.isfinite(mean.torques).all():
            force = float(np.sum(mean.torques / self.averages.radii)) / self.nominal
            noise = 2 * self.torque_noise / float(self.averages.radii.mean()) / self.nominal
            variance = noise**2 + (SETTINGS.force * force) ** 2 + (SETTINGS.wind * filter.mean[0]) ** 2
            filter.correct(*_TORQUES.measured([force], np.array([variance])))
        self.stamp = mean.stamp
        return True

    @property
    def torque_noise(self) -> float:
        """Standard deviation of the torque at a wheel [N m]."""
        sensor = self.averages.sensors[WheelTorques]
        assert isinstance(sensor, WheelTorques)
        return sensor.noise

    def mass(self) -> tuple[float, float] | None:
        """Mass and its standard deviation [kg]; None where the drive has not determined it."""
        mean, deviation = self._filter.mean[0], float(np.sqrt(self._filter.covariance[0, 0]))
        if not deviation < SETTINGS.determined * mean:
            return None
        return float(mean) * self.nominal, deviation * self.nominal

    def grade(self) -> tuple[float, float]:
        """Grade of the road and its standard deviation [rad]."""
        sine = float(np.clip(self._filter.mean[6], -1, 1))
        return float(np.arcsin(sine)), float(np.sqrt(self._filter.covariance[6, 6]))

    def diagnostic(self) -> Diagnostic:
        """A line that says the mass, or why there is none."""
        mass = self.mass()
        if mass is not None:
            text = f"{mass[0]:.0f} ± {mass[1]:.0f} kg; vehicle file {self.nominal:.0f} kg"
        elif WheelTorques not in self.averages.sensors:
            text = "no mass without wheel torques"
        else:
            text = "not determined yet: it needs acceleration, braking or hills"
        return Diagnostic("mass", Level.OK, text)

    def sample(self) -> Sample:
        """What is published: `mass` [kg], if it is determined, and `grade` [rad] as position, their standard deviations
        as velocity."""
        mass = self.mass()
        estimates = {"grade": self.grade()} if mass is None else {"mass": mass, "grade": self.grade()}
        values: dict[str, Array] = {
            "position": np.array([value for value, _ in estimates.values()]),
            "velocity": np.array([deviation for _, deviation in estimates.values()]),
            "effort": np.zeros(0),
        }
        return Sample(TOPIC, "sensor_msgs/msg/JointState", self.stamp, values, names=tuple(estimates))


def mass_in(recording: Recording, vehicle: Vehicle) -> MassAndGrade | None:
    """Mass after a recording; None if it has not the sensors for it, torques among them."""
    try:
        estimator = MassAndGrade(vehicle)
    except InputError:
        return None
    torques = estimator.averages.sensors.get(WheelTorques)
    if torques is None or not all(one.topic in recording for one in (torques, *estimator.averages.needed)):
        return None
    estimator.take(recording)
    return estimator
