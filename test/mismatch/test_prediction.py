"""What a car would have measured, as the search for missing physics simulates it."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import driven, having, prototype
from vsense_ros.mismatch.driving import turning
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import WINDOWS, build_dataset

HEATING = {"front": 0.01, "rear": 0.01}


def levels(recording, vehicle) -> list[float]:
    """How far a car is off in each window of a recording [deviations]."""
    residuals = Residuals(Predictor(vehicle, build_dataset([recording], vehicle)))
    return [residuals.level([window]) for window in residuals(residuals.predictor.start)]


@pytest.mark.exam
def test_tyres_are_as_warm_where_a_window_begins_as_what_was_driven_before_has_made_them():
    """The recording is of one drive, from cold tyres on; its windows are simulated one by one."""
    hot = having(prototype(), tyre_heating=HEATING)
    windows = levels(driven(hot, "at the limit", duration=60.0), hot)
    assert len(windows) == 3
    assert max(windows) < 1.0  # with cold tyres 1.9 in the second, 3.0 in the third


def test_tyres_cool_where_nothing_is_driven():
    hot = having(prototype(), tyre_heating=HEATING)
    effect = hot.physics.effects.tyre_heating
    assert effect.relaxed(np.full(4, 50.0), 0.0) == pytest.approx(50.0)
    assert effect.relaxed(np.full(4, 50.0), effect.cooling_time) == pytest.approx(50.0 / np.e)
    assert 0.1 * effect.cooling_time > WINDOWS.run_in


def test_a_window_that_begins_in_a_bend_begins_with_about_the_side_slip_and_the_wheel_speeds_of_one():
    recording = driven(prototype(), "bend", duration=15.0)
    odometry, wheels = recording["reference/odometry"], recording["vehicle/wheel_speeds"]
    settled = 10.0e9 + odometry.stamp[0]
    row = int(np.searchsorted(odometry.stamp, settled))
    forward, left, _ = odometry.columns["linear"][row]
    yaw_rate = odometry.columns["angular"][row, 2]
    _, u = turning(prototype(), float(forward), float(yaw_rate))
    of_rear_axle = left - yaw_rate * prototype().physics.chassis.cog_to_rear_axle
    assert of_rear_axle < -0.1
    assert u[1] == pytest.approx(left, abs=0.35 * abs(of_rear_axle))
    spin = wheels.columns["velocity"][int(np.searchsorted(wheels.stamp, settled))]
    assert u[10:] == pytest.approx(spin, rel=0.005)
    assert np.ptp(spin) > 0.03 * spin.mean()


def test_where_a_window_begins_in_a_bend_at_the_limit_the_car_of_the_simulation_turns_already():
    """The car turns all the time, and its tyres are not stretched by a driver who turns in at once."""
    windows = levels(driven(prototype(), "bend at the limit", duration=60.0), prototype())
    assert max(windows) < 2.5  # 3.7 where windows begin straight on
