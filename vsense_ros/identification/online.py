"""The identifying filter on the vehicle: it goes on from drive to drive, and keeps its estimates in a file.

It runs beside the observer, on the same messages, a hundred steps a second on their stamps. It identifies the
model of Best & Bogdanski (2016), so that the speeds of all wheels must be measured. A stored set of
parameters belongs to the car of one vehicle file: for another it is refused.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification.best import SETTINGS as BEST
from vsense_ros.identification.identification import handling_identifier
from vsense_ros.identification.recorded import RECORDED
from vsense_ros.identification.rinsing import SENSOR, independent
from vsense_ros.messages.recording import Sample
from vsense_ros.model.sensors import Imu, best_measuring
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

TOPIC = "vsense/identified_parameters"


@dataclass(frozen=True)
class OnlineSettings:
    """Settings of the online identification: decisions of this project."""

    period: float = 1.0  # [s] between two messages
    # [-] of the prior deviations, with which a new car begins: so far the equations are nearly linear
    first_share: float = 0.5
    ageing: float = 0.02  # [-] share of its value by which a parameter may have changed from one drive to the next
    gate: float = 100.0  # [-] normalized innovation squared beyond which a reading is not believed
    most_steps: int = 100  # that one message may bring about


ONLINE = OnlineSettings()

_EVERY = independent(RECORDED.step, BEST.everyday_cut_off)


def fingerprint(vehicle: Vehicle) -> str:
    """Fingerprint of the car that a vehicle file describes: of its name and its physics."""
    return sha256(f"{vehicle.name}\n{vehicle.physics.model_dump_json()}".encode()).hexdigest()[:16]


class OnlineIdentification:
    """Online identification of one vehicle. `add` takes messages in order of arrival; `sample` is what is published;
    `save` keeps it.

    Raises `InputError` for a vehicle whose sensors do not measure steering angle, rates and forces, or rolling speed,
    and for a stored set of another vehicle or another kind.
    """

    def __init__(self, vehicle: Vehicle, stored: Path | None = None) -> None:
        sensors = vehicle.sensing()
        self._names = {
            quantity: best_measuring(sensors.items(), quantity)
            for quantity in ("steering", "rates and forces", "rolling speed")
        }
        for quantity, name in self._names.items():
            if name is None:
                raise InputError(
                    f"{vehicle.name}: the identifying filter needs {quantity.replace('rates and forces', 'an imu')}, "
                    "which no sensor of the vehicle file gives"
                )
        self.vehicle, self.stored = vehicle, stored
        self._one, self._prior = handling_identifier(vehicle, "best")
        self._filter, self._states = self._one.filter, len(self._one.noise.start)
        self._radii, self._radius = rolling_radii(vehicle), self._one.values["wheel_radius"]
        on_map = Map(None)
        self._readers = {sensors[str(name)].topic: (quantity, Reader(0, sensors[str(name)], on_map), sensors[str(name)])
                         for quantity, name in self._names.items()}  # fmt: skip
        self._values: dict[str, Array] = {}
        self._stamps: dict[str, int] = {}
        self._new = False
        self._since = 0  # steps since the last correction
        self.stamp = 0  # of the last step [ns]; 0: the filter is not running
        self.driven = 0.0  # [s] in this and all drives before
        self.restarts = 0
        self._belief = Gaussian(self._one.begin(), np.diag((self._prior * ONLINE.first_share) ** 2))
        from scipy.signal import butter  # which a node that identifies nothing need not wait for

        self._b, self._a = butter(2, 2 * BEST.everyday_cut_off * RECORDED.step)
        self._delays = np.zeros((2, 9))  # of the low-pass of inputs and outputs
        self._good = self._belief
        if stored is not None and stored.exists():
            self._load(stored)

    @property
    def topics(self) -> dict[str, str]:
        """Topics that it listens to, with their message types."""
        return {topic: sensor.message for topic, (_, _, sensor) in self._readers.items()}

    def add(self, sample: Sample) -> None:
        """Take a message. Others than those of `topics` are left alone."""
        entry = self._readers.get(sample.topic)
        if entry is None:
            return
        quantity, reader, sensor = entry
        event = reader.read(sample)
        if isinstance(event, str):
            return
        value = event.value
        if isinstance(sensor, Imu):
            value = sensor.in_axes_of_car(value[None])[0]
            self._new = True
        if event.stamp <= self._stamps.get(quantity, 0):
            return
        self._values[quantity], self._stamps[quantity] = value, event.stamp
        self._advance()

    def _advance(self) -> None:
        """Up to the stamp that all sensors have reached."""
        if len(self._stamps) < len(self._names):
            return
        oldest, newest = min(self._stamps.values()), max(self._stamps.values())
        inputs = self._inputs()
        drives = (
            self._speed > RECORDED.least_speed
            and np.isfinite(inputs).all()
            and (newest - oldest) * 1e-9 < RECORDED.longest_gap
        )
        if not drives:
            self._rest()
            return
        if not self.stamp or not -RECORDED.longest_gap < (oldest - self.stamp) * 1e-9 < RECORDED.longest_gap:
            self._begin(oldest, inputs)
        step = round(RECORDED.step * 1e9)
        for _ in range(min((oldest - self.stamp) // step, ONLINE.most_steps)):
            self._step(inputs)
            self.stamp += step

    def _inputs(self) -> Array:
        """(5,) of the model, of what came last."""
        rolling = self._values["rolling speed"] * self._radii
        self._speed = float(np.median(rolling))
        return np.array([self._values["steering"][0], *(rolling / self._radius)])

    def _begin(self, stamp: int, inputs: Array) -> None:
        self._rest()
        n, p = self._states, len(self._belief.mean)
        spread = np.zeros((n + p, n + p))
        spread[:n, :n], spread[n:, n:] = np.diag(np.square(self._one.noise.start)), self._belief.covariance
        mean = np.zeros(n)
        yaw_rate = self._values["rates and forces"][2]
        mean[0], mean[2] = self._speed, yaw_rate if np.isfinite(yaw_rate) else 0.0
        self._filter.inputs[:5], self._filter.inputs[5] = inputs, 0.0
        signals = np.nan_to_num(np.concatenate([inputs, self._values["rates and forces"][[3, 4, 0, 2]]]))
        self._delays[0], self._delays[1] = signals * (1 - self._b[0]), signals * (self._b[2] - self._a[2])
        self._filter.start(Gaussian(np.concatenate([mean, self._belief.mean]), spread))
        self.stamp = stamp

    def _step(self, inputs: Array) -> None:
        """One step; where it leads to nowhere, the parameters are again what they were when the drive began."""
        smooth = self._low_passed(np.concatenate([inputs, self._values["rates and forces"][[3, 4, 0, 2]]]))
        self._filter.inputs[5] = (smooth[0] - self._filter.inputs[0]) / RECORDED.step  # rate of the steering
        self._filter.inputs[:5] = smooth[:5]
        try:
            self._since += 1
            if self._new and self._since >= _EVERY:
                self._filter.correct(SENSOR, smooth[5:], np.square(self._one.noise.outputs), ONLINE.gate)
                self._new, self._since = False, 0
            self._filter.predict(RECORDED.step)
            sound = self._filter.is_valid()
        except FloatingPointError:
            sound = False
        parameters = self._filter.mean[self._states :]
        if sound and ((parameters > self._one.low) & (parameters < self._one.high)).all():
            self.driven += RECORDED.step
            return
        self.restarts += 1
        self.stamp, self._belief = 0, self._good
        self._begin(min(self._stamps.values()), inputs)

    def _low_passed(self, signals: Array) -> Array:
        """Inputs and outputs (9,) through one filter, which delays all of them alike (direct form II transposed)."""
        filtered = self._b[0] * signals + self._delays[0]
        self._delays[0] = self._b[1] * signals - self._a[1] * filtered + self._delays[1]
        self._delays[1] = self._b[2] * signals - self._a[2] * filtered
        return filtered

    def _rest(self) -> None:
        """Keep what is known of the parameters; the state begins anew when the car drives again."""
        if self.stamp:
            self._belief = self.belief()
            self._good = self._belief
            self.stamp = 0

    def belief(self) -> Gaussian:
        """Mean and covariance of the parameters (p,)."""
        if not self.stamp:
            return self._belief
        belief, n = self._filter.belief(), self._states
        return Gaussian(belief.mean[n:], belief.covariance[n:, n:])

    def sample(self) -> Sample:
        """What is published: value as position, standard deviation as velocity, as of the observer's parameters."""
        belief = self.belief()
        return Sample(
            TOPIC, "sensor_msgs/msg/JointState", max(self._stamps.values(), default=0),
            {
                "position": belief.mean, "velocity": np.sqrt(belief.covariance.diagonal().clip(min=0)),
                "effort": np.zeros(0),
            },
            names=self._one.free,
        )  # fmt: skip

    def save(self, path: Path | None = None) -> None:
        """Keep the parameters for the next drive."""
        path = self.stored if path is None else path
        if path is None:
            return
        belief = self.belief()
        content = {
            "vehicle": self.vehicle.name, "fingerprint": fingerprint(self.vehicle), "model": "best",
            "names": list(self._one.free), "mean": belief.mean.tolist(), "covariance": belief.covariance.tolist(),
            "driven_s": self.driven,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(json.dumps(content) + "\n")

    def _load(self, path: Path) -> None:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            name, stored_fingerprint, names = content["vehicle"], content["fingerprint"], tuple(content["names"])
            mean, covariance = np.array(content["mean"], dtype=float), np.array(content["covariance"], dtype=float)
            driven = float(content["driven_s"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{path}: expected parameters that the identifying filter stored, found {error!r}"
            ) from None
        if stored_fingerprint != fingerprint(self.vehicle):
            raise InputError(
                f"{path}: holds parameters of {name}, identified with another vehicle file than that of "
                f"{self.vehicle.name}; a set belongs to one vehicle: name another file, or remove this one"
            )
        p = len(self._one.free)
        if names != self._one.free or mean.shape != (p,) or covariance.shape != (p, p):
            raise InputError(f"{path}: holds other parameters than this version identifies; remove it")
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise InputError(f"{path}: holds numbers that are not finite; remove it")
        aged = covariance + np.diag((ONLINE.ageing * self._prior / BEST.prior_share) ** 2)
        self._belief = self._good = Gaussian(mean, aged)
        self.driven = driven
