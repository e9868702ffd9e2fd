"""The effects that the tool's library has, as the plants know them: a size of 1 is a value typical in practice.

Each says how its knobs are turned, and what parameter a tool could report for it. Wheel, axle, side and sign are drawn.
`python -m blind sizes` prints the table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from blind.cars import Car
from blind.knobs import Values

SIZES = (0.35, 1.0, 1.5)
WHEELS = ("fl", "fr", "rl", "rr")
AXLES = ("front", "rear")


@dataclass(frozen=True)
class Hidden:
    """One effect in one car."""

    knobs: Values
    value: float  # of the effect's parameter, in its unit
    where: str = ""  # wheel, axle, sensor or direction


@dataclass(frozen=True)
class Effect:
    parameter: str
    unit: str
    nominal: float
    hide: Callable[[float, np.random.Generator, Car], Hidden]
    best: str  # the course where it shows most (mismatch study)


def _plain(knob: str, nominal: float, *, signed: bool = False, **fixed: float):
    def hide(size, rng, car):
        value = size * nominal * (rng.choice([-1, 1]) if signed else 1)
        return Hidden({knob: value, **fixed}, value)

    return hide


def _vector(knob: str, nominal: float, axes: tuple[int, ...], *, signed: bool = True):
    def hide(size, rng, car):
        axis = int(rng.choice(axes))
        value = size * nominal * (rng.choice([-1, 1]) if signed else 1)
        return Hidden({knob: [value if i == axis else 0.0 for i in range(3)]}, value, "xyz"[axis])

    return hide


def _wheel(knob: str, nominal: float, *, signed: bool = False):
    def hide(size, rng, car):
        wheel = int(rng.integers(4))
        value = size * nominal * (rng.choice([-1, 1]) if signed else 1)
        return Hidden({knob: [value if i == wheel else 0.0 for i in range(4)]}, value, WHEELS[wheel])

    return hide


def _axle(knob: str, nominal: float):
    def hide(size, rng, car):
        axle = int(rng.integers(2))
        return Hidden({knob: [size * nominal if i == axle else 0.0 for i in range(2)]}, size * nominal, AXLES[axle])

    return hide


def _downforce(size, rng, car):
    area = 0.7 * size
    share = rng.uniform(0.25, 0.45)
    return Hidden({"lift_area": [-area * share, -area * (1 - share)]}, area)


def _crosswind(size, rng, car):
    speed, from_where = 8.0 * size, rng.choice([-1, 1]) * np.radians(rng.uniform(70, 110))
    wind = [speed * np.cos(from_where), speed * np.sin(from_where), 0.0]
    return Hidden({"wind": wind}, wind[1])


def _friction(size, rng, car):
    return Hidden({"friction_drop": 0.20 * size, "friction_place": rng.uniform(90, 150)}, -0.20 * size)


def _lock(size, rng, car):
    axle = 0 if car.front_drive > 0.5 else 1
    value = 130.0 * size
    return Hidden({"lock": [value if i == axle else 0.0 for i in range(2)]}, value, AXLES[axle])


def _bump_stop(size, rng, car):
    return Hidden({"bump_stiffness": 3.5e6 * size, "bump_gap": 0.014}, 3.5e6 * size)


def _payload(size, rng, car):
    mass, side = 130.0 * size, rng.choice([-1, 1])
    place = [rng.uniform(-0.6, 0.1), 0.45 * side, 0.10]
    return Hidden({"payload": mass, "payload_place": place}, mass * place[1], "left" if side > 0 else "right")


def _slosh(size, rng, car):
    mass = 160.0 * size
    return Hidden({"slosh_mass": mass, "slosh_length": rng.uniform(0.35, 0.6), "slosh_damping": 0.06}, mass)


def _delay(size, rng, car):
    sensor, knob, nominal = [
        ("imu", "imu_delay", 0.040),
        ("steering", "steering_delay", 0.040),
        ("wheel_speeds", "wheel_delay", 0.060),
        ("gnss", "gnss_delay", 0.120),
    ][rng.integers(4)]
    return Hidden({knob: nominal * size}, nominal * size, sensor)


def _misaligned(axis: int):
    def hide(size, rng, car):
        value = np.radians(2.0) * size * rng.choice([-1, 1])
        return Hidden({"imu_attitude": [value if i == axis else 0.0 for i in range(3)]}, value)

    return hide


EFFECTS: Mapping[str, Effect] = MappingProxyType(
    {
        "aero_drag": Effect("additional drag area", "m²", 0.30, _plain("drag_area", 0.30), "coast-down"),
        "aero_downforce": Effect("downforce area, both axles", "m²", 0.70, _downforce, "brake in turn"),
        "road_grade": Effect("amplitude of the profile", "rad", 0.03, _plain("grade", 0.03, signed=True), "coast-down"),
        "road_bank": Effect("amplitude of the profile", "rad", 0.03, _plain("bank", 0.03, signed=True), "coast-down"),
        "rolling_resistance": Effect(
            "additional coefficient", "-", 0.008, _plain("rolling_extra", 0.008), "coast-down"
        ),
        "crosswind": Effect("wind to the left in the map", "m/s", 8.0, _crosswind, "coast-down"),
        "steering_offset": Effect(
            "at the steering wheel", "rad", 0.087, _plain("steering_offset", 0.087, signed=True), "steering sweep"
        ),
        "steering_ratio": Effect("relative change", "-", 0.08, _plain("ratio_change", 0.08, signed=True), "limit ramp"),
        "steering_compliance": Effect(
            "road-wheel angle per moment about both kingpins",
            "rad/(N m)",
            3.5e-5,
            _plain("steering_compliance", 3.5e-5),
            "limit ramp",
        ),
        "roll_steer": Effect("axle angle per suspension roll", "rad/rad", 0.08, _axle("roll_steer", 0.08), "slalom"),
        "toe_compliance": Effect(
            "wheel angle per lateral force", "rad/N", 2.2e-6, _axle("toe_compliance", 2.2e-6), "slalom"
        ),
        "camber_thrust": Effect(
            "thrust over load per camber", "1/rad", 1.0, _plain("camber_stiffness", 1.0), "limit ramp"
        ),
        "tyre_conicity": Effect(
            "lateral force at the nominal load", "N", 160.0, _wheel("conicity", 160.0, signed=True), "coast-down"
        ),
        "tyre_relaxation": Effect("relaxation length", "m", 0.55, _plain("relaxation", 0.55), "steering sweep"),
        "tyre_load_sensitivity": Effect(
            "exponent of friction over load", "-", 0.15, _plain("load_exponent", 0.15), "limit ramp"
        ),
        "tyre_heating": Effect("grip lost per kelvin", "1/K", 0.0030, _plain("heat_loss", 0.0030), "limit ramp"),
        "tyre_underinflation": Effect("pressure lost", "-", 0.35, _wheel("pressure_loss", 0.35), "coast-down"),
        "wheel_radius": Effect(
            "relative change", "-", 0.015, _wheel("radius_change", 0.015, signed=True), "coast-down"
        ),
        "friction_change": Effect("relative change of grip on wet patches", "-", -0.20, _friction, "limit ramp"),
        "brake_drag": Effect("torque", "N m", 60.0, _wheel("brake_drag", 60.0), "coast-down"),
        "limited_slip_differential": Effect("torque per speed difference", "N m s/rad", 130.0, _lock, "brake in turn"),
        "suspension_friction": Effect("force of each strut", "N", 150.0, _plain("strut_friction", 150.0), "slalom"),
        "bump_stop": Effect("progression beyond 14 mm", "N/m²", 3.5e6, _bump_stop, "limit ramp"),
        "payload_offset": Effect("mass times offset to the left", "kg m", 58.5, _payload, "accelerate and brake"),
        "sloshing_load": Effect("moving mass", "kg", 160.0, _slosh, "steering sweep"),
        "body_roll_in_accelerometer": Effect(
            "extra share of the body's roll", "-", 0.7, _plain("imu_roll_sense", 0.7), "limit ramp"
        ),
        "imu_roll_misalignment": Effect("angle", "rad", 0.035, _misaligned(0), "accelerate and brake"),
        "imu_pitch_misalignment": Effect("angle", "rad", 0.035, _misaligned(1), "limit ramp"),
        "imu_yaw_misalignment": Effect("angle", "rad", 0.035, _misaligned(2), "accelerate and brake"),
        "imu_lever_arm": Effect("distance", "m", 0.45, _vector("imu_place", 0.45, (0, 1)), "steering sweep"),
        "gnss_lever_arm": Effect("distance", "m", 0.9, _vector("gnss_place", 0.9, (0, 1)), "steering sweep"),
        "gyro_bias": Effect("rate", "rad/s", 0.0175, _vector("gyro_bias", 0.0175, (0, 1, 2)), "coast-down"),
        "gyro_scale": Effect(
            "relative change of the yaw gyro", "-", 0.03, _vector("gyro_scale", 0.03, (2,)), "limit ramp"
        ),
        "accelerometer_bias": Effect(
            "acceleration", "m/s²", 0.35, _vector("accelerometer_bias", 0.35, (0, 1)), "coast-down"
        ),
        "sensor_delay": Effect("time, 0.040 s for IMU and steering", "s", 0.040, _delay, "steering sweep"),
    }
)
