"""What can be hidden in a plant or its sensors: one physical quantity each, zero where nothing is hidden.

Effects (`effects.py`, `outside.py`) turn knobs; plants, drivers and sensors read them and know no effect.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

WHEEL, AXLE, VECTOR, ONE = 4, 2, 3, 1

KNOBS: dict[str, tuple[int, str]] = {
    # air
    "drag_area": (ONE, "m²"),
    "lift_area": (AXLE, "m² positive up"),
    "wind": (VECTOR, "m/s in the map"),
    # road, functions of place
    "grade": (ONE, "rad amplitude"),
    "bank": (ONE, "rad amplitude"),
    "undulation": (ONE, "m amplitude of waves 7 m long"),
    "friction_drop": (ONE, "- on wet patches"),
    "friction_place": (ONE, "m along the path, where one begins"),
    "friction_drop_left": (ONE, "- under the left wheels"),
    "friction_fall_with_speed": (ONE, "s/m"),
    "front_grip_lost_beyond_speed": (ONE, "m/s, 0: never"),
    # steering
    "steering_offset": (ONE, "rad at the steering wheel"),
    "ratio_change": (ONE, "-"),
    "ratio_progression": (ONE, "1/rad²"),
    "steering_compliance": (ONE, "rad/(N m) at the kingpins"),
    "free_play": (ONE, "rad at the steering wheel, half width"),
    "rear_steering": (ONE, "rad/rad of the front"),
    "torque_steer": (ONE, "rad/(N m)"),
    # wheel guidance
    "roll_steer": (AXLE, "rad/rad"),
    "toe_compliance": (AXLE, "rad/N"),
    "toe_play": (WHEEL, "rad"),
    "toe_by_torque": (AXLE, "rad, half width"),
    "strut_friction": (ONE, "N"),
    "bump_stiffness": (ONE, "N/m²"),
    "bump_gap": (ONE, "m"),
    "damper_loss": (WHEEL, "-"),
    "active_roll": (ONE, "N m/(m/s²)³"),
    # tyres
    "rolling_extra": (ONE, "-"),
    "camber_stiffness": (ONE, "1/rad over load"),
    "conicity": (WHEEL, "N at the nominal load"),
    "relaxation": (ONE, "m"),
    "load_exponent": (ONE, "- power law of friction over load"),
    "heat_loss": (ONE, "1/K"),
    "pressure_loss": (WHEEL, "- of the pressure"),
    "radius_change": (WHEEL, "-"),
    "imbalance": (WHEEL, "kg m"),
    # brakes and driveline
    "brake_drag": (WHEEL, "N m"),
    "brake_pull": (ONE, "- of the brake torque, left more than told"),
    "brake_fade": (ONE, "1/MJ"),
    "esc_torque": (ONE, "N m per m/s² beyond 4 m/s²"),
    "lock": (AXLE, "N m s/rad"),
    "vectoring": (ONE, "N m/rad of the steering wheel"),
    "engine_drag": (ONE, "N m on the driven wheels together"),
    "shaft_frequency": (ONE, "Hz, 0: stiff"),
    # load
    "payload": (ONE, "kg"),
    "payload_place": (VECTOR, "m from cog"),
    "cargo_mass": (ONE, "kg, loose"),
    "cargo_travel": (ONE, "m"),
    "slosh_mass": (ONE, "kg"),
    "slosh_length": (ONE, "m"),
    "slosh_damping": (ONE, "-"),
    "trailer_mass": (ONE, "kg"),
    # sensors
    "imu_roll_sense": (ONE, "- extra share of the body's roll"),
    "imu_attitude": (VECTOR, "rad"),
    "imu_place": (VECTOR, "m"),
    "gnss_place": (VECTOR, "m"),
    "gyro_bias": (VECTOR, "rad/s"),
    "gyro_scale": (VECTOR, "-"),
    "gyro_by_acceleration": (ONE, "rad/s per m/s²"),
    "accelerometer_bias": (VECTOR, "m/s²"),
    "accelerometer_square": (ONE, "s²/m"),
    "imu_delay": (ONE, "s"),
    "wheel_delay": (ONE, "s"),
    "steering_delay": (ONE, "s"),
    "gnss_delay": (ONE, "s"),
}

Values = dict[str, float | list[float]]


class Knobs(SimpleNamespace):
    """Arrays (lanes,) or (2 | 3 | 4, lanes) by name, and the names of those that are turned anywhere."""

    turned: frozenset[str]

    def any(self, *names: str) -> bool:
        return any(name in self.turned for name in names)


def side_by_side(lanes: list[Values]) -> Knobs:
    """Knobs of many lanes as arrays."""
    batch = Knobs()
    for name, (size, _) in KNOBS.items():
        column = np.zeros((size, len(lanes)))
        for i, values in enumerate(lanes):
            if name in values:
                column[:, i] = values[name]
        setattr(batch, name, column if size > 1 else column[0])
    batch.turned = frozenset(name for lane in lanes for name in lane)
    unknown = batch.turned - KNOBS.keys()
    if unknown:
        raise KeyError(f"no such knobs: {sorted(unknown)}")
    return batch
