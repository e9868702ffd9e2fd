"""Filters of the literature beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from studies.literature import liu_odometry


def test_wheel_odometry_closes_a_circle_around_its_centre() -> None:
    """The point is b_P ahead of the rear axle and b_Q to the left of its middle: all of it turns about one centre."""
    spins, rates = liu_odometry.wheels_on_circle(6.0, 30.0, 0.01)
    found = liu_odometry.follow(spins, rates, 0.01)
    at = found[:, :2]
    assert at[-1] == pytest.approx(at[0], abs=1e-3)
    centre = [-liu_odometry.CAR["ahead"], 30.0 - liu_odometry.CAR["beside"]]
    distance = np.hypot(*(at - centre).T)
    assert distance == pytest.approx(np.hypot(*centre), abs=0.05)
    assert found[-1, 6] == pytest.approx(2 * np.pi, abs=1e-9)


def test_a_smaller_outer_wheel_spoils_wheel_odometry_by_speed_and_by_yaw_rate() -> None:
    """A constant error e of a velocity in axes that turn by π at r leads 2 e / r away; the way is π 6 m/s / r long."""
    car, found = liu_odometry.CAR, liu_odometry.examine()[0]
    too_quick = 0.01 * 6.0 * (1 + car["track"] / 2 / 30.0)  # outer wheel [m/s]
    rate = too_quick / car["track"]
    error = np.hypot(too_quick / 2 - rate * car["beside"], rate * car["ahead"])
    assert found.reference == pytest.approx(100 * 2 * error / (np.pi * 6.0), rel=0.05)
    assert found.found < 0.05
