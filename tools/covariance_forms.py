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
from vsense_ros.evaluate.terminal import progress
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.observer import Observer
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.kalman import DYNAMIC, FORCE, GAIN_COLUMNS, SURROUND, Q, U

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


class Watched(ErrorEkf):
    """A filter whose transitions and measurements go to other forms as well."""

    records: list[Record]
    predictions = 0
    _fresh = True

    def watch(self, records: list[Record]) -> None:
        self.records, self._fresh = records, True

    def start(self, speed: float) -> None:
        super().start(speed)
        self._fresh = True

    def place(self, index: int, value: float, deviation: float) -> None:
        super().place(index, value, deviation)
        self._fresh = True

    def predict(self, h: float) -> None:
        if self._fresh:
            for record in self.records:
                record.form.start(self.covariance)
            self._fresh = False
        super().predict(h)
        noise = np.zeros(len(self.state))
        process = self._process(h)
        noise[FORCE.start :] = process.noise
        transition = self._transition(h, process.decay)
        self.predictions += 1
        for record in self.records:
            self._apply(record, "predict", transition, noise)

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float = 1.0) -> float:
        nis = super().correct(index, value, variance, limit, scale)
        if 0 <= nis <= limit and not self._fresh:
            jacobian = self._jacobian(index)
            present = np.isfinite(value)
            for record in self.records:
                self._apply(record, "correct", jacobian[present], variance[present])
        return nis

    def _apply(self, record: Record, operation: str, matrix: Array, vector: Array) -> None:
        if record.lost:
            return
        form = record.form
        matrix, vector = matrix.astype(form.kind), vector.astype(form.kind)
        begun = time.thread_time()
        try:
            with np.errstate(all="ignore"):
                getattr(form, operation)(matrix, vector)
        except np.linalg.LinAlgError:
            record.lost = "H P Hᵀ + R not positive"
        record.seconds += time.thread_time() - begun

    def _transition(self, h: float, decay: Array) -> Array:
        """(n, n): velocities first, then coordinates that follow the new velocities."""
        n, k = len(self.state), self._kalman
        velocities, coordinates = np.eye(n), np.eye(n)
        velocities[U] = 0
        velocities[U, GAIN_COLUMNS] = k.gain
        coordinates[:6, 3:6] += h * k.by_angles
        coordinates[:6, 14:20] += h * k.by_velocity
        coordinates[6:14, 20:28] += h * np.eye(8)
        slow = np.ones(n)
        slow[FORCE.start :] = decay
        return slow[:, None] * (coordinates @ velocities)

    def _jacobian(self, index: int) -> Array:
        """(m, n) of a sensor by the state."""
        kernel = self._sense[index]
        assert kernel is not None
        _, by_q, by_u, by_udot, by_surroundings = kernel.results
        h = np.zeros((len(by_q), len(self.state)))
        h[:, Q], h[:, U], h[:, SURROUND] = by_q, by_u, by_surroundings
        if self._uses_acceleration[index]:
            model = self._kalman.model
            h[:, DYNAMIC] += by_udot @ model.by_q
            h[:, U] += by_udot @ model.by_u
            h[:, FORCE] = by_udot
            h[:, SURROUND] += by_udot @ model.by_surroundings
        where = self.layout.biases[index]
        if where.stop > where.start:
            h[:, where] = np.eye(len(h))
        return h


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
    observer = Observer(vehicle, recording.map_origin, Watched)
    reference = Record(SquareRoot(np.float64))
    forms = [kind(np.float64) for kind in (Textbook, Symmetrised, Joseph, Whitened)]
    forms += [kind(np.float32) for kind in (Textbook, Symmetrised, Joseph, Whitened, SquareRoot)]
    records = [reference, *(Record(form) for form in forms)]
    ekf = observer.filter
    assert isinstance(ekf, Watched)
    ekf.watch(records)
    following = recording.start + LAP * SECOND
    with progress(f"{laps * LAP} s in {len(records)} forms") as done:
        for sample in over_and_over(recording, tuple(observer.topics), laps):
            if sample.stamp >= following:
                _look(records)
                done((following - recording.start) / (laps * LAP * SECOND))
                following += LAP * SECOND
            observer.add(sample)
    _look(records)
    return records, ekf.predictions / (laps * LAP)


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
of the car's matrices this is `vsense_ros/observer/car_blocks.py` and, compiled, `car_blocks.c`.

`test/observer/test_observer.py` holds the observer to it: symmetric to the last bit and positive definite, without a
trend, over ten minutes with GNSS and over ten minutes in a tunnel.
"""


if __name__ == "__main__":
    count = int(sys.argv[2]) if len(sys.argv) > 2 else LAPS
    found, per_second = measure(count)
    Path(sys.argv[1]).write_text(page(found, per_second, count), encoding="utf-8")
    print(f"wrote {sys.argv[1]}")
