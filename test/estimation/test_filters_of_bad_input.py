"""What does not fit is refused with a sentence that says what and where."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from systems import COURSE, IMU, LINEAR, SALOON, VELOCITY, Pendulum, SingleTrack, VelocityKkf, YawKkf
from vsense_ros import codegen
from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian, Measured
from vsense_ros.estimation.state_space import Measurement, StateSpace
from vsense_ros.estimation.ukf import Ukf

BUILDERS: dict[str, Callable[..., Any]] = {"extended": lambda *a: Ekf(Dense(*a)), "unscented": Ukf}
START = LINEAR["heading"].start


@pytest.fixture(params=BUILDERS)
def build(request: pytest.FixtureRequest) -> Callable[..., Any]:
    return BUILDERS[request.param]


@pytest.fixture(params=["compiled", "NumPy"])
def heading(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, build: Callable[..., Any]) -> Any:
    if request.param == "NumPy":
        monkeypatch.setenv("VSENSE_COMPILE", "0")
    elif codegen.compiler() is None:
        pytest.skip("needs a C compiler")
    filter = build(YawKkf(), [COURSE])
    filter.start(START)
    return filter


def changed(base: type[StateSpace], **methods: Any) -> StateSpace:
    return type("Changed", (base,), methods)()


@pytest.mark.parametrize(
    ("system", "measurements", "parameters", "message"),
    [
        (SingleTrack(), [IMU], {**SALOON, "mas": 1.0}, "SingleTrack has no parameter 'mas'; it has: mass, yaw_inertia"),
        (SingleTrack(), [IMU], {"mass": 1.0}, "SingleTrack needs the parameter 'yaw_inertia', which is not given"),
        (SingleTrack(), [IMU], [1.0, 2.0], "SingleTrack has 6 parameters \\(mass, .*\\), but got 2"),
        (YawKkf(), [COURSE, COURSE], {}, "two measurements called 'course'"),
        (YawKkf(), [VELOCITY], {}, "there is no state 'forward'; there are: yaw, gyro_bias"),
        (
            YawKkf(),
            [Measurement("pair", lambda x, z, u, p: [x.yaw, x.yaw], (0.1,))],
            {},
            "the measurement 'pair' of YawKkf, which has as many deviations, must be 1 numbers in a column, but is 2",
        ),
        (YawKkf(), [Measurement("none", lambda x, z, u, p: [], ())], {}, "'none' has 0 components; possible are 1 to"),
        (
            YawKkf(),
            [Measurement("angle", lambda x, z, u, p: x.yaw, (0.1,), angles=(1,))],
            {},
            "angles of the measurement 'angle' must be among its components 0 to 0",
        ),
        (
            changed(YawKkf, transition=lambda s, x, u, p, h: [x.yaw]),
            [],
            {},
            "the transition of Changed must be 2 numbers in a column, but is 1 numbers",
        ),
        (
            changed(YawKkf, noise=lambda s, x, u, p, h: [h] * 3),
            [],
            {},
            "the noise of Changed, where variances are not 2 numbers in one column, must be 2 × 2 numbers, but is 3",
        ),
        (
            changed(YawKkf, transition=lambda s, x, u, p, h: [x.yaw + h * u.rate, x.gyro_bias]),
            [],
            {},
            "there is no input 'rate'; there are: yaw_rate",
        ),
        (changed(YawKkf, names=("yaw", "yaw")), [], {}, "Changed has two states called 'yaw'"),
        (changed(YawKkf, names=()), [], {}, "Changed has no states"),
        (changed(YawKkf, largest={"roll": 1.0}), [], {}, "Changed limits 'roll', which is none of its states"),
    ],
)
def test_a_system_that_does_not_fit_itself_is_refused(
    build: Callable[..., Any], system: Any, measurements: Any, parameters: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        build(system, measurements, parameters)


def test_a_start_at_which_the_equations_are_singular_is_refused(build: Callable[..., Any]) -> None:
    filter = build(SingleTrack(), [IMU], SALOON)
    with pytest.raises(InputError, match="SingleTrack: after a step the state is not finite, at "):
        filter.start(LINEAR["single track"].start)


def test_the_message_of_a_singular_start_tells_the_inputs() -> None:
    with pytest.raises(InputError, match="yaw_rate = 0, steer_angle = 0, speed = 0"):
        Ekf(Dense(SingleTrack(), [IMU], SALOON)).start(LINEAR["single track"].start)


def test_a_jacobian_that_is_infinite_at_the_start_is_refused() -> None:
    root = Measurement("root", lambda x, z, u, p: ca.sqrt(x.angle), (0.1,))
    filter = Ekf(Dense(Pendulum(), [root], {"length": 1.0, "damping": 0.0}))
    with pytest.raises(InputError, match="the measurement 'root' or its Jacobian is not finite, at angle = 0"):
        filter.start(Gaussian(np.zeros(2), np.eye(2)))


@pytest.mark.parametrize(
    ("mean", "covariance", "message"),
    [
        (np.zeros(3), np.eye(2), "a mean of shape \\(2,\\) and a covariance of shape \\(2, 2\\), but got \\(3,\\)"),
        (np.zeros(2), np.eye(3), "but got \\(2,\\) and \\(3, 3\\)"),
        (np.array([0.0, np.nan]), np.eye(2), "must be finite"),
        (np.zeros(2), np.array([[1.0, 0.5], [0.0, 1.0]]), "must be symmetric"),
        (np.zeros(2), np.diag([1.0, -1.0]), "variances not below zero"),
    ],
)
def test_a_start_that_is_no_distribution_is_refused(heading: Any, mean: Any, covariance: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        heading.start(Gaussian(mean, covariance))


def test_a_sensor_that_is_not_there_is_named(heading: Any) -> None:
    with pytest.raises(InputError, match="the filter has no sensor 'speed'; it has: course"):
        heading.correct("speed", np.zeros(1), np.ones(1))


@pytest.mark.parametrize("size", [0, 2, 17])
def test_a_measurement_with_another_dimension_is_refused(heading: Any, size: int) -> None:
    with pytest.raises(InputError, match=f"'course' has 1 components, but got {size}"):
        heading.correct("course", np.zeros(size), np.ones(size))


def test_a_measurement_among_many_with_another_dimension_is_refused(heading: Any) -> None:
    event = Measured("course", np.zeros(2), np.ones(2), np.inf)
    with pytest.raises(InputError, match="'course' has 1 components, but got 2"):
        heading.repeat([(None, event)])


def test_variances_of_another_number_are_refused(heading: Any) -> None:
    with pytest.raises(InputError, match="'course' has 1 variances, but got 2"):
        heading.correct("course", np.zeros(1), np.ones(2))


def test_a_step_that_leads_nowhere_is_told() -> None:
    filter = Ekf(Dense(VelocityKkf(), [VELOCITY]))
    filter.start(LINEAR["velocity"].start)
    filter.inputs[0] = np.inf
    with pytest.raises(FloatingPointError, match="VelocityKkf cannot be moved"):
        filter.predict(0.01)
