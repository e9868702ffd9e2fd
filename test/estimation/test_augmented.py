"""Identification by a state that is continued by parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from systems import IMU, LINEAR, REST, SALOON, STIFFNESS, SingleTrack, drive, measured
from vsense_ros.errors import InputError
from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.dense import Dense, Jacobians
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.ukf import Ukf

WRONG = np.array([0.0, 0.0, 120e3, 180e3])
PRIOR = Gaussian(WRONG, np.diag(np.square([0.3, 0.1, 3e4, 3e4])))


IDENTIFYING: dict[str, Callable[[], Any]] = {
    "extended": lambda: Ekf(Dense(Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 0.0)), [IMU], REST)),
    "unscented": lambda: Ukf(Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 0.0)), [IMU], REST),
}


@pytest.mark.parametrize("way", IDENTIFYING)
def test_cornering_stiffness_is_found_from_a_start_that_is_a_fifth_off(way: str) -> None:
    case = LINEAR["single track"]
    filter = IDENTIFYING[way]()
    filter.inputs[:] = case.inputs(0.0)
    filter.start(PRIOR)
    drive(filter, case, measured(case, 2000, every=1))
    belief = filter.belief()
    assert filter.names[2:] == STIFFNESS
    truth = [SALOON[name] for name in STIFFNESS]
    error, sigma = belief.mean[2:] - truth, np.sqrt(np.diag(belief.covariance))[2:]
    assert (sigma < 0.002 * np.array(truth)).all()
    assert (np.abs(error) < 4 * sigma).all()


def test_a_parameter_may_be_augmented_after_another() -> None:
    once = Augmented(SingleTrack(), dict.fromkeys(STIFFNESS, 1.0))
    twice = Augmented(Augmented(SingleTrack(), {"front_stiffness": 1.0}), {"rear_stiffness": 1.0})
    case, found = LINEAR["single track"], []
    for system in (once, twice):
        filter = Ekf(Dense(system, [IMU], REST))
        filter.inputs[:] = case.inputs(0.0)
        filter.start(PRIOR)
        drive(filter, case, measured(case, 100))
        found.append(filter.memory)
    assert once.names == twice.names
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


def test_a_parameter_drifts_by_its_deviation_in_one_second() -> None:
    """By so much its variance grows in a step of any length, and it stays where it is."""
    for h in (0.01, 0.25):
        filter = Ekf(Dense(Augmented(SingleTrack(), {"front_stiffness": 500.0, "rear_stiffness": 0.0}), [IMU], REST))
        filter.inputs[:] = [0.0, 20.0]
        filter.start(PRIOR)
        filter.predict(h)
        grown = np.diag(filter.covariance - PRIOR.covariance)[2:]
        np.testing.assert_allclose(grown, [500.0**2 * h, 0.0], rtol=1e-6, atol=1e-3)
        assert filter.mean[2:].tolist() == WRONG[2:].tolist()


def test_without_attitudes_errors_are_differences() -> None:
    """⊞ and ⊟ of a vector space, with its parameters."""
    functions = Jacobians(Augmented(SingleTrack(), {"mass": 1.0}), [IMU])
    x, delta = np.array([1.0, 2.0, 1500.0]), np.array([0.1, -0.2, 30.0])
    moved = np.array(functions.retract(x, delta))[:, 0]
    np.testing.assert_allclose(moved, x + delta)
    np.testing.assert_allclose(np.array(functions.difference(moved, x))[:, 0], delta)


def test_a_parameter_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match="no parameter 'mas' to identify; it has: mass, yaw_inertia"):
        Augmented(SingleTrack(), {"mas": 0.0})
