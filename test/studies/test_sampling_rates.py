"""The continuous filter beside the discrete one: as good where sensors are quick, and not where they are slow."""

from __future__ import annotations

import pytest

from studies.sampling_rates import measure
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle


@pytest.mark.exam
def test_a_measurement_that_acts_until_the_next_one_spoils_the_yaw_rate_where_sensors_are_slow() -> None:
    found = {
        (r.filter, r.period): r.rmse for r in measure(load_vehicle(vehicle_path("prototype_model")), periods=(4, 50))
    }
    assert found["cekf", 4]["yaw_rate"] < 1.3 * found["dekf", 4]["yaw_rate"]
    assert found["cekf", 50]["yaw_rate"] > 3 * found["dekf", 50]["yaw_rate"]
    assert found["dekf", 50]["yaw_rate"] < 0.3  # [°/s]


def test_a_car_without_the_sensors_is_refused() -> None:
    car = load_vehicle(vehicle_path("prototype_model"))
    bare = car.model_copy(update={"sensors": {n: s for n, s in car.sensors.items() if s.kind != "imu"}})
    with pytest.raises(InputError, match="needs a sensor of kind imu"):
        measure(bare)
