"""The likelihood of a drive, and what is likeliest, against closed forms and cars whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal

from vsense_ros.estimation.state_space import Named
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.identification import handling_identifier
from vsense_ros.identification.likelihood import Likelihood
from vsense_ros.identification.recorded import left_by, low_passed
from vsense_ros.identification.rinsing import Drive, Identifier, Noise
from vsense_ros.identification.sensor_errors import TIME_CONSTANTS, WithSensorErrors
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.single_track import SingleTrack

H = 0.05


class FirstOrder:
    """ẋ = b u - a x, y = x."""

    states: tuple[str, ...] = ("x",)
    inputs: tuple[str, ...] = ("u",)
    outputs: tuple[str, ...] = ("y",)
    parameters: tuple[str, ...] = ("a", "b")

    def rates(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [p.b * u.u - p.a * x.x]

    def measured(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [x.x]


def first_order(density: float = 0.3, output: float = 0.2, start: float = 0.5) -> Identifier:
    noise = Noise((output,), (start,), {"x": density})
    return Identifier(FirstOrder(), {"a": 1.0, "b": 2.0}, ("a", "b"), noise)


def recorded(
    count: int, a: float, b: float, seed: int, density: float = 0.3, output: float = 0.2, start: float = 0.5
) -> Drive:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(count // 10 + 1), 10)[:count, None]
    x, outputs = start * rng.standard_normal(), np.empty((count, 1))
    decay = np.exp(-a * H)
    for k in range(count):
        outputs[k] = x + output * rng.standard_normal()
        x = decay * x + b / a * (1 - decay) * between(u, k) + density * np.sqrt(H) * rng.standard_normal()
    return Drive("drive", H, u, outputs, np.zeros(1))


def between(u: np.ndarray, k: int) -> float:
    """Value of an input that changes linearly from sample to sample, in the step after one of them."""
    return float(u[k : k + 2].mean())


def by_one_large_gaussian(drive: Drive, a: float, b: float, density: float, output: float, start: float) -> float:
    """All outputs at once: their mean and covariance (N, N), without the constant."""
    n = len(drive.outputs)
    decay = np.exp(-a * H)
    mean, covariance, x, spread = np.empty(n), np.empty((n, n)), 0.0, start**2
    for k in range(n):
        mean[k] = x
        powers = decay ** np.arange(n - k)
        covariance[k, k:] = covariance[k:, k] = spread * powers
        x = decay * x + b / a * (1 - decay) * between(drive.inputs, k)
        spread = decay**2 * spread + density**2 * H
    covariance += output**2 * np.eye(n)
    return float(multivariate_normal(mean, covariance).logpdf(drive.outputs[:, 0])) + 0.5 * n * np.log(2 * np.pi)


@pytest.mark.parametrize("factors", [(0.0, 0.0), (0.4, -0.3)])
def test_the_likelihood_is_that_of_all_outputs_as_one_gaussian(factors: tuple[float, float]) -> None:
    drive = recorded(60, 1.3, 1.7, 1)
    found = Likelihood(first_order()).value([drive], np.array([0.9, 2.2]), np.array(factors))
    density, output = 0.3 * np.exp(factors[0]), 0.2 * np.exp(factors[1])
    # Steps are of third order.
    assert found == pytest.approx(by_one_large_gaussian(drive, 0.9, 2.2, density, output, 0.5), abs=1e-3)


def test_slopes_are_what_small_changes_make() -> None:
    drives = [recorded(200, 1.3, 1.7, 1), recorded(150, 1.3, 1.7, 2)]
    exact, prior = Likelihood(first_order()), np.array([0.5, 1.0])
    values, step = np.array([0.9, 2.2]), 1e-4
    slopes = exact.scores(drives, values, prior)[0].sum(axis=0)
    for i in range(4):
        move = step * np.eye(4)[i]
        ends = [exact.value(drives, values + s * prior * move[:2], s * move[2:]) for s in (1, -1)]
        assert slopes[i] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.02, abs=0.05)


def test_information_is_the_covariance_of_slopes_at_the_truth() -> None:
    """Fisher's identity, over many drives."""
    exact, prior, truth = Likelihood(first_order()), np.array([0.5, 1.0]), np.array([1.3, 1.7])
    slopes, told = [], []
    for seed in range(150):
        one, information = exact.scores([recorded(100, *truth, seed)], truth, prior)
        slopes.append(one.sum(axis=0))
        told.append(information)
    mean = np.mean(told, axis=0)
    ratio = np.array(slopes).var(axis=0) / mean.diagonal()
    assert np.all((ratio > 0.7) & (ratio < 1.4))
    assert np.abs(np.mean(slopes, axis=0) / np.sqrt(mean.diagonal() / 150)).max() < 4.0


