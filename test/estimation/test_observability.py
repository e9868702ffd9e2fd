"""What a run tells of a state: ranks and directions that are known from the equations."""

from __future__ import annotations

import numpy as np
import pytest

from systems import COURSE, LINEAR, SPEED, VELOCITY, VelocityKkf, YawKkf
from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.observability import Observability, observability
from vsense_ros.estimation.record import Record
from vsense_ros.estimation.state_space import Measurement

RATE_OF_YAW = Measurement("rate", lambda x, z, u, p: u.yaw_rate - x.gyro_bias, (0.01,))


def driven(yaw_rate: float, measurement: Measurement, steps: int = 200) -> Observability:
    """The velocity filter in a bend of this yaw rate, or straight ahead."""
    filter = Record(Ekf(Dense(VelocityKkf(), [measurement])))
    filter.start(Gaussian(np.array([10.0, 0, 0, 0]), np.diag([1.0, 0.5, 1.0, 0.5]) ** 2))
    for _ in range(steps):
        filter.inputs[:] = 0.0, 10 * yaw_rate, yaw_rate
        filter.predict(0.01)
        filter.correct(*measurement.measured([10.0, 0.0][: len(measurement.deviations)]))
    return observability(filter)


def test_velocity_along_and_across_tells_of_both_biases() -> None:
    assert driven(0.0, VELOCITY).rank == 4


@pytest.mark.parametrize(("yaw_rate", "rank"), [(0.0, 2), (0.3, 3)])
def test_speed_alone_never_tells_of_both_biases(yaw_rate: float, rank: int) -> None:
    """Farrelly & Wellstead 1996: lateral velocity acts on the speed only in a bend, and then its bias is one with the
    other."""
    assert driven(yaw_rate, SPEED, 400).rank == rank


def test_what_is_not_told_is_named_in_words() -> None:
    found = driven(0.0, SPEED)
    assert {str(one) for one in found.undetermined} == {"lateral", "lateral_bias"}
    assert found.undetermined[0].remaining == pytest.approx(1.0)
    sentences = found.sentences()
    assert sentences[0] == "The measurements have information on 2 of 4 directions of the state."
    assert sentences[1].startswith("lateral")
    assert "is hardly determined: 100 % of its standard deviation remain" in sentences[1]
    assert any(line.startswith("forward: standard deviation 1 before the run, ") for line in sentences)


def test_a_combination_is_named_with_its_shares() -> None:
    """A measured sum of two states leaves their difference, in units of their deviations."""
    total = Measurement("total", lambda x, z, u, p: x.yaw + x.gyro_bias, (0.01,))
    filter = Record(Ekf(Dense(YawKkf(), [total])))
    filter.start(Gaussian(np.zeros(2), np.diag([1.0, 0.5]) ** 2))
    filter.correct(*total.measured([0.0]))
    found = observability(filter)
    assert found.rank == 1
    assert str(found.undetermined[0]) == "gyro_bias - 0.5 yaw"
    np.testing.assert_allclose(found.directions[1].eigenvalue, 1.25 / 0.01**2)


def test_without_noise_the_filter_ends_where_the_information_has_it() -> None:
    """(1/σ² + G)⁻¹ carried to the end of the run is the filter's covariance, if nothing disturbs the state."""
    filter = Record(Ekf(Dense(YawKkf(0.0, 0.0), [COURSE])))
    prior = np.array([0.2, 0.05])
    filter.start(Gaussian(np.zeros(2), np.diag(prior**2)))
    for _ in range(50):
        filter.predict(0.02)
        filter.correct(*COURSE.measured([0.0]))
    found = observability(filter)
    first = np.diag(prior) @ np.linalg.inv(np.eye(2) + found.gramian) @ np.diag(prior)
    carried = np.array([[1.0, -1.0], [0.0, 1.0]])  # a second of bias
    np.testing.assert_allclose(found.now**2, np.diag(carried @ first @ carried.T), rtol=1e-9)
    np.testing.assert_allclose(found.ratio, found.now / prior)


def test_units_make_no_difference() -> None:
    filter = Record(Ekf(Dense(YawKkf(0.0, 0.0), [RATE_OF_YAW])))
    filter.start(LINEAR["heading"].start)
    filter.correct(*RATE_OF_YAW.measured([0.0]))
    assert observability(filter).directions[1].eigenvalue == pytest.approx((0.02 / 0.01) ** 2)


def test_nothing_recorded_is_told() -> None:
    with pytest.raises(InputError, match="nothing was recorded"):
        observability(Record(Ekf(Dense(YawKkf(), [COURSE]))))
