"""How the tool's library names what the plants hide: expected parameters by their names and units there.

The plants' equations are others, so a value is only given where both mean the same quantity. What zeroing has left of a
sensor's bias is no other quantity than a hidden bias: both together are what can be found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from blind.cars import Car
from blind.effects import AXLES, Hidden
from blind.sensors import Biases

MECHANICAL_TRAIL = 0.018  # [m] of the plants' kingpins
SPEED_OF_ROLLING = 20.0  # [m/s] at which the plants' rolling resistance, which grows with speed, is compared


def _named(name: str) -> Callable[[Hidden, Car], dict[str, float]]:
    return lambda hidden, car: {name: hidden.value}


def _where(hidden: Hidden, car: Car) -> dict[str, float]:
    return {hidden.where: hidden.value}


def _both_axles(hidden: Hidden, car: Car) -> dict[str, float]:
    return dict.fromkeys(AXLES, hidden.value)


def _conicity(hidden: Hidden, car: Car) -> dict[str, float]:
    axle = car.front if hidden.where.startswith("f") else car.rear
    return {hidden.where: hidden.value / axle.nominal_load}


_EXPECTED: Mapping[str, Callable[[Hidden, Car], dict[str, float]]] = {
    "aero_drag": _named("area"),
    "aero_downforce": lambda h, car: {axle: -v for axle, v in zip(AXLES, h.knobs["lift_area"], strict=True)},
    "rolling_resistance": lambda h, car: {"coefficient": h.value * (1 + (SPEED_OF_ROLLING / 45) ** 2)},
    "crosswind": lambda h, car: dict(zip(("east", "north"), h.knobs["wind"], strict=False)),
    "steering_offset": lambda h, car: {"angle": h.value / car.ratio},
    "steering_ratio": lambda h, car: {"relative": 1 / (1 + h.value) - 1},
    "steering_compliance": lambda h, car: {"compliance": h.value * (MECHANICAL_TRAIL + car.front.trail)},
    "roll_steer": _where,
    "toe_compliance": _where,
    "camber_thrust": _both_axles,
    "tyre_conicity": _conicity,
    "tyre_relaxation": _both_axles,
    "tyre_underinflation": _where,
    "wheel_radius": _where,
    "friction_change": _named("relative"),
    "brake_drag": _where,
    "limited_slip_differential": _where,
    "suspension_friction": _both_axles,
    "payload_offset": _named("moment"),
    "sloshing_load": _named("mass"),
    "body_roll_in_accelerometer": _named("gain"),
    "imu_roll_misalignment": _named("angle"),
    "imu_pitch_misalignment": _named("angle"),
    "imu_yaw_misalignment": _named("angle"),
    "imu_lever_arm": _where,
    "gnss_lever_arm": _where,
    "gyro_bias": _where,
    "gyro_scale": _where,
    "accelerometer_bias": _where,
    "sensor_delay": _where,
    # Other shapes than the library's: a profile along the path, another stop, another warming, a power against a line.
    "tyre_load_sensitivity": lambda h, car: {},
    "road_grade": lambda h, car: {},
    "road_bank": lambda h, car: {},
    "bump_stop": lambda h, car: {},
    "tyre_heating": lambda h, car: {},
}


def expected(name: str, hidden: Hidden, car: Car, biases: Biases | None = None) -> dict[str, float]:
    """Parameters of the library's effect that describe what is hidden, beside what the sensors have; empty where they
    are not comparable."""
    if name not in _EXPECTED:
        return {}
    found = _EXPECTED[name](hidden, car)
    left = {} if biases is None else _left_of_biases(name, biases, car)
    return {key: float(f"{value + left.get(key, 0.0):.6g}") for key, value in found.items()}


def _left_of_biases(name: str, biases: Biases, car: Car) -> dict[str, float]:
    """What zeroing has left of biases, as parameters of a library's effect."""
    if name == "gyro_bias":
        return dict(zip("xyz", biases.gyro, strict=True))
    if name == "accelerometer_bias":
        return dict(zip("xyz", biases.accelerometer, strict=True))
    if name == "steering_offset":
        return {"angle": -biases.handwheel / car.ratio}
    return {}