def test_the_likeliest_are_the_truth_within_their_intervals_and_the_noise_is_found_beside() -> None:
    errors, noise = [], []
    for seed in range(12):
        drive = recorded(1200, 1.3, 1.7, seed, density=0.6, output=0.1)
        exact = Likelihood(first_order())  # which takes the disturbance for half, the sensor for twice as noisy
        found, way = exact.weigh([drive], np.array([1.0, 2.0]), np.array([1.0, 2.0]), np.array([0.5, 1.0]))
        assert way.settled
        errors.append((found.values - [1.3, 1.7]) / found.deviations)
        noise.append(np.exp(exact.factors))
    assert np.sqrt(np.mean(np.square(errors))) < 1.4
    assert np.mean(noise, axis=0) == pytest.approx([2.0, 0.5], rel=0.15)


def test_intervals_hold_the_mean_of_a_car_that_changes_where_those_of_a_right_model_would_not() -> None:
    """As no model is right: a pole that is another in each part of the drive."""
    errors, unaware, start = [], [], np.array([1.3, 1.7])
    for seed in range(20):
        rng = np.random.default_rng(seed)
        poles = rng.normal(1.3, 0.4, 20)
        parts = [recorded(100, pole, 1.7, 100 * seed + i) for i, pole in enumerate(poles)]
        inputs, outputs = (np.concatenate([getattr(p, name) for p in parts]) for name in ("inputs", "outputs"))
        drive = replace(parts[0], inputs=inputs, outputs=outputs)
        found = Likelihood(first_order()).weigh([drive], start, start, np.array([1.0, 1.0]))[0]
        right = replace(found, pieces=None, scaled=found.scaled * found.disagreement)
        errors.append((found.values[0] - 1.3) / found.deviations[0])
        unaware.append((found.values[0] - 1.3) / right.deviations[0])
    assert np.sqrt(np.mean(np.square(errors))) < 1.5
    assert np.sqrt(np.mean(np.square(unaware))) > 1.3 * np.sqrt(np.mean(np.square(errors)))


# The single track, and what disturbs it

CAR = {
    "front_weight": 8000.0, "rear_weight": 7000.0, "wheelbase": 2.7, "friction": 1.0, "yaw_inertia": 2500.0,
    "relaxation_length": 0.6, "roll_gradient": 0.006,
    **{f"{axle}_{name}": value for axle in ("front", "rear") for name, value in
       {"stiffness": 6e4, "peak": 1.0, "shape": 1.4, "curvature": 0.3, "longitudinal_ratio": 1.0}.items()},
}  # fmt: skip


def of_car(model: Any, states: dict[str, float], inputs: dict[str, float], **changed: float) -> dict[str, float]:
    """Rates of a model by state."""
    known = CAR | {"steering_gain": 1.0, "steering_offset": 0.0, "steering_delay": 0.0} | changed
    x = Named(np.array([states.get(name, 0.0) for name in model.states]), model.states, "state")
    u = Named(np.array([inputs.get(name, 0.0) for name in model.inputs]), model.inputs, "input")
    p = Named(np.array([known[name] for name in model.parameters]), model.parameters, "parameter")
    return {name: float(rate) for name, rate in zip(model.states, model.rates(x, u, p), strict=True)}


def test_a_tyre_has_63_percent_of_its_force_after_its_relaxation_length() -> None:
    model, inputs = SingleTrack(), {"steering": 0.01, "speed": 20.0}
    steady = of_car(model, {}, inputs)["front_force"] * CAR["relaxation_length"] / 20.0
    course = solve_ivp(
        lambda _, f: of_car(model, {"front_force": f[0]}, inputs)["front_force"], (0, 0.6 / 20), [0.0], rtol=1e-8
    )
    assert course.y[0, -1] / steady == pytest.approx(1 - np.exp(-1), rel=1e-5)


def test_on_a_bank_a_car_slides_down_and_its_accelerometer_feels_the_tyres_alone() -> None:
    model = WithSensorErrors(SingleTrack())
    rates = of_car(model, {"bank": 0.5}, {"speed": 20.0})
    assert rates["lateral_velocity"] == pytest.approx(-0.5)
    x = Named(np.array([0.5 if n == "bank" else 0.0 for n in model.states]), model.states, "state")
    u = Named(np.array([0.0, 20.0, 0.0]), model.inputs, "input")
    known = CAR | {"steering_gain": 1.0, "steering_offset": 0.0, "steering_delay": 0.0}
    p = Named(np.array([known[name] for name in model.parameters]), model.parameters, "parameter")
    assert np.array(model.measured(x, u, p), dtype=float) == pytest.approx(0.0, abs=1e-12)


