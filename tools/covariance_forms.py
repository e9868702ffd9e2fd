"""Which form of the covariance to keep: `python tools/covariance_forms.py docs/covariance.md`.

Ten minutes of one recording over and over, GNSS moved on with the car, go through the observer. Every transition and
every measurement that it makes of them is given to other forms of the Kalman filter too, in double and in single
precision. What they make of it is compared with a square-root filter in double precision, which cannot lose its sign.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.bag import read_bag
from vsense_ros.estimation.filter import Gaussian, Innovation
from vsense_ros.evaluate.terminal import progress
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.runner import Runner

Array = NDArray[Any]

ROOT = Path(__file__).parents[1]
SECOND = 1_000_000_000
LAP = 12  # [s] of the recording that are repeated
LAPS = 50
THINNED = 3  # every so manyth IMU message is used: the forms are slow
METRES_PER_DEGREE = 111_319.49  # along the equator


class Form:
    """A way to keep a covariance, of numbers of one kind."""

    words = ""

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        self.p: Array = np.zeros(0)

    def start(self, p: Array) -> None:
        self.p = p.astype(self.kind)

    def predict(self, f: Array, noise: Array) -> None:
        self.p = f @ self.p @ f.T
        self.p.flat[:: len(f) + 1] += noise

    def correct(self, h: Array, variance: Array) -> None:
        raise NotImplementedError

    def covariance(self) -> Array:
        return self.p.astype(float)


class Textbook(Form):
    words = "(I - K H) P"

    def correct(self, h: Array, variance: Array) -> None:
        projected = h @ self.p
        gain = np.linalg.solve(projected @ h.T + np.diag(variance), projected).T
        self.p = self.p - gain @ projected


class Symmetrised(Textbook):
    words = "(I - K H) P, then (P + Pᵀ) / 2"

    def predict(self, f: Array, noise: Array) -> None:
        super().predict(f, noise)
        self.p = (self.p + self.p.T) / 2

    def correct(self, h: Array, variance: Array) -> None:
        super().correct(h, variance)
        self.p = (self.p + self.p.T) / 2


class Joseph(Form):
    words = "Joseph: (I - K H) P (I - K H)ᵀ + K R Kᵀ"

    def correct(self, h: Array, variance: Array) -> None:
        projected = h @ self.p
        gain = np.linalg.solve(projected @ h.T + np.diag(variance), projected).T
        rest = np.eye(len(self.p), dtype=self.kind) - gain @ h
        self.p = rest @ self.p @ rest.T + gain * variance @ gain.T


class Whitened(Form):
    words = "whitened, as here: P - W Wᵀ, W = P Hᵀ L⁻ᵀ, L Lᵀ = H P Hᵀ + R"

    def predict(self, f: Array, noise: Array) -> None:
        super().predict(f, noise)
        self.p = (self.p + self.p.T) / 2

    def correct(self, h: Array, variance: Array) -> None:
        projected = h @ self.p
        whitened = np.linalg.solve(np.linalg.cholesky(projected @ h.T + np.diag(variance)), projected)
        self.p = self.p - whitened.T @ whitened


class SquareRoot(Form):
    words = "square root, by QR decompositions"

    def start(self, p: Array) -> None:
        self.p = np.linalg.cholesky(p).T.astype(self.kind)  # upper triangle, P = pᵀ p

    def predict(self, f: Array, noise: Array) -> None:
        some = np.flatnonzero(noise)
        added = np.zeros((len(some), len(f)), dtype=self.kind)
        added[np.arange(len(some)), some] = np.sqrt(noise[some])
        self.p = np.linalg.qr(np.concatenate([self.p @ f.T, added]), mode="r")

    def correct(self, h: Array, variance: Array) -> None:
        m, n = h.shape
        array = np.zeros((m + n, m + n), dtype=self.kind)
        array[:m, :m] = np.diag(np.sqrt(variance))
        array[m:, :m], array[m:, m:] = self.p @ h.T, self.p
        self.p = np.linalg.qr(array, mode="r")[m:, m:]

    def covariance(self) -> Array:
        root = self.p.astype(float)
        return root.T @ root


@dataclass
class Record:
    """What became of one form."""

    form: Form
    seconds: float = 0.0  # of computing
    asymmetry: float = 0.0  # largest, in units of both standard deviations
    smallest: list[float] = field(default_factory=list)  # eigenvalue of the correlation matrix, after each lap
    error: float = 0.0  # largest of a standard deviation, relative
    lost: str = ""  # why it ended

    def look(self, reference: Array) -> None:
        """Judge the form at this moment by the reference's covariance."""
        p, deviation = self.form.covariance(), np.sqrt(np.diag(reference))
        unit = np.outer(deviation, deviation)
        self.asymmetry = max(self.asymmetry, float(np.abs((p - p.T) / unit).max()))
        self.smallest.append(float(np.linalg.eigvalsh((p + p.T) / 2 / unit)[0]))
        with np.errstate(invalid="ignore"):
            self.error = max(self.error, float(np.abs(np.sqrt(np.diag(p)) / deviation - 1).max()))


