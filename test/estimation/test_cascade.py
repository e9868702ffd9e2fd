"""The dual kinematic Kalman filter (Leung 2010, section 4.2) in a row, beside its equations written out."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from systems import COURSE, VELOCITY, VelocityKkf, YawKkf
from vsense_ros.errors import InputError
from vsense_ros.estimation.cascade import Cascade, PassedInput, PassedMeasurement
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.state_space import Measurement, Named

SPEED_NOISE, COURSE_NOISE = 0.035, 0.01
GNSS = Measurement("gnss", lambda x, z, u, p: [], (SPEED_NOISE, COURSE_NOISE))  # speed over ground [m/s], course [rad]
RATE = PassedInput("heading", "velocity", lambda x, u: u.yaw_rate - x.gyro_bias, ("yaw_rate",))
OVER_GROUND = PassedMeasurement(
    GNSS,
    "heading",
    "velocity",
    "velocity",
    lambda x, gnss: [gnss[0] * ca.cos(gnss[1] - x.yaw), gnss[0] * ca.sin(gnss[1] - x.yaw)],
)
START = Gaussian(np.array([0.1, 0.0, 10.0, 0.0, 0.0, 0.0]), np.diag([0.05, 0.02, 1.0, 0.5, 1.0, 0.5]) ** 2)


def dual() -> Cascade:
    filters = {"heading": Ekf(Dense(YawKkf(), [COURSE])), "velocity": Ekf(Dense(VelocityKkf(), [VELOCITY]))}
    made = Cascade(filters, (RATE,), (OVER_GROUND,))
    made.start(START)
    return made


class WrittenOut:
    """Leung 2010, eqs. 4.1 to 4.6, as matrices."""

    def __init__(self) -> None:
        self.x, self.p = START.mean[:2].copy(), START.covariance[:2, :2].copy()
        self.y, self.q = START.mean[2:].copy(), START.covariance[2:, 2:].copy()

    def predict(self, a: tuple[float, float], r: float, h: float) -> None:
        f = np.array([[1.0, -h], [0.0, 1.0]])
        self.x = f @ self.x + [h * r, 0.0]
        self.p = f @ self.p @ f.T + np.diag([0.005**2, 1e-10]) * h
        rate = r - self.x[1]
        g = np.eye(4) + h * np.array([[0, -1, rate, 0], [0, 0, 0, 0], [-rate, 0, 0, -1], [0, 0, 0, 0]])
        self.y = g @ self.y + h * np.array([a[0], 0.0, a[1], 0.0])
        self.q = g @ self.q @ g.T + np.diag([0.01, 1e-6, 0.01, 1e-6]) * h

    def heading(self, course: float, variance: float) -> None:
        self.x, self.p = update(self.x, self.p, np.array([[1.0, 0.0]]), np.array([course]), np.array([[variance]]))

    def velocity(self, speed: float, course: float) -> None:
        beta = course - self.x[0]
        by_angle = speed**2 * (COURSE_NOISE**2 + self.p[0, 0])
        variances = [
            np.cos(beta) ** 2 * SPEED_NOISE**2 + np.sin(beta) ** 2 * by_angle,
            np.sin(beta) ** 2 * SPEED_NOISE**2 + np.cos(beta) ** 2 * by_angle,
        ]
        h = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
        measured = speed * np.array([np.cos(beta), np.sin(beta)])
        self.y, self.q = update(self.y, self.q, h, measured, np.diag(variances))


def update(x: Array, p: Array, h: Array, z: Array, r: Array) -> tuple[Array, Array]:
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    return x + gain @ (z - h @ x), (np.eye(len(x)) - gain @ h) @ p


def test_the_dual_filter_equals_its_equations_written_out() -> None:
    random, ours, theirs = np.random.default_rng(0), dual(), WrittenOut()
    assert ours.input_names == ("yaw_rate", "acceleration_x", "acceleration_y")
    for i in range(1, 501):
        r, ax, ay = 0.2 * np.sin(0.01 * i), np.cos(0.01 * i), random.normal()
        ours.inputs[:] = r, ax, ay
        ours.predict(0.01)
        theirs.predict((ax, ay), r, 0.01)
        if i % 10 == 0:
            course = theirs.x[0] + 0.02 * random.normal()
            ours.correct(*COURSE.measured([course]))
            theirs.heading(course, COURSE.variances[0])
            speed = 10 + 0.1 * random.normal()
            ours.correct(*GNSS.measured([speed, course + 0.01]))
            theirs.velocity(speed, course + 0.01)
    found = ours.belief()
    np.testing.assert_allclose(found.mean, [*theirs.x, *theirs.y], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.covariance[:2, :2], theirs.p, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.covariance[2:, 2:], theirs.q, rtol=1e-8, atol=1e-12)
    assert not found.covariance[:2, 2:].any()


def test_names_tell_the_filter_and_sensors_are_those_from_outside() -> None:
    made = dual()
    assert made.names[:3] == ("heading.yaw", "heading.gyro_bias", "velocity.forward")
    assert made.sensors == ("course", "gnss")
    with pytest.raises(InputError, match="no sensor 'velocity'"):
        made.correct(*VELOCITY.measured([10.0, 0.0]))


def test_the_variance_of_a_passed_input_is_passed_with_it() -> None:
    class Uncertain(VelocityKkf):
        inputs = (*VelocityKkf.inputs, "yaw_rate_variance")

        def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
            across = h * ca.vertcat(x.lateral, 0, -x.forward, 0)
            return ca.diag(ca.SX(self.density) * h) + u.yaw_rate_variance * across @ across.T

    rate = PassedInput("heading", "velocity", RATE.equation, ("yaw_rate",), ("yaw_rate_variance",))
    filters = {"heading": Ekf(Dense(YawKkf(), [COURSE])), "velocity": Ekf(Dense(Uncertain(), [VELOCITY]))}
    made, known = Cascade(filters, (rate,), (OVER_GROUND,)), dual()
    made.start(START)
    for filter in (made, known):
        filter.predict(0.01)
    more = made.belief().covariance - known.belief().covariance
    expected = np.zeros((6, 6))
    expected[4, 4] = (0.01 * 10.0) ** 2 * (0.02**2 + 1e-12)
    np.testing.assert_allclose(more, expected, rtol=1e-6, atol=1e-15)


def test_memory_that_is_put_back_gives_the_same_bits() -> None:
    filter = dual()
    kept = filter.memory.copy()

    def drive() -> Array:
        for _ in range(10):
            filter.inputs[:] = 0.1, 0.2, 0.3
            filter.predict(0.01)
        filter.correct(*GNSS.measured([10.0, 0.2]))
        return filter.memory.copy()

    after = drive()
    filter.memory[:] = kept
    assert (drive() == after).all()


def test_a_cascade_is_valid_and_inflated_as_a_whole() -> None:
    filter = dual()
    assert filter.is_valid()
    before = np.diag(filter.belief().covariance)
    filter.inflate()
    np.testing.assert_allclose(filter.belief().covariance, np.diag(4 * before))
    filter.filters["velocity"].mean[0] = np.nan
    assert not filter.is_valid()


def test_a_heading_that_is_passed_on_again_and_again_weighs_as_much_as_once() -> None:
    yaw = Measurement("yaw", lambda x, z, u, p: x.yaw, (0.0,), angles=(0,))
    passed = PassedMeasurement(yaw, "heading", "copy", "yaw", lambda x, nothing: x.yaw, repeats=50)
    filters = {"heading": Ekf(Dense(YawKkf(), [COURSE])), "copy": Ekf(Dense(YawKkf(), [yaw]))}
    made = Cascade(filters, (), (passed,))
    made.start(Gaussian(np.zeros(4), np.diag([0.05, 0.02, 0.1, 0.02]) ** 2))
    for _ in range(50):
        made.correct("yaw", np.zeros(1), np.zeros(1))
    assert made.belief().covariance[2, 2] == pytest.approx(1 / (1 / 0.05**2 + 1 / 0.1**2))


@pytest.mark.parametrize(
    ("inputs", "measurements", "message"),
    [
        ((PassedInput("yaw", "velocity", RATE.equation, ("yaw_rate",)),), (), "names the filter 'yaw'"),
        ((PassedInput("heading", "velocity", RATE.equation, ("rate",)),), (), "no input 'rate'"),
        (
            (),
            (PassedMeasurement(GNSS, "heading", "velocity", "speed", OVER_GROUND.equation),),
            "no measurement 'speed'",
        ),
    ],
)
def test_a_link_to_what_is_not_there_is_named(inputs: Any, measurements: Any, message: str) -> None:
    filters = {"heading": Ekf(Dense(YawKkf(), [COURSE])), "velocity": Ekf(Dense(VelocityKkf(), [VELOCITY]))}
    with pytest.raises(InputError, match=message):
        Cascade(filters, inputs, measurements)


def test_a_sensor_with_a_link_corrects_both_filters_and_one_without_its_own_alone() -> None:
    cascade = dual()
    found = cascade.correct("gnss", np.array([10.0, 0.12]), np.array([SPEED_NOISE**2, COURSE_NOISE**2]))
    moved = cascade.belief().mean != START.mean
    assert moved[2]  # the forward velocity, by the link
    alone = dual()
    course = alone.correct("course", np.array([0.12]), np.array([COURSE_NOISE**2]))
    assert (alone.belief().mean[:2] != START.mean[:2]).any()
    np.testing.assert_array_equal(alone.belief().mean[2:], START.mean[2:])
    assert (len(found.whitened), len(course.whitened)) == (2, 1)
