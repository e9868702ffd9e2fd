"""Drivers, one per lane: they follow a path with preview, hold a speed, and steer, drive and brake by programme."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from blind.courses import TABLE_STEP
from blind.physics.road import rough_phases
from blind.plants.log import SETTLING

PREVIEW = 0.85  # [s]
SPEED_GAIN = 0.6  # [1/s]
STRONGEST = 3.5  # [m/s²] that a driver asks for to hold a speed
LARGEST_HANDWHEEL = 7.0  # [rad]


class Drivers:
    """What each lane's driver asks for."""

    def __init__(self, cars, courses) -> None:
        self.car = cars
        length = max(len(course.path.x) for course in courses)
        self.path = {
            name: np.stack([_extended(getattr(c.path, name), length) for c in courses], axis=1)
            for name in ("x", "y", "heading", "speed")
        }
        steps = max(len(course.lateral) for course in courses)
        self.tables = {
            name: np.stack([_extended(getattr(c, name), steps, hold=True) for c in courses], axis=1)
            for name in ("lateral", "follow", "forward", "hold")
        }
        phase = np.stack([rough_phases(np.random.default_rng(c.seed)) for c in courses], axis=-1)
        self.surface = SimpleNamespace(rms=np.array([c.roughness for c in courses]), phase=phase)
        self.lanes = np.arange(len(courses))
        self.along = np.zeros(len(courses))
        self.gradient = _understeer_gradient(cars)
        self.programme_speed = np.array([course.speed for course in courses])

    def _at(self, along):
        """Point of the path at a distance along it."""
        last = len(self.path["x"]) - 2
        place = np.clip(along, 0, last)
        row = place.astype(int)
        share = along - row
        return SimpleNamespace(
            along=along,
            surface=self.surface,
            **{
                name: table[row, self.lanes] * (1 - share) + table[row + 1, self.lanes] * share
                for name, table in self.path.items()
            },
        )

    def command(self, time, motion):
        """Nearest point of the path, and what driver and programme ask for; programmes begin when the log does."""
        time = max(time - SETTLING, 0.0)
        point = self._at(self.along)
        for _ in range(2):
            forward = (motion.position[0] - point.x) * np.cos(point.heading)
            forward = forward + (motion.position[1] - point.y) * np.sin(point.heading)
            self.along = np.clip(self.along + forward, 0, None)
            point = self._at(self.along)
        row = min(int(time / TABLE_STEP + 1e-9), len(self.tables["hold"]) - 2)
        share = time / TABLE_STEP - row
        now = {name: t[row] * (1 - share) + t[row + 1] * share for name, t in self.tables.items()}

        speed = np.maximum(motion.velocity[0], 3.0)
        ahead = self._at(self.along + speed * PREVIEW)
        yaw = np.arctan2(motion.rotation[1, 0], motion.rotation[0, 0])
        dx, dy = ahead.x - motion.position[0], ahead.y - motion.position[1]
        sideways = -dx * np.sin(yaw) + dy * np.cos(yaw)
        curvature = 2 * sideways / (dx**2 + dy**2)
        car = self.car
        pursuit = car.ratio * curvature * (car.wheelbase + self.gradient * speed**2)
        fixed = self.programme_speed
        by_programme = now["lateral"] / fixed**2 * car.ratio * (car.wheelbase + self.gradient * fixed**2)
        handwheel = np.clip(now["follow"] * pursuit, -LARGEST_HANDWHEEL, LARGEST_HANDWHEEL) + by_programme
        held = np.clip(SPEED_GAIN * (point.speed - motion.velocity[0]), -STRONGEST, STRONGEST)
        return point, SimpleNamespace(handwheel=handwheel, acceleration=now["hold"] * held + now["forward"])


def _extended(table, length, hold=False):
    """Lengthened straight ahead, or with its last value."""
    missing = length - len(table)
    if missing <= 0:
        return table[:length]
    slope = 0.0 if hold else table[-1] - table[-2]
    return np.concatenate([table, table[-1] + slope * np.arange(1, missing + 1)])


def _understeer_gradient(car):
    """Understeer gradient of the linear single-track car [s²]: steering beyond that of the wheelbase, per v²."""
    front, rear = 2 * _stiffness(car, 0), 2 * _stiffness(car, 2)
    return car.mass / car.wheelbase * (car.rear_arm / front - car.front_arm / rear)


def _stiffness(car, wheel):
    ratio = car.static_load[wheel] / car.nominal_load[wheel]
    return car.cornering[wheel] * ratio * (1 + car.stiffness_fall[wheel]) / (1 + car.stiffness_fall[wheel] * ratio)
