"""Noise covariances found by likelihood: of a linear system against its dense density, of the car against the noise
that was put into its recording."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.estimation.innovations import Innovations
from vsense_ros.evaluate.consistency import consistency, lag_1
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification import noise
from vsense_ros.identification.free_parameter import FreeParameter, multiplied
from vsense_ros.identification.noise import NOISE, maximise, noise_numbers, with_own_noise
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.innovations import innovations

Array = NDArray[np.float64]
COUNT = 200
STARTS = np.array([0.3, 0.5])  # standard deviations of the steps and of the measurements, as believed at first


def free(count: int) -> list[FreeParameter]:
    """Logarithms of standard deviations."""
    names = [f"deviation {i}" for i in range(count)]
    return [FreeParameter(name, "-", NOISE.prior, -NOISE.bound, NOISE.bound, multiplied({name: 1.0})) for name in names]


@pytest.fixture(scope="module")
def walk() -> Array:
    """Measurements of a random walk: steps of 0.1, noise of 1.0."""
    random = np.random.default_rng(5)
    return np.cumsum(random.normal(0, 0.1, COUNT)) + random.normal(0, 1.0, COUNT)


def filtered(measured: Array, steps: Array, limit: float = np.inf) -> Innovations:
    """The Kalman filter of a random walk that begins at 0."""
    step, noise = STARTS * np.exp(steps)
    state, variance, rows = 0.0, 0.0, []
    for value in measured:
        variance += step**2
        total = variance + noise**2
        innovation = value - state
        used = innovation**2 <= limit * total
        rows.append((innovation / total**0.5, total**0.5, used))
        if used:
            state += variance / total * innovation
            variance *= noise**2 / total
    whitened, deviation, used = np.array(rows).T
    return Innovations(whitened[:, None], deviation[:, None], used.astype(bool), np.arange(len(measured)))


def dense(measured: Array, steps: Array) -> float:
    """Log density of all measurements together."""
    step, noise = STARTS * np.exp(steps)
    order = np.arange(1, len(measured) + 1)
    covariance = step**2 * np.minimum.outer(order, order) + noise**2 * np.eye(len(measured))
    return float(multivariate_normal(np.zeros(len(measured)), covariance).logpdf(measured))


@pytest.mark.parametrize("steps", [(0.0, 0.0), (-1.0, 0.7)])
def test_the_densities_of_the_innovations_multiply_to_that_of_all_measurements(walk: Array, steps):
    found = filtered(walk, np.array(steps)).log_density().sum()
    assert found == pytest.approx(dense(walk, np.array(steps)), rel=1e-9)


def test_the_optimum_and_its_deviations_are_those_of_the_dense_density(walk: Array, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(noise, "NOISE", replace(noise.NOISE, least_gain=1e-3))

    def evaluate(points: Sequence[Array], _) -> list[list[Innovations]]:
        return [[filtered(walk, point)] for point in points]

    def cost(point: Array) -> float:
        return -dense(walk, point) + 0.5 * float(point @ point) / NOISE.prior**2

    found, deviation, _ = maximise(evaluate, free(2))
    best = minimize(cost, np.zeros(2), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.01}).x
    assert np.all(np.abs(found - best) < 0.2 * deviation)
    near = 0.3
    for i, unit in enumerate(near * np.eye(2)):
        curvature = (cost(best + unit) - 2 * cost(best) + cost(best - unit)) / near**2
        others = deviation[i] ** -2  # of the inverse of the information, which cannot be more than its diagonal
        assert 0.6 * others < curvature < 2.5 * others
    assert np.all(np.abs(np.log(STARTS * np.exp(found) / (0.1, 1.0))) < 3 * deviation)


def test_a_number_that_the_measurements_say_nothing_about_stays(walk: Array):
    def evaluate(points: Sequence[Array], _) -> list[list[Innovations]]:
        return [[filtered(walk, point[:2])] for point in points]

    found, deviation, _ = maximise(evaluate, free(3))
    assert found[2] == 0.0
    assert deviation[2] == pytest.approx(NOISE.prior)


def test_a_filter_that_did_not_judge_some_messages_is_compared_by_the_others(walk: Array):
    """An observer that starts anew with other noise levels has no innovations meanwhile."""

    def evaluate(points: Sequence[Array], _) -> list[list[Innovations]]:
        found = []
        for point in points:
            of = filtered(walk, point)
            judged = np.ones(COUNT, bool)
            if point.any():
                judged[COUNT // 2 : COUNT // 2 + 50] = False
            found.append([Innovations(of.whitened[judged], of.deviation[judged], of.used[judged], of.stamp[judged])])
        return found

    found, *_ = maximise(evaluate, free(2))
    whole, deviation, _ = maximise(lambda points, _: [[filtered(walk, point)] for point in points], free(2))
    assert np.all(np.abs(found - whole) < deviation)


def test_messages_without_an_innovation_are_told(walk: Array):
    known = filtered(walk, np.zeros(2))
    part = Innovations(known.whitened[::2], known.deviation[::2], known.used[::2], known.stamp[::2])
    found = part.at(known.stamp)
    assert found.there.tolist() == [i % 2 == 0 for i in range(COUNT)]
    assert not found.used[1::2].any()
    assert np.array_equal(found.whitened[::2], part.whitened)
    assert known.at(known.stamp) is known


def test_outliers_that_the_gate_refuses_do_not_become_noise(walk: Array):
    wild = walk.copy()
    wild[::25] += 30.0

    def evaluate(points: Sequence[Array], _) -> list[list[Innovations]]:
        return [[filtered(wild, point, limit=36.0)] for point in points]

    found, *_ = maximise(evaluate, free(2))
    last = filtered(wild, found, limit=36.0)
    assert (~last.used).sum() == COUNT // 25
    assert STARTS[1] * np.exp(found[1]) == pytest.approx(1.0, rel=0.15)


def test_a_gate_that_refuses_much_is_taken_for_a_wrong_file(walk: Array):
    def evaluate(points: Sequence[Array], _) -> list[list[Innovations]]:
        return [[filtered(walk, point, limit=4.0)] for point in points]

    assert filtered(walk, np.zeros(2), limit=4.0).used.mean() < 0.9
    found, *_ = maximise(evaluate, free(2))
    assert STARTS[1] * np.exp(found[1]) == pytest.approx(1.0, rel=0.15)


def test_white_innovations_pass_as_consistent_and_others_do_not():
    random = np.random.default_rng(0)
    white = random.normal(size=(4000, 3))
    ones, used = np.ones_like(white), np.ones(len(white), dtype=bool)
    good = consistency([Innovations(white, ones, used, np.arange(len(used)))], [used])
    assert good.nis_interval[0] < good.nis < good.nis_interval[1]
    assert abs(good.lag_1) < 1.5 * good.lag_1_bound  # the largest of three
    assert good.log_likelihood == pytest.approx(
        float(np.mean(-0.5 * np.sum(white**2, axis=1))) - 1.5 * np.log(2 * np.pi)
    )
    smooth = white[1:] + 0.5 * white[:-1]
    bad = consistency([Innovations(smooth, ones[1:], used[1:], np.arange(len(used) - 1))], [used[1:]])
    assert bad.nis > bad.nis_interval[1]
    assert bad.lag_1 == pytest.approx(0.4, abs=0.05)  # 0.5 / (1 + 0.5²)


def test_absent_components_do_not_count():
    random = np.random.default_rng(0)
    white = random.normal(size=(3000, 2))
    white[::3, 0] = np.nan
    correlation, pairs = lag_1(white)
    present = white[1::3, 0], white[2::3, 0]
    assert pairs == [1000, 2999]
    assert correlation[0] == pytest.approx(
        float(np.sum(present[0] * present[1]) / np.prod([np.linalg.norm(p) for p in present]))
    )


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_real"))


@pytest.fixture(scope="module")
def drive() -> Recording:
    return read_bag(shared_folder("bags") / "double_lane_change")


def test_what_is_zero_or_without_effect_is_not_tuned(car: Vehicle):
    assert "observer.force_errors.wheel_spin" in noise_numbers(car)
    level = car.observer.model_copy(
        update={"surroundings": car.observer.surroundings.model_copy(update={"grade": 0.0, "bank": 0.0})}
    )
    less = {name: sensor for name, sensor in car.sensors.items() if name != "wheel_speeds"}
    paths = noise_numbers(car.model_copy(update={"observer": level, "sensors": less}))
    assert not [path for path in paths if "grade" in path or "bank" in path or "wheel" in path]
    assert "sensors.imu.rate_noise.2" in paths


def test_every_message_has_an_innovation_given_all_before_it_even_if_it_came_late(car: Vehicle, drive: Recording):
    late = {t: replace(c, received=c.received + 50_000_000 * (t == "gps/fix")) for t, c in drive.channels.items()}
    first, second = innovations(drive, car), innovations(replace(drive, channels=late), car)
    assert set(first) == {"imu", "wheel_speeds", "position", "velocity"}
    for name, one in first.items():
        assert np.array_equal(one.whitened, second[name].whitened)
    assert len(first["imu"].used) > 2990


def test_what_messages_state_of_their_noise_counts_unless_the_file_says_no(car: Vehicle, drive: Recording):
    wrong = car.sensors["imu"].model_copy(update={"force_noise": (0.1, 0.1, 0.1)})
    car = car.model_copy(update={"sensors": {**car.sensors, "imu": wrong}})
    stated, own = (innovations(drive, c, noise_as_stated=True)["imu"] for c in (car, with_own_noise(car)))
    assert np.nanmedian(stated.deviation[:, 3]) > 0.44
    assert np.nanmedian(own.deviation[:, 3]) < 0.3


def test_a_recording_that_tells_nothing_is_refused(car: Vehicle, drive: Recording):
    blind = {topic: channel for topic, channel in drive.channels.items() if topic.startswith("reference/")}
    with pytest.raises(InputError, match="none of the vehicle's sensors"):
        innovations(replace(drive, channels=blind), car)
    still = {topic: channel for topic, channel in drive.channels.items() if topic == "imu/data"}
    with pytest.raises(InputError, match="never started"):
        innovations(replace(drive, channels=still), car)


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_the_noise_that_was_put_into_a_recording_is_found(car: Vehicle, tmp_path: Path):
    """The file believes in sensors that are better or worse than those of the recording by a factor of two or three.

    The steering angle has no noise: it drives the model, which would be shaken as if gyros were noisier.
    """
    quiet = {"steering": car.sensors["steering"].model_copy(update={"simulated_noise": 0.0})}
    drive = generate("double_lane_change", car.model_copy(update={"sensors": car.sensors | quiet}), seed=3)
    source = vehicle_path("prototype_real").read_text(encoding="utf-8")
    for there, here in (
        ("force_noise: [0.447, 0.447, 0.447]", "force_noise: [0.15, 1.2, 0.9] # of the data sheet"),
        ("rate_noise: [1.75e-3, 1.75e-3, 1.75e-3]", "rate_noise: [4.0e-3, 1.0e-3, 4.0e-3]"),
        ("noise: 0.04}", "noise: 0.1}"),
        ("noise: 0.025}", "noise: 0.06}"),
    ):
        assert there in source
        source = source.replace(there, here)
    # The road of the drive is level.
    source = source.replace("observer:\n", "observer:\n  surroundings: {grade: 0.0, bank: 0.0}\n")
    start, target = tmp_path / "start.yaml", tmp_path / "tuned.yaml"
    start.write_text(source, encoding="utf-8")
    half = {t: c.select(c.seconds < 6.0) for t, c in drive.channels.items()}
    write_bag(tmp_path / "half", replace(drive, channels=half))
    arguments = ["tune", str(tmp_path / "half"), "--vehicle", str(start), "--own-noise", "--output", str(target)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    truth, found = car.sensors, load_vehicle(target).sensors
    for name in ("rate_noise", "force_noise"):
        assert getattr(found["imu"], name) == pytest.approx(getattr(truth["imu"], name), rel=0.08)
    for name, within in (("wheel_speeds", 0.08), ("velocity", 0.2), ("position", 0.2)):
        assert found[name].noise == pytest.approx(truth[name].noise, rel=within)
    assert "# of the data sheet" in target.read_text(encoding="utf-8")
    figures = json.loads(target.with_suffix(".json").read_text(encoding="utf-8"))
    for name, after in figures["after"]["sensors"].items():
        low, high = after["nis_interval"]
        assert low < after["nis"] < high, name
        assert after["log_likelihood"] > figures["before"]["sensors"][name]["log_likelihood"] - 0.01
    assert figures["after"]["errors"]["side_slip"]["rmse"] < figures["before"]["errors"]["side_slip"]["rmse"]
    assert target.with_suffix(".png").stat().st_size > 10_000
