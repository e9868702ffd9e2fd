"""Rolling radii of the wheels while a car drives, and which tyre has lost pressure.

A wheel that rolls straight turns by the way of its hub over its rolling radius, which a loss of pressure makes smaller.
Speeds of wheels are compared with that over ground by GNSS and with one another, in gentle driving:

    ω_i R_i (1 + ρ_i) = |(v - r y_i, r x_i)| (1 + s f + o),      r = r_m - b,      ψ̇ = r

with the radius error ρ of each wheel at x_i ahead of the rear axle and y_i to the left, the bias b of the gyro, the
slip s of an axle per specific force f along the car, and what remains o of it: resistances and the bias of the
accelerometer. All are states of one filter, and so is the course ψ, which GNSS measures: a bias turns the wheels of one
side slower, as another radius does. Where there is no GNSS, the speed v of each second is unknown, and the wheels are
compared with one another alone. This is the indirect monitoring of tyre pressure by wheel radii (Persson, Gustafsson &
Drevö 2002, SAE 2002-01-1250).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification.averages import AVERAGES, ByAverages, Mean
from vsense_ros.identification.online import fingerprint
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.constants import AIR_DENSITY
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.sensors import GnssVelocity
from vsense_ros.model.sensors.wheel_speeds import NAMES
from vsense_ros.model.vehicle import Vehicle

TOPIC = "vsense/tyre_radii"


@dataclass(frozen=True)
class TyreRadiiSettings:
    """What is gentle driving, what is known before, and when a tyre is reported: decisions of this project."""

    least_speed: float = 8.0  # [m/s]
    largest_lateral: float = 1.0  # [m/s²] by speed and yaw rate
    largest_force: float = 1.5  # [m/s²] specific force along the car
    radius: float = 0.02  # [-] standard deviation of a radius before
    walk: float = 2e-5  # [-/√s] by which it changes: a tyre that warms up, 0.1 % in an hour
    slip: float = 0.01  # [s²/m] of an axle per specific force: 1858 kg on two tyres of 100 kN are 0.009
    rest: float = 1e-3  # [-] of slip without drive
    gyro_bias: float = 0.01  # [rad/s]
    gyro_walk: float = 1e-5  # [rad/s/√s]
    leaning: float = 1e-3  # [s²/m] by which the load that a bend moves changes a radius, per lateral acceleration
    form: float = 3e-4  # [-] of a wheel's speed within a second, that no formula here has: road, steering, play
    ground: float = 0.02  # [m/s] of a speed over ground, that its receiver does not state
    drifting: float = 0.01  # [rad] by which the course is not the integral of the yaw rate: side slip
    alike: float = 0.003  # [-] by which tyres of one size and age differ, where no radii of right pressures are stored
    significant: float = 3.0  # standard deviations of a tyre that is reported
    determined: float = 0.002  # [-] standard deviation below the others, from which on it may be


SETTINGS = TyreRadiiSettings()
RADII = tuple(f"radius_error_{wheel}" for wheel in WHEELS)


class _Rolling(StateSpace):
    """See the module. The speed is one of a second alone."""

    names = (*RADII, "gyro_bias", "slip_front", "slip_rear", "rest_front", "rest_rear", "course", "speed")
    inputs = ("yaw_rate", "force")
    parameters = ("wheelbase", "front_track", "rear_track", "antenna_ahead", "antenna_aside")

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return ca.vertcat(x.vector[:9], x.course + h * (u.yaw_rate - x.gyro_bias), x.speed)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return h * ca.DM([SETTINGS.walk**2] * 4 + [SETTINGS.gyro_walk**2] + [0.0] * 6)


def _hubs(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    """What the wheels turn by times their radii of the vehicle file, (4,) [m/s]."""
    rate = u.yaw_rate - x.gyro_bias
    radii = []
    for i, wheel in enumerate(WHEELS):
        axle, left = ("front", "rear")[i // 2], 1 - 2 * (i % 2)
        along = x.speed - left * rate * p[f"{axle}_track"] / 2
        hub = ca.sqrt(along**2 + (rate * p.wheelbase) ** 2) if axle == "front" else along
        slip = x[f"slip_{axle}"] * u.force + x[f"rest_{axle}"]
        radii.append(hub * (1 + slip) / (1 + x[f"radius_error_{wheel}"]))
    return ca.vertcat(*radii)


def _ground(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    """Speed of the antenna over ground; the rear axle moves along the car, but for the slip of its tyres."""
    rate = u.yaw_rate - x.gyro_bias
    return ca.sqrt((x.speed - rate * p.antenna_aside) ** 2 + (rate * p.antenna_ahead) ** 2)


def _course(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    """Course in the middle of the last second, whose end the state is at."""
    rate = u.yaw_rate - x.gyro_bias
    return x.course - AVERAGES.length / 2 * rate + rate * p.antenna_ahead / x.speed


_WHEELS = Measurement("wheels", _hubs, (SETTINGS.form,) * 4, gate=5.0)
_GNSS = Measurement("gnss", _ground, (SETTINGS.ground,), gate=5.0)
_COURSE = Measurement("course", _course, (SETTINGS.drifting,), angles=(0,), gate=5.0)


class TyreRadii(ByAverages):
    """Tyre radii of one vehicle. `add` takes messages in order of arrival, `sample` is what is published, `stored` the
    file of radii that belong to right pressures, if they are known.

    Raises `InputError` for a vehicle without wheel speeds or an inertial sensor, and for a file of another vehicle.
    """

    def __init__(self, vehicle: Vehicle, stored: Path | None = None) -> None:
        super().__init__(vehicle)
        self.vehicle, self.stored = vehicle, stored
        chassis, physics = vehicle.physics.chassis, vehicle.physics
        antenna = self.averages.sensors.get(GnssVelocity)
        place = np.zeros(3) if antenna is None else antenna.mounting()
        numbers = {
            "wheelbase": chassis.cog_to_front_axle + chassis.cog_to_rear_axle,
            "front_track": physics.front.track,
            "rear_track": physics.rear.track,
            "antenna_ahead": place[0] + chassis.cog_to_rear_axle,
            "antenna_aside": place[1],
        }
        self._drag = 0.5 * AIR_DENSITY * physics.aerodynamics.drag_area / chassis.mass
        self._filter = Ekf(Dense(_Rolling(), (_WHEELS, _GNSS, _COURSE), numbers))
        deviations = [
            *[SETTINGS.radius] * 4,
            SETTINGS.gyro_bias,
            *[SETTINGS.slip] * 2,
            *[SETTINGS.rest] * 2,
            np.pi,
            1.0,
        ]
        self._filter.inputs[:] = 0.0
        self._filter.start(Gaussian(np.r_[np.zeros(10), 1.0], np.diag(np.square(deviations))))
        self.stamp, self.used = 0, 0.0  # of the last second [ns]; driven gently [s]
        self._right: tuple[Array, Array] | None = None  # radii at right pressures, and their covariance
        if stored is not None and stored.exists():
            self._right = self._load(stored)

    def _use(self, mean: Mean) -> bool:
        rolling = mean.spin * self.averages.radii
        speed = float(np.median(rolling))
        rate, force = mean.rates[2], mean.rates[3]
        if not (speed > SETTINGS.least_speed and np.isfinite([rate, force]).all()):
            return False
        filter = self._filter
        filter.inputs[:] = rate, force + self._drag * speed**2
        elapsed = (mean.stamp - self.stamp) * 1e-9 if self.stamp else np.inf
        filter.predict(min(elapsed, AVERAGES.length))
        if elapsed > 1.5 * AVERAGES.length:
            self._forget(-2, 0.0, np.pi)
        self._forget(-1, speed, speed)  # which is a new one in each second
        self.stamp = mean.stamp
        course, deviation = mean.course
        if np.isfinite(course):
            filter.correct(*_COURSE.measured([course], np.array([deviation**2 + SETTINGS.drifting**2])))
        lateral = abs(speed * rate)
        if lateral > SETTINGS.largest_lateral or abs(force) > SETTINGS.largest_force:
            return False
        own = (SETTINGS.form**2 + (SETTINGS.leaning * lateral) ** 2) * speed**2
        noise = (mean.spin_deviation * self.averages.radii) ** 2 + own
        filter.correct(*_WHEELS.measured(rolling, noise))
        ground, deviation = mean.ground_speed
        if np.isfinite(ground):
            filter.correct(*_GNSS.measured([ground], np.array([deviation**2 + SETTINGS.ground**2])))
        self.used += AVERAGES.length
        return True

    def _forget(self, place: int, mean: float, deviation: float) -> None:
        """Begin one state anew."""
        covariance = self._filter.covariance
        covariance[place, :] = covariance[:, place] = 0.0
        covariance[place, place] = deviation**2
        self._filter.mean[place] = mean

    def belief(self) -> Gaussian:
        """Mean and covariance of the relative radius errors (4,)."""
        belief = self._filter.belief()
        return Gaussian(belief.mean[:4], belief.covariance[:4, :4])

    def below(self) -> tuple[Array, Array]:
        """By how much each wheel is smaller than the mean of the three others (4,) [-], beyond what it was when
        pressures were right, and the standard deviation of that."""
        belief = self.belief()
        others = (np.ones((4, 4)) - np.eye(4)) / 3 - np.eye(4)
        mean, covariance = belief.mean, belief.covariance
        if self._right is None:
            covariance = covariance + SETTINGS.alike**2 * np.eye(4)
        else:
            mean, covariance = mean - self._right[0], covariance + self._right[1]
        return others @ mean, np.sqrt(np.einsum("ij,jk,ik->i", others, covariance, others))

    def low(self) -> dict[str, tuple[float, float]]:
        """Wheels that are smaller than the others by more than can be chance: by how much, and its deviation [-]."""
        by, deviation = self.below()
        own = np.sqrt(np.square(deviation) - (4 / 3 * SETTINGS.alike**2 if self._right is None else 0.0))
        return {
            wheel: (float(by[i]), float(deviation[i]))
            for i, wheel in enumerate(WHEELS)
            if own[i] < SETTINGS.determined and by[i] > SETTINGS.significant * deviation[i]
        }

    def diagnostic(self) -> Diagnostic:
        """A line that says which tyre may have lost pressure."""
        belief = self.belief()
        deviations = np.sqrt(belief.covariance.diagonal())
        figures = {
            wheel: f"{100 * mean:+.2f} ± {100 * deviation:.2f} %"
            for wheel, mean, deviation in zip(WHEELS, belief.mean, deviations, strict=True)
        }
        low = self.low()
        if not low:
            text = "waiting for gentle driving above 30 km/h"
            if self.used:
                text = "errors of the rolling radii: " + ", ".join(f"{wheel} {text}" for wheel, text in figures.items())
            return Diagnostic("tyres", Level.OK, text, figures)
        wheels = ", ".join(f"{wheel} by {100 * by:.2f} ± {100 * own:.2f} %" for wheel, (by, own) in low.items())
        since = "the others" if self._right is None else "the others, since pressures were right"
        return Diagnostic(
            "tyres", Level.WARN, f"rolls on a smaller radius than {since}: {wheels}; check its pressure", figures
        )

    def sample(self) -> Sample:
        """What is published: relative errors of the radii of the vehicle file as position, their standard deviations as
        velocity, and as effort by how many standard deviations each wheel is smaller than the others."""
        belief = self.belief()
        by, deviation = self.below()
        values = {
            "position": belief.mean.copy(),
            "velocity": np.sqrt(belief.covariance.diagonal()),
            "effort": by / deviation,
        }
        return Sample(TOPIC, "sensor_msgs/msg/JointState", self.stamp, values, names=NAMES)

    def save(self, path: Path | None = None) -> None:
        """Keep the radii as those that belong to right pressures, unless there are some or they are not known yet."""
        path = self.stored if path is None else path
        belief = self.belief()
        contrast = np.sqrt(np.linalg.eigvalsh(belief.covariance)[:3].max())
        if path is None or self._right is not None or contrast > SETTINGS.determined:
            return
        content = {
            "vehicle": self.vehicle.name, "fingerprint": fingerprint(self.vehicle), "wheels": list(WHEELS),
            "mean": belief.mean.tolist(), "covariance": belief.covariance.tolist(),
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(json.dumps(content) + "\n")

    def _load(self, path: Path) -> tuple[Array, Array]:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            of_vehicle, name = content["fingerprint"], content["vehicle"]
            mean, covariance = np.array(content["mean"], dtype=float), np.array(content["covariance"], dtype=float)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: expected radii that the tyre monitor stored, found {error!r}") from None
        if of_vehicle != fingerprint(self.vehicle):
            raise InputError(
                f"{path}: holds radii of {name}, found with another vehicle file than that of {self.vehicle.name}: "
                "name another file, or remove this one"
            )
        if mean.shape != (4,) or covariance.shape != (4, 4) or not np.isfinite([*mean, *covariance.ravel()]).all():
            raise InputError(f"{path}: holds no four radii; remove it")
        return mean, covariance


def radii_in(recording: Recording, vehicle: Vehicle) -> TyreRadii | None:
    """Tyre radii after a recording; None if it has not the sensors for them."""
    try:
        radii = TyreRadii(vehicle)
    except InputError:
        return None
    if not all(sensor.topic in recording for sensor in radii.averages.needed):
        return None
    radii.take(recording)
    return radii
