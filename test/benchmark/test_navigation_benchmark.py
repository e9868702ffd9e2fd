"""What a step of each GNSS/INS filter of one state space costs: a prediction and its most frequent correction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vsense_ros import codegen
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.navigation.catalogue import DEFINITIONS

NUMBERS = {
    "mass": 1858.0, "yaw_inertia": 3515.0, "to_front": 1.36, "to_rear": 1.546, "front_stiffness": 154780.0,
    "rear_stiffness": 147540.0, "friction": 1.0, "roll_gain": 0.05, "roll_frequency": 11.8, "roll_damping": 0.1,
    "roll_arm": 0.49, "stiffness_deviation": 0.15, "gyro_scale_deviation": 0.01, "slip_error": 0.0015,
    "shaking_noise": 0.1, "pitching_noise": 0.05, "leaning": 5e-4, "grade_drift": 0.02, "bank_drift": 0.3,
    "steering_error": 0.3, "antenna_deviation": 0.5, "rolling_radius": 0.29, "rear_track": 1.536,
    "straight_rate": 0.0175, "sample_time": 0.01, "gyro_noise": 0.0018, "acceleration_noise": 0.5, "spin_noise": 0.04,
    "antenna_x": 0.3, "antenna_y": -0.1, "gravity": 9.81, "road_bank": 0.01, "road_bank_time": 20.0,
}  # fmt: skip
DENSE = [name for name, (_, definition, _) in DEFINITIONS.items() if isinstance(definition.make(NUMBERS), Ekf)]
LONGEST = 12e-6  # [s] of a step, median


@pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")
@pytest.mark.benchmark(group="GNSS/INS filters of one state space: prediction and correction")
@pytest.mark.parametrize("name", DENSE)
def test_navigation_filter(benchmark: Any, name: str) -> None:
    definition = DEFINITIONS[name][1]
    filter: Any = definition.make(NUMBERS)
    filter.inputs[:] = 0.01
    filter.start(definition.start({**NUMBERS, "yaw": 0.1, "forward_velocity": 15.0}))
    measurement = definition.measurements[-1] if definition.measurements else None
    value = np.zeros(0) if measurement is None else np.zeros(len(measurement.deviations))

    def step() -> None:
        filter.predict(0.01)
        if measurement is not None:
            filter.correct(measurement.name, value, measurement.variances + 1e-6)

    benchmark(step)
    assert filter.is_valid()
    if benchmark.stats is not None:
        assert benchmark.stats.stats.median < LONGEST