class Watched(CarBlocks):
    """The car with full matrices, whose transitions and measurements go to other forms as well."""

    in_blocks = False

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], records: list[Record]) -> None:
        super().__init__(vehicle, sensors)
        self.records, self.predictions, self._fresh = records, 0, True
        self.jacobian = np.zeros((0, 0))

    def forget_forms(self) -> None:
        """Their covariance is not that of the filter any more."""
        self._fresh = True

    def propagate(self, f: Array, noise: Array) -> None:
        if self._fresh:
            for record in self.records:
                record.form.start(self.covariance)
            self._fresh = False
        super().propagate(f, noise)
        self.predictions += 1
        self.give("predict", f, np.append(np.zeros(len(f) - len(noise)), noise))

    def sense(self, sensor: str, value: Array) -> tuple[Array, Array]:
        innovation, self.jacobian = super().sense(sensor, value)
        return innovation, self.jacobian

    def corrected(self, present: NDArray[np.bool_], variance: Array) -> None:
        """The last measurement, some of whose components were there, has been used."""
        if not self._fresh:
            self.give("correct", self.jacobian[present], variance[present])

    def give(self, operation: str, matrix: Array, vector: Array) -> None:
        for record in self.records:
            if not record.lost:
                _apply(record, operation, matrix.astype(record.form.kind), vector.astype(record.form.kind))


def _apply(record: Record, operation: str, matrix: Array, vector: Array) -> None:
    begun = time.thread_time()
    try:
        with np.errstate(all="ignore"):
            getattr(record.form, operation)(matrix, vector)
    except np.linalg.LinAlgError:
        record.lost = "H P Hᵀ + R not positive"
    record.seconds += time.thread_time() - begun


class WatchedEkf(ErrorEkf):
    """The errorEKF of a watched car."""

    car: Watched

    def start(self, belief: Gaussian) -> None:
        super().start(belief)
        self.car.forget_forms()

    def set_element(self, index: int, value: float, deviation: float) -> None:
        super().set_element(index, value, deviation)
        self.car.forget_forms()

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        innovation = super().correct(sensor, value, variance, limit, scale)
        if innovation.accepted:
            self.car.corrected(np.isfinite(innovation.whitened), variance)
        return innovation


def over_and_over(recording: Recording, topics: tuple[str, ...], laps: int) -> Iterator[Sample]:
    """The recording's first `LAP` seconds, as if the road went on, in order of their stamps."""
    end = recording.start + LAP * SECOND
    stream = [s for s in recording.samples(topics) if s.stamp < end]
    imu = [s for s in stream if s.topic == "imu/data"][::THINNED]
    stream = sorted(imu + [s for s in stream if s.topic != "imu/data"], key=lambda s: s.stamp)
    x = recording["reference/odometry"].columns["position"][:, 0]
    stamps = recording["reference/odometry"].stamp
    length = float(np.interp(end, stamps, x) - x[0])
    for lap in range(laps):
        for sample in stream:
            values = sample.values
            if "longitude" in values:
                degree = METRES_PER_DEGREE * np.cos(np.radians(values["latitude"]))
                values = {**values, "longitude": values["longitude"] + lap * length / degree}
            stamp = sample.stamp + lap * LAP * SECOND
            yield replace(sample, stamp=stamp, received=stamp, values=values)


