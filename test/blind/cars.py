"""Three cars of different kind, what differs from car to car of one kind, and many of them side by side in arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np

GRAVITY = 9.81


@dataclass(frozen=True)
class Axle:
    track: float  # [m]
    roll_centre_height: float  # [m]
    hub_mass: float  # [kg] one side
    wheel_mass: float  # [kg] one
    spin_inertia: float  # [kg m²]
    diametral_inertia: float  # [kg m²]
    spring: float  # [N/m] at the wheel
    damper: float  # [N s/m]
    antiroll: float  # [N/m] per difference in travel
    radius: float  # [m] unloaded
    tyre_vertical: float  # [N/m]
    tyre_damping: float  # [N s/m]
    rolling_resistance: float  # [-]
    nominal_load: float  # [N]
    cornering: float  # [N/rad] at the nominal load
    slip_stiffness: float  # [N]
    friction_x: float  # [-]
    friction_y: float  # [-]
    stiffness_fall: float  # [-] share per nominal load
    friction_fall: float  # [-]
    trail: float  # [m] pneumatic


@dataclass(frozen=True)
class Car:
    name: str
    mass: float  # [kg] whole
    roll_inertia: float  # [kg m²] whole, about cog
    pitch_inertia: float
    yaw_inertia: float
    cog_height: float  # [m]
    front_arm: float  # [m] cog to axle
    rear_arm: float  # [m]
    ratio: float  # [-] steering
    drag_area: float  # [m²]
    front_drive: float  # [-] share of the drive torque
    front_brake: float  # [-] share of the brake torque
    front: Axle
    rear: Axle
    # No car is as its model says; the following are in no vehicle file, and never the answer.
    torque_gain: float = 1.0  # [-] torque at the wheels over what the network tells
    damper_asymmetry: float = 0.0  # [-] share that moves from compression to rebound
    spring_progression: float = 0.0  # [1/m] relative increase of the spring rate with travel

    @property
    def wheelbase(self) -> float:
        return self.front_arm + self.rear_arm


CARS = (
    Car(
        "hatchback", 1290.0, 420.0, 1650.0, 1850.0, 0.54, 1.02, 1.58, 15.5, 0.68, 1.0, 0.66,
        Axle(1.51, 0.05, 18.0, 17.0, 0.95, 0.55, 25e3, 2100.0, 13e3, 0.305, 205e3, 150.0, 0.011,
             3840.0, 66e3, 78e3, 1.02, 0.97, 0.42, 0.09, 0.028),
        Axle(1.49, 0.11, 16.0, 17.0, 0.95, 0.55, 23e3, 1900.0, 8e3, 0.305, 205e3, 150.0, 0.011,
             2480.0, 57e3, 62e3, 1.02, 0.97, 0.36, 0.08, 0.025),
    ),
    Car(
        "saloon", 1640.0, 610.0, 2750.0, 3050.0, 0.56, 1.32, 1.50, 14.6, 0.62, 0.0, 0.62,
        Axle(1.58, 0.06, 24.0, 22.0, 1.35, 0.80, 29e3, 2600.0, 19e3, 0.328, 230e3, 150.0, 0.010,
             4280.0, 79e3, 92e3, 1.06, 1.02, 0.40, 0.08, 0.030),
        Axle(1.57, 0.10, 24.0, 22.0, 1.35, 0.80, 31e3, 2700.0, 9e3, 0.328, 230e3, 150.0, 0.010,
             3770.0, 92e3, 96e3, 1.06, 1.02, 0.38, 0.08, 0.028),
    ),
    Car(
        "sport utility", 1930.0, 850.0, 3300.0, 3650.0, 0.68, 1.28, 1.52, 16.2, 0.86, 0.4, 0.64,
        Axle(1.62, 0.07, 30.0, 27.0, 1.90, 1.10, 33e3, 3100.0, 24e3, 0.360, 255e3, 180.0, 0.012,
             5140.0, 86e3, 102e3, 0.99, 0.93, 0.44, 0.10, 0.032),
        Axle(1.62, 0.12, 29.0, 27.0, 1.90, 1.10, 35e3, 3200.0, 12e3, 0.360, 255e3, 180.0, 0.012,
             4330.0, 93e3, 98e3, 0.99, 0.93, 0.40, 0.09, 0.030),
    ),
)  # fmt: skip


def drawn(rng: np.random.Generator) -> Car:
    """A car of one of the kinds, its masses, springs, tyres and dimensions a few percent off the type."""
    car = CARS[rng.integers(len(CARS))]

    def varied(value: float, share: float) -> float:
        return value * (1 + share * rng.uniform(-1, 1))

    def axle(a: Axle) -> Axle:
        return replace(
            a,
            cornering=varied(a.cornering, 0.08),
            slip_stiffness=varied(a.slip_stiffness, 0.08),
            friction_x=varied(a.friction_x, 0.05),
            friction_y=varied(a.friction_y, 0.05),
            spring=varied(a.spring, 0.08),
            damper=varied(a.damper, 0.1),
            antiroll=varied(a.antiroll, 0.08),
        )

    heavier = rng.uniform(0.96, 1.08)
    return replace(
        car,
        mass=car.mass * heavier,
        roll_inertia=car.roll_inertia * heavier,
        pitch_inertia=car.pitch_inertia * heavier,
        yaw_inertia=varied(car.yaw_inertia * heavier, 0.04),
        cog_height=varied(car.cog_height, 0.03),
        front=axle(car.front),
        rear=axle(car.rear),
        torque_gain=varied(1.0, 0.015),
        damper_asymmetry=rng.uniform(-0.05, 0.25),
        spring_progression=rng.uniform(0.0, 2.0),
    )


def side_by_side(cars: list[Car]) -> SimpleNamespace:
    """Each field of `Car` as an array (lanes,), each of `Axle` as one of (4, lanes) in the order fl, fr, rl, rr."""
    batch = SimpleNamespace(lanes=len(cars))
    for field in fields(Car):
        if field.name not in ("name", "front", "rear"):
            setattr(batch, field.name, np.array([getattr(c, field.name) for c in cars]))
    for field in fields(Axle):
        front = np.array([getattr(c.front, field.name) for c in cars])
        rear = np.array([getattr(c.rear, field.name) for c in cars])
        setattr(batch, field.name, np.stack([front, front, rear, rear]))
    batch.wheelbase = batch.front_arm + batch.rear_arm
    batch.arm = np.stack([batch.front_arm, batch.front_arm, -batch.rear_arm, -batch.rear_arm])
    batch.side = np.array([1.0, -1.0, 1.0, -1.0])[:, None] * np.ones(len(cars))
    batch.unsprung = batch.hub_mass + batch.wheel_mass
    far = np.stack([batch.rear_arm, batch.rear_arm, batch.front_arm, batch.front_arm])
    batch.static_load = batch.mass * GRAVITY * far / batch.wheelbase / 2
    loaded = batch.radius - batch.static_load / batch.tyre_vertical
    batch.centre = np.stack([batch.arm, batch.side * batch.track / 2, loaded - batch.cog_height])  # (3, 4, lanes)
    slope = 2 * batch.roll_centre_height / batch.track
    length = np.sqrt(1 + slope**2)
    batch.guide = np.stack([np.zeros_like(slope), batch.side * slope / length, 1 / length])
    batch.preload = (batch.static_load - batch.unsprung * GRAVITY) * batch.guide[2]
    return batch
