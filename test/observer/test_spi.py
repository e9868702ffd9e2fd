"""State, parameter and input together: the algebra against a joint filter, the functions against differences, the UKF
against filterpy, and both against cars whose parameters are known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray
from pydantic import ValidationError

from algebra import SPEED, N, problem
from drives import feed, goes_on_as_it_did, messages, without_c
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import model_functions, sensor_functions
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.sensors import Imu
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.parameter_ekf import ParameterEkf
from vsense_ros.observer.parameter_ukf import KAPPA, ParameterUkf
from vsense_ros.observer.spi import Spi
from vsense_ros.observer.state import GAIN_COLUMNS
from vsense_ros.observer.wheel_torques import BRAKING, RELEASED
from vsense_ros.runner import Runner

Array = NDArray[np.float64]
VEHICLES = Path(__file__).parents[2] / "config/vehicles"
MASS, FRICTION = "chassis.mass", "road.friction"
BIASES = slice(49, 55)
BIAS, MOUNTED, NO_EFFECTS = np.zeros(6), Imu().mounting(), np.zeros(0)
BOTH: dict[str, dict[str, float]] = {MASS: {"deviation": 100.0}, FRICTION: {"deviation": 0.2, "lower": 0.1}}


def estimating(vehicle: Vehicle, parameters: dict[str, dict[str, float]], kind: str = "ekf") -> Vehicle:
    """A vehicle whose file declares these parameters."""
    raw = vehicle.model_dump()
    raw["observer"] |= {"parameters": parameters, "parameter_filter": kind}
    return Vehicle.model_validate(raw)


def spi_of(vehicle: Vehicle, kind: str = "ekf", parameters: dict[str, dict[str, float]] | None = None) -> Spi:
    made = Runner(estimating(vehicle, BOTH if parameters is None else parameters, kind)).filter
    assert isinstance(made, Spi)
    return made


def cornering(spi: Spi) -> Spi:
    """A filter amid a turn, linearised there."""
    spi.start_rolling(15.0)
    spi.car.mean[15], spi.car.mean[19] = -0.3, 0.4
    spi.car.mean[6:10] = 0.012, -0.012, 0.01, -0.01
    spi.inputs[:] = 0.06, 0.0, 0.0, 150.0, 150.0, 0.0
    spi.linearize()
    return spi


class TestLinearCase:
    """The algebra on a random linear model with two parameters, beside one Kalman filter of all."""

    @pytest.fixture
    def functions(self, vehicle: Vehicle) -> Any:
        made = ParameterEkf(car_of(vehicle), (0, 1), N)
        return made.predict(), made.seen("seen", Imu(), BIASES), made.learn()

    @pytest.mark.parametrize("seed", range(3))
    @pytest.mark.parametrize("drift", [0.0, 0.3])
    def test_two_coupled_filters_are_the_joint_kalman_filter(self, functions: Any, seed: int, drift: float) -> None:
        predict, seen, learn = functions
        p = problem(seed)
        random, h, decay, noise = p.random, 0.01, np.full(N - 28, 0.97), np.append(np.full(N - 28, 1e-3), np.zeros(6))
        kalman = p.build()
        effect = random.normal(size=(14, 2))
        theta, m = random.normal(size=2), np.diag([2.0, 0.5])
        s, information = np.zeros((N, 2)), np.zeros((2, 2))
        state = random.normal(size=N)
        joint, spread = np.append(state, theta), np.zeros((N + 2, N + 2))
        spread[:N, :N], spread[N:, N:] = kalman.covariance, m
        kalman.transition(h)
        kinematics = kalman.model.kinematics.results
        f = joint_transition(kalman, h, decay, effect)
        model = [kalman.model.udot, kalman.model.by_q, kalman.model.by_u, kalman.model.by_disturbances]
        unused = [np.zeros(k) for k in (14, 14, 14, 7, 6, int(seen.size1_in(5)))]
        for _ in range(4):
            state = f[:N] @ np.append(state, theta)
            kalman.propagate(h, decay, noise)
            s, m, added = (
                np.array(r)
                for r in predict(
                    s, m, effect, np.full(2, drift), kalman.gain.T, *kinematics[:3], kalman.model.road_map.T, h, decay
                )
            )
            kalman.covariance += added @ added.T
            joint = f @ joint
            spread = f @ spread @ f.T
            spread[range(28, N), range(28, N)] += noise[: N - 28]
            for lever, turned, turning in zip(kalman.model.levers, (31, 32), (29, 28), strict=True):
                spread[[turned, turning], [turning, turned]] += lever * noise[turning - 28]
            for i, (rate, changing, _) in enumerate(kalman.model.roughness):
                spread[44 + i, 44 + i] += changing * (1 - 1 / (1 + h * SPEED * rate) ** 2)
            spread[range(N, N + 2), range(N, N + 2)] += drift * h

            sensed = p.sensed()
            jacobian = p.jacobian(sensed)
            variance = random.uniform(0.1, 2.0, 6) * np.diag(jacobian @ kalman.covariance @ jacobian.T)
            direct = sensed[3] @ effect
            value = random.normal(size=6) * 3
            value[seed] = np.nan
            sensed[0][:, 0] = jacobian @ state + direct @ theta
            kalman.correct(sensed, True, BIASES, value, variance, 1.0, np.inf)
            found = variance, kalman.whitened[:6], kalman.factor[:36].reshape(6, 6).T
            told = seen(*unused, *model, s, m, NO_EFFECTS, effect, BIAS, MOUNTED, *found, *sensed[1:])
            of, g, right, d = (np.array(r) for r in told)
            new, m, s, information, change, _ = (
                np.array(r)
                for r in learn(
                    *unused, *model, s, m, NO_EFFECTS, effect, of @ kalman.covariance, g, right, d,
                    information, theta, np.full(2, -1e9), np.full(2, 1e9),
                )
            )  # fmt: skip
            state = state + kalman.error + change[:, 0]
            theta = new[:, 0]

            here = np.isfinite(value)
            whole = np.hstack([jacobian, direct])[here]
            gain = spread @ whole.T @ np.linalg.inv(whole @ spread @ whole.T + np.diag(variance[here]))
            joint = joint + gain @ (value[here] - whole @ joint)
            spread = spread - gain @ whole @ spread

        np.testing.assert_allclose(np.append(state, theta), joint, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(m, spread[N:, N:], rtol=1e-8)
        scale = np.sqrt(np.diag(spread)[:N])
        both = kalman.covariance + s @ m @ s.T
        assert np.abs((both - spread[:N, :N]) / np.outer(scale, scale)).max() < 1e-8
        assert np.abs((s @ m - spread[:N, N:]) / np.outer(scale, np.sqrt(np.diag(m)))).max() < 1e-8

    def test_without_drift_the_information_is_what_the_covariance_gained(self, vehicle: Vehicle) -> None:
        spi = cornering(spi_of(vehicle))
        prior = np.linalg.inv(spi.parameter_covariance)
        for _ in range(50):
            spi.predict(0.004)
            spi.correct("imu", np.array([0.0, 0.0, 0.4, 0.3, 5.0, 9.8]), np.full(6, 1e-2), np.inf)
        gained = np.linalg.inv(spi.parameter_covariance) - prior
        np.testing.assert_allclose(spi.information, gained, rtol=1e-6)


def joint_transition(kalman: Any, h: float, decay: Array, effect: Array) -> Array:
    """(n + 2, n + 2) transition of state and parameters, from the blocks that the errorEKF has."""
    f = np.eye(N + 2)
    f[14:28, :] = 0.0
    f[14:28, GAIN_COLUMNS] = kalman.gain
    f[14:28, N:] = kalman.gain[:, 21:35] @ effect
    velocities = f[14:28].copy()
    by_angles, by_velocity, by_road, _, road_by_velocity, road_by_road = kalman.model.kinematics.results
    f[:6, 3:6] += h * by_angles
    f[:6, 42:46] += h * by_road
    f[:6] += h * by_velocity @ velocities[:6]
    f[6:14] += h * velocities[6:]
    for i, state in enumerate((42, 43, 46)):
        f[state] += h * road_by_velocity[i] @ velocities[:6]
        f[state, 42:46] += h * road_by_road[i]
    for i, (rate, _, back) in enumerate(kalman.model.roughness):
        kept = 1 / (1 + h * SPEED * rate)
        f[44 + i, 44 + i], f[44 + i, 42 + i] = kept, -kept * h * SPEED * back
    f[28:N] *= decay[:, None]
    return f


FIVE = (MASS, FRICTION, "chassis.cog_to_front_axle", "chassis.yaw_inertia", "rear.tyre.lateral.nominal.initial_slope")


@pytest.mark.usefixtures("parameters_uncompiled")
@pytest.mark.exam
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_effect_of_parameters_is_the_difference_that_they_make(vehicle: Vehicle, kind: str) -> None:
    values = {name: vehicle.values()[name] for name in FIVE}
    spi = cornering(spi_of(vehicle, kind, {name: {"deviation": 1e-3 * value} for name, value in values.items()}))
    accelerations = model_functions(car_of(vehicle))["dynamics"]
    q, u, force, around = (spi.car.mean[s] for s in (slice(0, 14), slice(14, 28), slice(28, 42), slice(42, 49)))

    def at(name: str, changed: float) -> Array:
        parameters = vehicle.with_parameters({name: changed}).parameter_vector()
        return np.array(accelerations(q, u, force, around, spi.inputs, parameters, NO_EFFECTS)[0])[:, 0]

    for i, (name, value) in enumerate(values.items()):
        step = 1e-4 * value
        expected = (at(name, value + step) - at(name, value - step)) / (2 * step)
        found = spi._effect.results[0][:, i]
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


@pytest.mark.usefixtures("parameters_uncompiled")
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize(("name", "step"), [(MASS, 1e-2), (FRICTION, 1e-5), ("chassis.cog_to_front_axle", 1e-5)])
def test_the_sensitivity_of_the_state_is_what_another_parameter_makes_of_it(
    vehicle: Vehicle, name: str, step: float, kind: str
) -> None:
    """Two filters, one of which measures what it expects: so nothing but the parameter makes a difference."""
    value = vehicle.values()[name]
    parameters = {name: {"deviation": 1e-6 * value}}
    one = cornering(spi_of(vehicle, kind, parameters))
    other = cornering(spi_of(vehicle.with_parameters({name: value + step}), kind, parameters))
    for _ in range(20):
        for spi in (one, other):
            spi.predict(0.004)
    for sensor in ("imu", "wheel_speeds"):
        variance = one.car.sensor_list[one.sensors.index(sensor)].deviations() ** 2
        measured = -one.car.sense(sensor, np.zeros(len(variance)))[0]
        for spi in (one, other):
            spi.correct(sensor, measured, variance, np.inf)
    difference = (other.car.mean - one.car.mean)[14:20] / step
    np.testing.assert_allclose(one.sensitivity[14:20, 0], difference, atol=0.03 * np.abs(difference).max())


def test_sigma_points_and_weights_are_those_of_julier(vehicle: Vehicle) -> None:
    made = ParameterUkf(car_of(vehicle), (0, 1), N)
    covariance = np.array([[4.0, 1.0], [1.0, 3.0]])
    m = ca.SX.sym("m", 2, 2)
    points = np.array(ca.Function("points", [m], [ca.densify(made.points(m))])(covariance)).T
    julier = JulierSigmaPoints(2, kappa=KAPPA)
    expected = julier.sigma_points(np.zeros(2), covariance)
    assert {tuple(p.round(12) + 0.0) for p in points} == {tuple(p.round(12) + 0.0) for p in expected}
    np.testing.assert_allclose(sorted(made.weights), sorted(julier.Wm), rtol=1e-14)


@pytest.mark.usefixtures("parameters_uncompiled")
def test_where_the_state_is_known_the_ukf_corrects_as_filterpy_does(vehicle: Vehicle) -> None:
    spi = cornering(spi_of(vehicle, "ukf"))
    spi.covariance[:] = 0.0
    prior = spi.parameter_covariance.copy()
    start = spi.values.copy()
    car = car_of(vehicle)
    dynamics = model_functions(car)["dynamics"]
    columns = [car.parameter_names.index(name) for name in (MASS, FRICTION)]
    state = spi.car.mean.copy()
    function = sensor_functions(car, spi.car.sensor_list)["imu"]

    def measured(theta: Array) -> Array:
        parameters = vehicle.parameter_vector()
        parameters[columns] = theta
        udot = dynamics(state[:14], state[14:28], state[28:42], state[42:49], spi.inputs, parameters, NO_EFFECTS)[0]
        mounting = vehicle.sensors["imu"].mounting()
        return np.array(function(state[:14], state[14:28], udot, state[42:49], spi.inputs, np.zeros(6), mounting)[0])[
            :, 0
        ]

    value, variance = measured(np.array([640.0, 0.85])), np.array([1e-6, 1e-6, 1e-6, 0.2, 0.2, 0.2])
    oracle = UnscentedKalmanFilter(2, 6, 1.0, measured, lambda x, _: x, JulierSigmaPoints(2, kappa=KAPPA))
    oracle.x, oracle.P, oracle.R, oracle.Q = start, prior.copy(), np.diag(variance), np.zeros((2, 2))
    oracle.predict()
    oracle.update(value)
    spi.correct("imu", value, variance, np.inf)
    np.testing.assert_allclose(spi.values, oracle.x, rtol=1e-9)
    np.testing.assert_allclose(spi.parameter_covariance, oracle.P, rtol=1e-6)


@pytest.mark.usefixtures("parameters_uncompiled")
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_parameter_never_leaves_its_bounds(vehicle: Vehicle, kind: str) -> None:
    spi = cornering(spi_of(vehicle, kind, {MASS: {"deviation": 100.0, "lower": 690.0, "upper": 710.0}}))
    for sign in (1, -1):
        for _ in range(200):
            spi.predict(0.004)
            spi.correct("imu", np.array([0.0, 0.0, 0.4, sign * 3.0, 5.0, 9.8]), np.full(6, 1e-3), np.inf)
            assert 690.0 <= spi.values[0] <= 710.0
            assert spi.car.parameters[spi._columns][0] == spi.values[0]


@pytest.mark.usefixtures("parameters_uncompiled")
def test_a_parameter_at_its_bound_is_a_warning(vehicle: Vehicle) -> None:
    observer = Runner(estimating(vehicle, {MASS: {"deviation": 10.0, "upper": 710.0}}))
    spi = observer.filter
    assert isinstance(spi, Spi)
    spi.start_rolling(10.0)

    def said() -> tuple[str, str]:
        diagnostic = next(d for d in observer.diagnostics() if d.name == "parameters")
        return diagnostic.level.name, diagnostic.message

    assert said()[0] == "OK"
    assert observer.adapter.doubts == []
    spi.values[:] = 710.0
    assert observer.adapter.doubts == ["a number of the car is at its bound: chassis.mass = 710"]  # of the headline
    assert said() == (
        "WARN",
        "at its bound: chassis.mass = 710; something else differs; determined so far: nothing; not yet: chassis.mass",
    )


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_filter_that_is_put_back_goes_on_as_it_did(vehicle: Vehicle, kind: str) -> None:
    goes_on_as_it_did(cornering(spi_of(vehicle, kind)), steps=10)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_where_brakes_begin_to_act_a_filter_without_c_does_what_c_does(vehicle: Vehicle, kind: str) -> None:
    """Below 1 m/s brakes may hold the car: torque errors of wheels that are not driven then last longer."""
    both = spi_of(vehicle, kind), spi_of(vehicle, kind)
    without_c(both[1])
    brakes = []
    for spi in both:
        spi.start_rolling(1.02)
        spi.inputs[:] = 0.1, 0.0, 0.0, -150.0, -150.0, 0.0
        spi.linearize()
        for _ in range(20):
            brakes.append(spi.car.brakes)
            spi.correct("imu", np.array([0.0, 0.0, 0.04, -1.0, 0.1, 9.8]), np.full(6, 1e-2), np.inf)
            spi.predict(0.004)
    assert set(brakes[:20]) == {RELEASED, BRAKING}
    in_c, in_python = (spi.belief() for spi in both)
    np.testing.assert_allclose(in_python.mean, in_c.mean, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(in_python.covariance, in_c.covariance, rtol=1e-7, atol=1e-9)


def test_parameters_are_published_with_their_deviations_and_the_diagnostics_tell_what_is_known(
    lane_change: Any, vehicle: Vehicle
) -> None:
    observer = feed(Runner(estimating(vehicle, BOTH)), messages(lane_change, until=3.0))
    sample = next(s for s in observer.estimate() if s.topic == "vsense/parameters")
    known = dict(zip(sample.names, sample.values["velocity"], strict=True))
    assert 0 < known[MASS] < 100
    assert 0 < known[FRICTION] <= 0.2
    diagnostic = next(d for d in observer.diagnostics() if d.name == "parameters")
    assert MASS in diagnostic.values
    assert "of 2" in diagnostic.values["independent combinations determined"]
    assert MASS in diagnostic.message


class TestRefusals:
    def test_in_a_vehicle_file_the_line_is_named(self, tmp_path: Path) -> None:
        text = (VEHICLES / "prototype_model.yaml").read_text(encoding="utf-8")
        lines = text.replace(
            "observer:", "observer:\n  parameters:\n    chassis.weight: {deviation: 10.0}"
        ).splitlines()
        path = tmp_path / "car.yaml"
        path.write_text("\n".join(lines), encoding="utf-8")
        number = lines.index("  parameters:") + 1
        with pytest.raises(InputError, match=rf"car\.yaml:{number}: observer\.parameters: .*chassis\.weight"):
            load_vehicle(path)

    def test_a_name_that_the_vehicle_file_does_not_know(self, vehicle: Vehicle) -> None:
        with pytest.raises(
            ValidationError, match=r"has chassis\.weight, which is no number below physics; nearest .*chassis"
        ):
            estimating(vehicle, {"chassis.weight": {"deviation": 10.0}})

    def test_bounds_in_the_wrong_order(self) -> None:
        with pytest.raises(ValidationError, match="lower 2 must be less than upper 1"):
            EstimatedParameter(deviation=0.1, lower=2.0, upper=1.0)

    def test_a_value_outside_its_bounds(self, vehicle: Vehicle) -> None:
        with pytest.raises(ValidationError, match=r"bounds road\.friction by 0.1 and 0.9, but in the file it is 1"):
            estimating(vehicle, {FRICTION: {"deviation": 0.1, "lower": 0.1, "upper": 0.9}})

    def test_a_bound_that_no_car_can_have(self, vehicle: Vehicle) -> None:
        with pytest.raises(ValidationError, match=r"bounds chassis\.mass by 100, which cannot be: hubs and wheels"):
            estimating(vehicle, {MASS: {"deviation": 50.0, "lower": 100.0}})

    @pytest.mark.usefixtures("parameters_uncompiled")
    @pytest.mark.parametrize("kind", ["ekf", "ukf"])
    def test_a_parameter_without_effect_on_anything_that_is_measured(self, vehicle: Vehicle, kind: str) -> None:
        with pytest.raises(InputError, match=r"steering\.ratio cannot be estimated: it changes nothing"):
            Runner(estimating(vehicle, {"steering.ratio": {"deviation": 1.0}}, kind))
