"""The filter's two operations: one call of C against kernels and algebra called one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drives import without_c
from vsense_ros import codegen
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.runner import Runner


@pytest.fixture
def filters(vehicle: Vehicle) -> tuple[ErrorEkf, ErrorEkf]:
    """Two equal filters, the second without its compiled step."""
    if codegen.compiler() is None:
        pytest.skip("no C compiler here")
    made = [Runner(vehicle).filter for _ in range(2)]
    without_c(made[1])
    for ekf in made:
        ekf.start_rolling(20.0)
        ekf.car.mean[[3, 4, 15, 19]] = 0.01, -0.005, 0.3, 0.2
        ekf.inputs[0] = 0.03
        ekf.linearize()
    return made[0], made[1]


@pytest.mark.parametrize("kind", ["imu", "wheel_speeds", "gnss_position", "gnss_velocity"])
def test_the_compiled_step_is_the_step_of_its_parts(filters: tuple[ErrorEkf, ErrorEkf], kind: str) -> None:
    car = filters[0].car
    name = next(n for n, sensor in zip(car.sensors, car.sensor_list, strict=True) if sensor.kind == kind)
    deviation = car.sensor_list[car.sensors.index(name)].deviations()
    found = []
    for ekf in filters:
        for h in (0.004, 0.01):
            ekf.predict(h)
        value = -ekf.car.sense(name, np.zeros(len(deviation)))[0] + deviation * np.resize([1.0, -0.5], len(deviation))
        value[0] = np.nan
        refused = ekf.correct(name, value, deviation**2, 1e-9)
        used = ekf.correct(name, value, deviation**2, 100.0)
        assert (refused.accepted, used.accepted) == (False, True)
        found.append((refused.nis, used.nis))
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert 0 < found[0][1] < 100
    for part in ("mean", "covariance", "udot"):
        ours, expected = (getattr(ekf.car, part) for ekf in filters)
        assert_allclose(ours, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