def measure(laps: int) -> tuple[list[Record], float]:
    """All forms after so many laps, and how many predictions a second there were."""
    vehicle = load_vehicle(ROOT / "config/vehicles/prototype_model.yaml")
    recording = read_bag(ROOT / "bags/double_lane_change")
    reference = Record(SquareRoot(np.float64))
    forms = [kind(np.float64) for kind in (Textbook, Symmetrised, Joseph, Whitened)]
    forms += [kind(np.float32) for kind in (Textbook, Symmetrised, Joseph, Whitened, SquareRoot)]
    records = [reference, *(Record(form) for form in forms)]
    car = Watched(vehicle, sensors_of(vehicle), records)
    observer = Runner(vehicle, recording.map_origin, lambda *_: WatchedEkf(car))
    following = recording.start + LAP * SECOND
    with progress(f"{laps * LAP} s in {len(records)} forms") as done:
        for sample in over_and_over(recording, tuple(observer.topics), laps):
            if sample.stamp >= following:
                _look(records)
                done((following - recording.start) / (laps * LAP * SECOND))
                following += LAP * SECOND
            observer.add(sample)
    _look(records)
    return records, car.predictions / (laps * LAP)


def _look(records: list[Record]) -> None:
    reference = records[0].form.covariance()
    for record in records:
        if not record.lost and not np.isfinite(record.form.covariance()).all():
            record.lost = "overflow"
        if not record.lost:
            record.look(reference)


def page(records: list[Record], rate: float, laps: int) -> str:
    """The document."""
    predictions = rate * laps * LAP
    rows = []
    for record in sorted(records, key=lambda r: (r.form.kind is np.float32, type(r.form).__name__ != "Whitened")):
        precision = "single" if record.form.kind is np.float32 else "double"
        lowest = min(record.smallest, default=np.nan)
        if record.lost:
            fate = f"{lowest:.1e} | lost after {len(record.smallest) * LAP} s: {record.lost} | |"
        else:
            cost = record.seconds / predictions * 1e6
            fate = f"{lowest:.1e} | {record.smallest[-1]:.1e} | {record.error:.0e} | {cost:.0f} µs"
        rows.append(f"| {record.form.words} | {precision} | {record.asymmetry:.0e} | {fate} |")
    return HEAD.format(minutes=laps * LAP / 60, rate=rate) + "\n".join(rows) + "\n" + TAIL


HEAD = """# The form of the covariance

Made by `python tools/covariance_forms.py docs/covariance.md`: {minutes:g} minutes of `bags/double_lane_change` over and
over, GNSS moved on with the car, {rate:.0f} predictions a second. Every form got the same transitions and measurements,
dense and in NumPy.

- *asymmetry*: largest |p - pᵀ|, in units of both standard deviations
- *eigenvalue*: smallest of the correlation matrix, the lowest of all moments looked at (every 12 s), and the last
- *error*: largest of a standard deviation, relative to the square root in double precision
- *time*: of one core for a prediction and what corrections follow it

| form | precision | asymmetry | lowest eigenvalue | last | error | time |
|---|---|---|---|---|---|---|
"""
TAIL = """
The textbook's form drifts out of symmetry by its roundings, and the filter is lost with it, in double precision too.
All forms that stay symmetric agree with the square root, and their smallest eigenvalue stays where the physics puts it,
far above the roundings: a form that guards the sign has nothing to guard here, at a price in every step.

So the observer keeps the covariance itself, in double precision, and subtracts whitened outer products, `P - W Wᵀ`,
which are symmetric to the last bit; after a prediction what is computed once stands on both sides. With the structure
of the car's matrices this is `vsense_ros/observer/car_blocks.c`, and with full ones `car_blocks.py`.

`test/observer/test_observer.py` holds the observer to it: symmetric to the last bit and positive definite, without a
trend, over ten minutes with GNSS and over ten minutes in a tunnel.
"""


if __name__ == "__main__":
    count = int(sys.argv[2]) if len(sys.argv) > 2 else LAPS
    found, per_second = measure(count)
    Path(sys.argv[1]).write_text(page(found, per_second, count), encoding="utf-8")
    print(f"wrote {sys.argv[1]}")
