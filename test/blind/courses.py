"""Manoeuvres: a path to follow, a speed to hold on it, and programmes over time; and the sets made of them.

Steering programmes say the lateral acceleration [m/s²] that a linear car would have, so that they suit every car.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

TABLE_STEP = 0.01  # [s]
POINT_STEP = 1.0  # [m]


@dataclass(frozen=True)
class Path:
    """Points every metre."""

    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    speed: np.ndarray  # to hold there [m/s]


@dataclass(frozen=True)
class Course:
    name: str
    duration: float  # [s]
    speed: float  # at the start [m/s]
    path: Path
    lateral: np.ndarray  # steering by programme
    follow: np.ndarray  # share of steering by the path, 0 … 1
    forward: np.ndarray  # acceleration asked for by programme [m/s²]
    hold: np.ndarray  # share of holding the path's speed, 0 … 1
    roughness: float = 0.0  # of the road, rms [m]
    seed: int = 0  # of the road's unevenness


def _time(duration):
    return np.arange(0, duration + 2 * TABLE_STEP, TABLE_STEP)


def _course(name, duration, speed, path, *, lateral=0.0, follow=0.0, forward=0.0, hold=1.0) -> Course:
    t = _time(duration)
    tables = [_smooth(np.zeros_like(t) + v) for v in (lateral, follow, forward, hold)]
    return Course(name, duration, speed, path, *tables)


def _smooth(table, width=0.12):
    """A moving average: nobody steers or brakes in steps."""
    n = max(round(width / TABLE_STEP), 1)
    padded = np.concatenate([np.full(n, table[0]), table, np.full(n, table[-1])])
    kernel = np.ones(n) / n
    return np.convolve(padded, kernel, mode="same")[n:-n]


def _along(curvature, speed) -> Path:
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2)]) * POINT_STEP
    x = np.concatenate([[0.0], np.cumsum(np.cos((heading[1:] + heading[:-1]) / 2))]) * POINT_STEP
    y = np.concatenate([[0.0], np.cumsum(np.sin((heading[1:] + heading[:-1]) / 2))]) * POINT_STEP
    return Path(x, y, heading, np.zeros_like(x) + speed)


def _straight(duration, speed) -> Path:
    return _along(np.zeros(int(1.5 * duration * max(speed, 15.0)) + 50), speed)


def _offsets(x, y, speed) -> Path:
    """A path given as y over x, resampled by its length."""
    fine = np.arange(0, x[-1], 0.1)
    lateral = np.interp(fine, x, y)
    kernel = np.ones(60) / 60  # 6 m
    lateral = np.convolve(np.pad(lateral, 60, mode="edge"), kernel, mode="same")[60:-60]
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(fine), np.diff(lateral)))])
    s = np.arange(0, length[-1], POINT_STEP)
    px, py = np.interp(s, length, fine), np.interp(s, length, lateral)
    return Path(px, py, np.arctan2(np.gradient(py), np.gradient(px)), np.full_like(px, speed))


def _window(t, start, end, ramp=0.25):
    return np.clip((t - start) / ramp, 0, 1) * np.clip((end - t) / ramp, 0, 1)


def steering_sweep(speed, level, *, fastest=3.0, duration=18.0, name="steering sweep") -> Course:
    t = _time(duration)
    start = 1.5
    span = duration - start - 0.5
    rate = np.log(fastest / 0.2) / span
    phase = 2 * np.pi * 0.2 * (np.exp(rate * np.clip(t - start, 0, None)) - 1) / rate
    wave = level * np.sin(phase) * _window(t, start, duration - 0.2)
    return _course(name, duration, speed, _straight(duration, speed), lateral=wave)


def double_lane_change(speed, *, offset=3.5, name="double lane change") -> Course:
    lengths = np.cumsum([0, 1.2 * speed, 14, 25, 13, 40, 14, 25, 13, 400])
    y = np.array([0, 0, offset, offset, 0, 0, -offset, -offset, 0, 0])
    duration = float(np.ceil((lengths[8] + 30) / speed))
    return _course(name, duration, speed, _offsets(lengths, y, speed), follow=1.0)


def step_steers(speed, levels, name="step steers") -> Course:
    each = 2.6
    duration = 1.5 + each * 2 * len(levels)
    t = _time(duration)
    lateral = np.zeros_like(t)
    for i, level in enumerate(levels):
        start = 1.5 + 2 * each * i
        lateral += level * _window(t, start, start + each - 0.3, 0.18)
        lateral -= level * _window(t, start + each, start + 2 * each - 0.3, 0.18)
    return _course(name, duration, speed, _straight(duration, speed), lateral=lateral)


def slalom(speed, level, name="slalom") -> Course:
    duration = 14.0
    t = _time(duration)
    growth = np.clip((t - 1) / 9, 0, 1)
    wave = level * (0.4 + 0.6 * growth) * np.sin(2 * np.pi * 0.55 * np.clip(t - 1, 0, None))
    return _course(name, duration, speed, _straight(duration, speed), lateral=wave * _window(t, 1, 12.5))


def accelerate_and_brake(name="accelerate and brake", *, slow=9.0, push=2.6, brake=5.0) -> Course:
    duration = 18.0
    t = _time(duration)
    forward = push * _window(t, 1, 7.5) - brake * _window(t, 8.5, 11.2) + push * _window(t, 11.8, 15.0)
    forward -= 0.6 * brake * _window(t, 15.3, 17.5)
    return _course(name, duration, slow, _straight(duration, 28), forward=forward, hold=0.0, follow=1.0)


def coast_down(speed, name="coast-down", duration=20.0) -> Course:
    return _course(name, duration, speed, _straight(duration, speed), hold=0.0, follow=1.0)


def limit_ramp(speed, level, name="limit ramp") -> Course:
    """Steering wound on slowly up to what the tyres can, to one side and to the other."""
    duration = 20.0
    t = _time(duration)
    there = level * np.clip((t - 1) / 7, 0, 1) * (t < 8.6)
    back = -level * np.clip((t - 11) / 7, 0, 1) * (t < 18.6)
    return _course(name, duration, speed, _straight(duration, speed), lateral=_smooth(there + back, 0.5))


def brake_in_turn(speed, level, brake, name="brake in turn") -> Course:
    duration = 16.0
    t = _time(duration)
    lateral = level * (_window(t, 1, 6.5, 0.6) - _window(t, 8.5, 14.2, 0.6))
    forward = -brake * (_window(t, 4, 6) + _window(t, 11.7, 13.7)) + 0.8 * brake * _window(t, 6.6, 8.6)
    hold = 1 - _window(t, 3.9, 8.8, 0.1) - _window(t, 11.6, 15.5, 0.1)
    return _course(name, duration, speed, _straight(duration, speed), lateral=lateral, forward=forward, hold=hold)


def constant_turn(speed, level, duration=5.0, name="constant turn") -> Course:
    lateral = level * np.clip(_time(duration) / 0.8, 0, 1)
    return _course(name, duration, speed, _straight(duration, speed), lateral=lateral)


def power_on_in_turn(speed, level, name="circle") -> Course:
    duration = 16.0
    t = _time(duration)
    lateral = level * (_window(t, 1, 7.5, 0.8) - _window(t, 8.5, 15.2, 0.8))
    forward = 1.8 * (_window(t, 4, 7) + _window(t, 11.5, 14.5))
    hold = 1 - _window(t, 3.9, 7.1, 0.1) - _window(t, 11.4, 14.6, 0.1)
    return _course(name, duration, speed, _straight(duration, speed), lateral=lateral, forward=forward, hold=hold)


def road(rng, duration, fastest, slowest, tightest, lateral_limit, name) -> Course:
    """Bends and straights by chance; speed as the bends allow, with acceleration and braking in between."""
    length = int(duration * fastest) + 150
    curvature = np.zeros(length)
    at = 35
    while at < length:
        bend = int(rng.uniform(12, 70))
        radius = tightest * np.exp(rng.exponential(0.9))
        angle_limit = max(int(1.5 * radius), 8)
        bend = min(bend, angle_limit)
        curvature[at : at + bend] = rng.choice([-1, 1]) / radius
        at += bend + int(rng.uniform(15, 90))
    kernel = np.ones(11) / 11
    curvature = np.convolve(curvature, kernel, mode="same")
    wanted = np.repeat(rng.uniform(0.7, 1.0, length // 80 + 1) * fastest, 80)[:length]
    limit = np.minimum(wanted, np.sqrt(lateral_limit / np.maximum(np.abs(curvature), 1e-4)))
    limit = np.maximum(limit, slowest)
    for i in range(length - 2, -1, -1):
        limit[i] = min(limit[i], np.sqrt(limit[i + 1] ** 2 + 2 * 1.8))
    for i in range(1, length):
        limit[i] = min(limit[i], np.sqrt(limit[i - 1] ** 2 + 2 * 1.4))
    path = _along(curvature, limit)
    return _course(name, duration, float(limit[0]), path, follow=1.0, lateral=_unrest(rng, duration, 0.15))


def motorway(rng, duration, name, speed, *, changes=True, wavering=1.5) -> Course:
    length = duration * speed * 1.3
    x, y, lane = [0.0, 60.0], [0.0, 0.0], 0.0
    while changes and x[-1] < length - 400:
        start = x[-1] + rng.uniform(80, 260)
        lane = 3.6 if lane == 0 else 0.0
        x += [start, start + rng.uniform(4, 6) * speed * 0.9]
        y += [y[-1], lane]
    path = _offsets(np.array([*x, length + 500]), np.array([*y, y[-1]]), speed)
    s = np.arange(len(path.x))
    path.speed[:] = speed + wavering * np.sin(2 * np.pi * s / rng.uniform(350, 600))
    return _course(name, duration, speed, path, follow=1.0, lateral=_unrest(rng, duration, 0.12))


def _unrest(rng, duration, level):
    """Small movements of hands that are never still."""
    t = _time(duration)
    waves = [np.sin(2 * np.pi * (f * t + rng.uniform())) for f in rng.uniform(0.15, 0.9, 5)]
    return level * np.sum(waves, axis=0) / 2


def rich(rng) -> tuple[list[Course], list[Course]]:
    v = rng.uniform(0.94, 1.06)
    train = [
        steering_sweep(25 * v, 3.0),
        double_lane_change(19 * v),
        step_steers(22 * v, (2.5, 5.5)),
        slalom(18 * v, 6.5),
        accelerate_and_brake(),
        coast_down(33 * v),
        limit_ramp(20 * v, 11.0),
        brake_in_turn(21 * v, 4.2, 3.5),
    ]
    held_out = [
        double_lane_change(21 * v, offset=3.0, name="second double lane change"),
        power_on_in_turn(16 * v, 5.5),
        steering_sweep(19 * v, 4.2, fastest=2.0, duration=12.0, name="second sweep"),
        accelerate_and_brake("second accelerate and brake", slow=13.0, push=2.0, brake=5.5),
    ]
    return train, held_out


def everyday(rng) -> tuple[list[Course], list[Course]]:
    kinds = [(14.0, 8.0, 14.0, 2.8), (21.0, 10.0, 40.0, 3.2), (16.0, 8.0, 18.0, 3.0), (19.0, 9.0, 28.0, 3.0)]
    names = ("town", "rural road", "suburb", "way home")
    courses = [road(rng, 32.0, *kind, name) for kind, name in zip(kinds, names, strict=True)]
    return courses[:3], courses[3:]


def cruise(rng) -> tuple[list[Course], list[Course]]:
    courses = [motorway(rng, 32.0, f"motorway {i + 1}", rng.uniform(27, 33)) for i in range(4)]
    return courses[:3], courses[3:]


def steady(rng) -> tuple[list[Course], list[Course]]:
    """Straight ahead at one speed, by hands that are never still: where some causes look alike by construction."""
    speed = rng.uniform(27, 33)
    courses = [motorway(rng, 32.0, f"straight {i + 1}", speed, changes=False, wavering=0.0) for i in range(4)]
    return courses[:3], courses[3:]


SETS: dict[str, Callable] = {"rich": rich, "everyday": everyday, "cruise": cruise, "steady": steady}
ROUGHNESS = {"rich": 0.0010, "everyday": 0.0020, "cruise": 0.0012, "steady": 0.0012}  # [m] rms


def drawn(name: str, rng: np.random.Generator) -> tuple[list[Course], list[Course]]:
    """Courses of a set, to train on and held out, on roads as they are."""
    train, held_out = SETS[name](rng)
    return tuple(
        [replace(course, roughness=ROUGHNESS[name], seed=int(rng.integers(2**31))) for course in courses]
        for courses in (train, held_out)
    )
