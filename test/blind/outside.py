"""Physics that no effect of the library describes: the right answer is "unknown"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from blind.effects import AXLES, WHEELS, Hidden


def _plain(**knobs) -> Callable:
    return lambda rng, car: Hidden(dict(knobs), float("nan"))


def _one_wheel(knob: str, value: float) -> Callable:
    def hide(rng, car):
        wheel = int(rng.integers(4))
        return Hidden({knob: [value if i == wheel else 0.0 for i in range(4)]}, float("nan"), WHEELS[wheel])

    return hide


def _one_axle(knob: str, value: float, axle: int) -> Callable:
    return lambda rng, car: Hidden({knob: [value if i == axle else 0.0 for i in range(2)]}, float("nan"), AXLES[axle])


def _either_sign(**knobs) -> Callable:
    def hide(rng, car):
        sign = float(rng.choice([-1, 1]))
        return Hidden({name: sign * value for name, value in knobs.items()}, float("nan"))

    return hide


OUTSIDE: Mapping[str, Callable[[np.random.Generator, object], Hidden]] = MappingProxyType(
    {
        "esc_yaw_moment": _plain(esc_torque=280.0),
        "steering_free_play": _plain(free_play=0.07),
        "variable_steering_ratio": _plain(ratio_progression=0.12),
        "rear_wheel_steering": _either_sign(rear_steering=0.10),
        "torque_steer": _either_sign(torque_steer=6e-6),
        "wheel_bearing_play": _one_wheel("toe_play", 0.010),
        "loose_rear_link": _one_axle("toe_by_torque", 0.010, 1),
        "failed_damper": _one_wheel("damper_loss", 0.95),
        "active_roll_control": _plain(active_roll=16.0),
        "one_sided_brake": _either_sign(brake_pull=0.30),
        "brake_fade": _plain(brake_fade=2.2),
        "torque_vectoring": _either_sign(vectoring=150.0),
        "engine_drag": _plain(engine_drag=420.0),
        "ringing_driveshafts": _plain(shaft_frequency=4.5),
        "trailer": _plain(trailer_mass=700.0),
        "loose_cargo": _plain(cargo_mass=140.0, cargo_travel=0.45),
        "friction_falls_with_speed": _plain(friction_fall_with_speed=0.025),
        "aquaplaning": _plain(front_grip_lost_beyond_speed=20.0),
        "split_friction": _plain(friction_drop_left=0.45),
        "road_undulation": _plain(undulation=0.006),
        "wheel_imbalance": _one_wheel("imbalance", 0.12),
        "gyro_feels_acceleration": _either_sign(gyro_by_acceleration=0.004),
        "accelerometer_not_linear": _either_sign(accelerometer_square=0.018),
    }
)