def test_what_wanders_goes_back_to_zero_and_offsets_stay() -> None:
    rates = of_car(WithSensorErrors(SingleTrack()), {"bank": 1.0, "yaw_rate_offset": 1.0}, {"speed": 20.0})
    assert rates["bank"] == pytest.approx(-1.0 / TIME_CONSTANTS["bank"])
    assert rates["yaw_rate_offset"] == 0.0


def test_without_errors_it_is_the_model_itself() -> None:
    model, states = SingleTrack(), {"lateral_velocity": 0.3, "yaw_rate": 0.2, "front_force": 900.0, "rear_force": 700.0}
    inputs = {"steering": 0.03, "speed": 18.0}
    alone, whole = of_car(model, states, inputs), of_car(WithSensorErrors(model), states, inputs)
    assert {name: whole[name] for name in model.states} == pytest.approx(alone)


def test_a_linear_car_in_a_steady_bend_has_the_yaw_gain_of_the_textbook() -> None:
    """r/δ = v / (l + K v²), K = m (l_r c_r - l_f c_f) / (l c_f c_r), in small angles (Gillespie 1992, eq. 6-16)."""
    model = SingleTrack()
    v, steering = 20.0, 1e-4
    stiffness = {axle: CAR[f"{axle}_stiffness"] * 2 for axle in ("front", "rear")}
    states = np.zeros(4)

    def rates(x: np.ndarray) -> np.ndarray:
        found = of_car(model, dict(zip(model.states, x, strict=True)), {"steering": steering, "speed": v})
        return np.array([found[name] for name in model.states])

    scale = np.array([1.0, 1.0, 1e4, 1e4])
    jacobian = np.column_stack([(rates(1e-6 * scale * e) - rates(-1e-6 * scale * e)) / 2e-6 for e in np.eye(4)])
    states = scale * np.linalg.solve(jacobian, -rates(states))
    assert np.all(np.linalg.eigvals(jacobian / scale[:, None]).real < 0)
    gradient = (CAR["front_weight"] / stiffness["front"] - CAR["rear_weight"] / stiffness["rear"]) / GRAVITY
    assert states[1] / steering == pytest.approx(v / (CAR["wheelbase"] + gradient * v**2), rel=0.01)


def driven(seconds: float, seed: int, delay: float = 0.0) -> Drive:
    """The car by another integrator, with noise, through bends and quick steering."""
    model, h = SingleTrack(), 0.01
    t = np.arange(0, seconds, h)

    def steering(time: Any) -> Any:
        return 0.02 * np.sin(0.9 * time) + 0.015 * np.sin(2.3 * time + 1) + 0.01 * np.sin(5 * time)

    def rates(time: float, x: np.ndarray) -> list[float]:
        states = dict(zip(model.states, x, strict=True))
        found = of_car(model, states, {"steering": float(steering(time)), "speed": 20.0})
        return [found[name] for name in model.states]

    course = solve_ivp(rates, (0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-8, atol=1e-8).y
    mass = (CAR["front_weight"] + CAR["rear_weight"]) / GRAVITY
    force = (course[2] + course[3]) / mass * (1 + GRAVITY * CAR["roll_gradient"])
    rng = np.random.default_rng(seed)
    outputs = np.column_stack([force, course[1]]) + rng.standard_normal((len(t), 2)) * [0.05, 0.002]
    inputs = np.column_stack([steering(t - delay), np.full(len(t), 20.0)])
    cut_off, every = 5.0, 10
    smooth = low_passed(outputs, h, cut_off)
    noise = tuple(left_by(cut_off, outputs - smooth))
    return Drive("drive", h, inputs, smooth, np.zeros(4), 0.0, every, noise)


@pytest.mark.exam
@pytest.mark.parametrize("delay", [0.0, 0.03])
def test_a_car_whose_steering_comes_late_is_identified_with_its_delay(delay: float) -> None:
    vehicle = load_vehicle(vehicle_path("jaguar_saloon"))
    drive = driven(60.0, 1, delay)
    one, prior = handling_identifier(vehicle, "single_track", (), [drive])
    one.values.update({name: CAR[name] for name in ("front_weight", "rear_weight", "wheelbase")})
    whole = one.model
    assert isinstance(whole, WithSensorErrors)
    found, _ = Likelihood(one).weigh([whole.drive(drive)], one.begin(), one.begin(), prior)
    values = dict(zip(found.names, found.values, strict=True))
    deviations = dict(zip(found.names, found.deviations, strict=True))
    assert values["steering_delay"] == pytest.approx(delay, abs=0.006)
    for axle in ("front", "rear"):
        product = values[f"{axle}_stiffness"] * values[f"{axle}_peak"]
        assert product == pytest.approx(6e4, rel=0.06)
    assert abs(values["yaw_inertia"] - CAR["yaw_inertia"]) < 3.5 * deviations["yaw_inertia"] + 50
