"""Streams of messages for an observer, and how far from the truth it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.spi import Spi
from vsense_ros.runner import Runner

Array = NDArray[np.float64]
SECOND = 1_000_000_000
IMU, WHEELS, STEERING = "imu/data", "vehicle/wheel_speeds", "vehicle/steering"
FIX, VELOCITY = "gps/fix", "gps/velocity"
SENSORS = {"imu": IMU, "wheel_speeds": WHEELS, "steering": STEERING, "position": FIX, "velocity": VELOCITY}


def messages(recording: Recording, until: float = np.inf) -> list[Sample]:
    """What the sensors sent in the first `until` seconds, in order of arrival."""
    topics = tuple(t for t in recording.channels if not t.startswith("reference/"))
    end = recording.start + until * SECOND
    return [s for s in recording.samples(topics) if (s.received or 0) < end]


def feed(observer: Runner, samples: Iterable[Sample]) -> Runner:
    for sample in samples:
        observer.add(sample)
    return observer


def without_c(filter: CarFilter) -> None:
    """Let a filter do without its operations in C."""
    for part in (filter, getattr(filter, "_state_filter", None)):
        if part is not None:
            part._operations = None  # type: ignore[attr-defined]


def goes_on_as_it_did(spi: Spi, steps: int) -> None:
    """A filter put back to where it was does the same again, bit by bit."""

    def go_on() -> Array:
        for _ in range(steps):
            spi.linearize()
            spi.correct("imu", np.array([0.0, 0.0, 0.4, 0.3, 5.0, 9.8]), np.full(6, 1e-2), np.inf)
            spi.predict(0.004)
        return spi.memory.copy()

    before = spi.memory.copy()
    first = go_on()
    spi.memory[:] = before
    np.testing.assert_array_equal(go_on(), first)


def seconds(recording: Recording, sample: Sample) -> float:
    """Stamp since the beginning [s]."""
    return (sample.stamp - recording.start) / SECOND


def changed(sample: Sample, **fields: object) -> Sample:
    """A copy with other values in some fields of the message."""
    return replace(sample, values={**sample.values, **fields})


def altered(samples: Iterable[Sample], where: Callable[[Sample], bool], to: Callable[[Sample], Sample]) -> list[Sample]:
    """The stream with the messages that `where` picks replaced by what `to` makes of them."""
    return [to(s) if where(s) else s for s in samples]


@dataclass(frozen=True)
class Course:
    """How a drive was seen: errors against the truth at all estimates, and what was said about the sensors."""

    t: Array  # [s] since the beginning of the recording
    speed: Array  # error [m/s]
    lateral: Array  # error of the lateral velocity [m/s]
    yaw_rate: Array  # error [rad/s]
    position: Array  # distance [m]
    said: list[tuple[float, dict[str, Diagnostic]]]  # every 0.1 s

    def largest(self, begin: float = 1.0, end: float = np.inf) -> tuple[float, float, float]:
        """Largest error of speed [m/s], lateral velocity [m/s] and yaw rate [rad/s] in a stretch of time."""
        part = (self.t >= begin) & (self.t < end)
        a, b, c = (float(np.abs(x[part]).max()) for x in (self.speed, self.lateral, self.yaw_rate))
        return a, b, c

    def levels(self, sensor: str, begin: float, end: float) -> set[str]:
        return {d[sensor].level.name for t, d in self.said if begin <= t < end}

    def words(self, sensor: str) -> str:
        """Everything that was said about a sensor."""
        return "\n".join(d[sensor].message for _, d in self.said)


def follow(observer: Runner, samples: Iterable[Sample], truth: Recording) -> Course:
    """Feed a stream, and look at the estimate every 20 ms of arrival. Fails where an estimate is not a number."""
    reference = truth["reference/odometry"]
    rows, said, last, start = [], [], 0, truth.start
    for sample in samples:
        observer.add(sample)
        now = sample.received or sample.stamp
        if now < last + SECOND // 50:
            continue
        last = now
        if len(said) == 0 or (now - start) / SECOND >= said[-1][0] + 0.1:
            said.append(((now - start) / SECOND, {d.name: d for d in observer.diagnostics(now)}))
        if observer.started:
            e = observer.snapshot()
            numbers = (e.position, e.attitude, e.velocity, e.rates, e.acceleration, e.wheels, e.parameters)
            assert all(np.isfinite(n).all() for n in numbers)
            assert np.isfinite(e.pose_covariance).all()
            assert (e.twist_covariance.diagonal() > 0).all()
            rows.append((e.stamp, *e.velocity[:2], e.rates[2], *e.position[:2]))
    stamp = np.array([r[0] for r in rows])
    values = np.array([r[1:] for r in rows])
    since = (stamp - start) / SECOND
    at = (reference.stamp - start) / SECOND

    def true(field: str, axis: int) -> Array:
        return np.interp(since, at, reference.columns[field][:, axis])

    return Course(
        since,
        np.hypot(values[:, 0], values[:, 1]) - np.hypot(true("linear", 0), true("linear", 1)),
        values[:, 1] - true("linear", 1),
        values[:, 2] - true("angular", 2),
        np.hypot(values[:, 3] - true("position", 0), values[:, 4] - true("position", 1)),
        said,
    )


def distance(a: Runner, b: Runner) -> tuple[float, float, float, float]:
    """Largest difference of velocity [m/s], rates [rad/s], attitude [rad] and place on the map [m] of two observers."""
    x, y = a.snapshot(), b.snapshot()
    pairs = ((x.velocity, y.velocity), (x.rates, y.rates), (x.attitude, y.attitude), (x.position[:2], y.position[:2]))
    v, w, r, p = (float(np.abs(m - n).max()) for m, n in pairs)
    return v, w, r, p
