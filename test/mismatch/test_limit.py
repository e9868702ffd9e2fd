"""What is made of simulations that go astray: at the limit of grip, and from a fit that stopped short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hidden import STEP, driven, having, prototype, wrong
from vsense_ros.identification.free_parameter import FreeParameter, with_offsets
from vsense_ros.identification.least_squares import Fit, Settings, fit, slope
from vsense_ros.mismatch.candidates import base_parameters, candidates, out_of_reach
from vsense_ros.mismatch.residuals import RESIDUALS, Residuals, tempered, untempered
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.short_windows import SHORT, Restarts
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.windows import Dataset, build_dataset
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import INPUTS, SPIN, TORQUES, X
from vsense_ros.model.simulation.closed_loop import rolling_radii, rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop

ERRORS = arrays(float, (3, 5), elements=st.floats(-40.0, 40.0, allow_subnormal=False))


@given(ERRORS)
def test_errors_are_known_again_from_what_counts_of_them(off):
    assert untempered(tempered(off)) == pytest.approx(off, rel=1e-6, abs=1e-9)


@given(ERRORS)
def test_an_instant_that_is_far_off_counts_for_less_and_one_that_is_near_for_what_it_is(off):
    counted = tempered(off)
    assert np.all(np.abs(counted) <= np.abs(off) * (1 + 1e-12))
    near = np.mean(off**2, axis=0) < (0.1 * RESIDUALS.far) ** 2
    assert counted[:, near] == pytest.approx(off[:, near], rel=0.01)


@pytest.fixture(scope="module")
def slalom() -> Predictor:
    return Predictor(prototype(), build_dataset([driven(prototype(), "slalom")], prototype()))


@pytest.mark.parametrize(("grip_front", "grip_rear", "lost"), [(1.0, 1.0, False), (0.8, 0.8, False), (1.0, 0.1, True)])
def test_a_car_that_spins_where_the_real_one_did_not_is_lost(slalom, grip_front, grip_rear, lost):
    parameter_set = slalom.start.changed({"front.grip_scale": grip_front, "rear.grip_scale": grip_rear})
    assert slalom.lost(parameter_set) == [lost]


def test_what_a_lost_car_would_have_measured_is_not_compared(slalom):
    residuals = Residuals(slalom)
    known = residuals(slalom.start)
    spinning = slalom.start.changed({"rear.grip_scale": 0.1})
    assert residuals.level(residuals(spinning)) > 3 * residuals.level(known)
    (counted,) = residuals(spinning, known)
    (window,), (lost,) = slalom.dataset.windows, slalom.lost_from(spinning)
    after = np.tile(grid(window) > lost - RESIDUALS.astray_before, len(residuals.layout[0]))
    assert np.array_equal(counted[after], known[0][after])


def test_a_secant_with_which_the_car_gets_lost_is_taken_with_a_smaller_step(slalom):
    residuals = Residuals(slalom)
    less_grip = FreeParameter("less grip", "-", 1.0, 0.0, 0.95, lambda values, offset: {"rear.grip_scale": 1 - offset})
    at = Fit(slalom.start, (), np.zeros(0), residuals(slalom.start), [], 0.0)
    assert slalom.lost(with_offsets(slalom.start, [less_grip], np.array([0.8]))) == [True]
    (found,), (expected,) = (slope(residuals, slalom.start, at, less_grip, step) for step in (0.8, 0.2))
    assert np.array_equal(found, expected)
    assert np.any(expected)


def slippery_at_the_limit() -> tuple[Dataset, Predictor]:
    """A drive at the limit in windows near the car, and a car with less grip on the rear axle, which spins there."""
    car = prototype()
    slippery = car.with_parameters({"rear.grip_scale": 0.9})
    recording = driven(car, "at the limit")
    predictor = Predictor(slippery, build_dataset([recording], slippery))
    assert predictor.lost(predictor.start) == [True]
    return Restarts([recording], slippery).near_the_car(predictor.dataset, predictor.start), predictor


def test_where_a_simulated_car_spins_short_windows_begin_where_the_real_one_is():
    near, spinning = slippery_at_the_limit()
    truth = driven(prototype(), "at the limit")["reference/odometry"]
    t = (truth.stamp - truth.stamp[0]) * 1e-9
    assert len(near.windows) >= 3
    for window in near.windows:
        lateral = np.interp(window.begin, t, truth.columns["linear"][:, 1])
        assert window.lateral_velocity == pytest.approx(lateral, abs=0.2)  # half a degree of side slip
        assert len(grid(window)) == pytest.approx(SHORT.compared / 0.04, abs=1)
    assert "compared 1 s at a time" in near.remarks[-1]
    residuals = Residuals(Predictor(spinning.vehicle, near))
    assert not any(residuals.predictor.lost(spinning.start))
    whole = Residuals(spinning)
    assert residuals.level(residuals(spinning.start)) < whole.level(whole(spinning.start))


@pytest.mark.exam
def test_a_fit_that_cannot_begin_as_its_car_spins_begins_in_short_windows_and_finds_car_and_effect():
    car = having(prototype(), steering_ratio={"relative": 0.1})
    slippery = wrong(prototype()).with_parameters({"rear.grip_scale": 0.8})
    recording = driven(car, "at the limit")
    whole = build_dataset([recording], slippery)
    alone = Residuals(Predictor(slippery, whole))
    stuck = fit(alone, alone.predictor.start, base_parameters(slippery))
    _, residuals, base = Restarts([recording], slippery).refitted(whole, base_parameters(slippery), lambda: None)
    assert residuals.level(base.residuals) < 0.6 < 5 < alone.level(stuck.residuals)
    assert base.parameter_set.values["rear.grip_scale"] == pytest.approx(1.0, abs=0.05)
    offered = [c for c in candidates() if c.name == "steering_ratio"]
    (found,) = Search(residuals, residuals.predictor.start, base, offered).single()
    assert found.sizes["effects.steering_ratio.relative"] == pytest.approx(0.1, abs=0.03)


def test_what_a_car_measures_before_it_gets_lost_is_compared():
    predictor = Predictor(prototype(), build_dataset([driven(prototype(), "brake")], prototype()))
    residuals = Residuals(predictor)
    spinning = predictor.start.changed({"rear.grip_scale": 0.65, "effects.gyro_bias.x": 0.05})
    (lost,) = predictor.lost_from(spinning)
    (found,) = residuals.compared(spinning, [lost])
    signals = residuals.layout[0]
    assert len(found) == len(signals) * np.sum(grid(predictor.dataset.windows[0]) < lost - RESIDUALS.astray_before)
    off = found.reshape(len(signals), -1)[signals.index("roll_rate")]
    assert np.median(off) == pytest.approx(-0.05 / residuals.deviation["roll_rate"], rel=0.3)


def test_a_wheel_that_locks_where_the_real_one_rolled_is_lost_as_well():
    predictor = Predictor(prototype(), build_dataset([driven(prototype(), "brake")], prototype()))
    assert predictor.lost(predictor.start) == [False]
    slippery = {"front.grip_scale": 0.05, "rear.grip_scale": 0.05}
    assert predictor.lost(predictor.start.changed(slippery)) == [True]


def test_tyres_of_more_longitudinal_stiffness_slip_less_in_proportion():
    def slip(scale: float) -> float:
        vehicle = prototype().with_parameters({f"{axle}.longitudinal_scale": scale for axle in ("front", "rear")})
        inputs = np.zeros((2000, len(INPUTS)))
        inputs[:, TORQUES] = 20.0
        loop = OpenLoop(car_of(vehicle), keep=1)
        start = rolling_straight(vehicle, 20.0)
        u = loop.run(*start, Inputs(STEP, inputs, np.zeros((2000, 7))), vehicle.parameter_vector()).u[-1]
        coasting = loop.run(*start, Inputs(STEP, 0 * inputs, np.zeros((2000, 7))), vehicle.parameter_vector()).u[-1]
        return float(
            np.mean(u[SPIN] * rolling_radii(vehicle) / u[X] - coasting[SPIN] * rolling_radii(vehicle) / coasting[X])
        )

    assert slip(1.0) > 1e-4
    assert slip(1.5) == pytest.approx(slip(1.0) / 1.5, rel=0.02)


@pytest.mark.exam
def test_a_base_fit_that_stopped_short_is_noticed_and_begun_anew():
    dataset = build_dataset([driven(prototype(), m) for m in ("sweep", "slalom")], wrong(prototype()))
    predictor = Predictor(wrong(prototype()), dataset)
    residuals = Residuals(predictor)
    beyond = out_of_reach({sensor.kind for sensor in dataset.sensors.values()})
    free_parameters = base_parameters(predictor.vehicle, beyond)
    unmoved = Settings(iterations=0)
    short = fit(residuals, predictor.start, free_parameters, begin=np.zeros(len(free_parameters)), settings=unmoved)
    short = fit(residuals, predictor.start, free_parameters, first=short, settings=unmoved)
    whole = fit(residuals, predictor.start, free_parameters)
    offered = [c for c in candidates() if c.effect == "brake_drag"]
    search = Search(residuals, predictor.start, short, offered)
    better = search.better_base(search.single())
    assert better is not None
    assert better.value < 0.3 * short.value
    assert better.value == pytest.approx(whole.value, rel=0.05)
    assert Search(residuals, predictor.start, better, offered).better_base([]) is None


def searched(offered: Sequence[str], *manoeuvres: str, **hidden: dict[str, float]) -> Search:
    """Among candidates of these names, for what is hidden in the manoeuvres, with wrong mass and tyres."""
    car, vehicle = having(prototype(), **hidden), wrong(prototype())
    dataset = build_dataset([driven(car, name, seed=seed) for seed, name in enumerate(manoeuvres)], vehicle)
    residuals = Residuals(Predictor(vehicle, dataset))
    base = fit(residuals, residuals.predictor.start, base_parameters(vehicle))
    return Search(residuals, residuals.predictor.start, base, [c for c in candidates() if c.name in offered])


def biased(*manoeuvres: str) -> Search:
    """For a bias of 0.03 rad/s about x."""
    return searched(["gyro_bias x"], *manoeuvres, gyro_bias={"x": 0.03})


@pytest.mark.slow
def test_the_unshrunk_size_of_what_is_named_is_hardly_drawn_to_zero():
    search = biased("sweep", "slalom")
    (alone,) = search.single()
    unshrunk = search.fitting.unshrunk(alone)
    size = "effects.gyro_bias.x"
    assert abs(unshrunk.sizes[size] - 0.03) < 0.5 * abs(alone.sizes[size] - 0.03)
    assert unshrunk.sizes[size] == pytest.approx(0.03, rel=0.01)
    assert unshrunk.gain == pytest.approx(alone.gain, abs=0.01)


@pytest.mark.exam
def test_what_is_not_there_adds_nothing_to_what_is_and_that_adds_to_it():
    search = searched(["brake_drag fl", "rolling_resistance"], "sweep", "slalom", brake_drag={"fl": 60.0})
    hidden, other = search.single()
    (both,) = search.joint([hidden, other, other])
    assert both.effects == ("brake_drag", "rolling_resistance")
    assert both.gain == pytest.approx(hidden.gain, abs=0.01)
    assert both.gain > other.gain + 0.1
    assert search.joint([hidden, hidden]) == []


@pytest.mark.exam
def test_a_hypothesis_whose_car_gets_lost_is_fitted_anew_until_it_stays_on_the_road():
    search = biased("sweep", "slalom")
    (alone,) = search.single()
    at = alone.fit
    bent = np.where([parameter.name == "grip, rear" for parameter in at.free_parameters], -0.58, at.offsets)
    parameter_set = with_offsets(search.start, at.free_parameters, bent)
    assert all(search.residuals.predictor.lost(parameter_set))
    there = replace(
        at, parameter_set=parameter_set, offsets=bent, residuals=search.residuals(parameter_set, search.base.residuals)
    )
    found = search.fitting.refined(replace(alone, fit=there))
    assert not any(search.residuals.predictor.lost(found.fit.parameter_set))
    assert found.sizes == pytest.approx(alone.sizes, rel=0.02)
    assert found.fit.value == pytest.approx(at.value, rel=0.05)


@pytest.mark.exam
def test_of_one_manoeuvre_alone_its_stretches_say_how_sure_a_size_is():
    search = biased("sweep")
    (found,) = search.single()
    size = "effects.gyro_bias.x"
    assert 0 < found.deviations[size] < 0.1 * found.sizes[size]
    assert abs(search.fitting.unshrunk(found).sizes[size] - 0.03) < 3 * found.deviations[size]


@pytest.mark.exam
@pytest.mark.parametrize(("hidden", "left_over"), [({}, False), ({"gyro_scale": {"z": 0.4}}, True)])
def test_what_was_held_out_is_off_only_if_no_base_parameters_fit_it_and_the_rest(hidden, left_over):
    car, vehicle = having(prototype(), **hidden), wrong(prototype())
    dataset = build_dataset([driven(car, "straight")], vehicle)  # says nothing of the cornering stiffness
    unseen = build_dataset([driven(car, "slalom", seed=1)], vehicle, dataset)
    residuals = Residuals(Predictor(vehicle, dataset))
    base = fit(residuals, residuals.predictor.start, base_parameters(vehicle))
    validation = Validation(unseen, vehicle, residuals, base)
    assert (
        residuals.worst(base.residuals)
        < THRESHOLDS.signal_off
        < validation.residuals.worst(validation.comparisons.before)
    )
    assert validation.something_unexplained() == left_over
    assert validation.fits_together != left_over
