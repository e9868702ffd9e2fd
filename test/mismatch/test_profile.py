"""A road that changes from place to place, found on recordings that share it."""

from __future__ import annotations

import csv
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hidden import driven, having, prototype, unheard, wrong
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch import extension
from vsense_ros.mismatch.answer_schema import read_answer
from vsense_ros.mismatch.candidates import candidates
from vsense_ros.mismatch.cross_validation import odd
from vsense_ros.mismatch.effect_parameters import effect_of, parameters_of, profiles_of, varying_sizes
from vsense_ros.mismatch.explain import explain_recordings
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.road import ROAD_SETTINGS, SPACING, bending, curvature, point, profile, profile_change
from vsense_ros.mismatch.road_prediction import predict_road
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.effects.road_bank import RoadBank
from vsense_ros.model.vehicle import Vehicle


def waves(x: np.ndarray) -> np.ndarray:
    """Bank by the way to the east [rad]."""
    return 0.04 * np.sin(2 * np.pi * x / 200)


def told(effect: dict) -> list[tuple[float, float]]:
    """Way [m] and size of an entry of explain.json that has another at every place."""
    return [(one.distance, one.value + effect.parameters[0].value) for one in effect.profile]


@pytest.fixture(scope="module")
def slalom():
    vehicle = prototype()
    return vehicle, build_dataset([driven(vehicle, "slalom", bank=waves)], vehicle)


@pytest.mark.slow
def test_the_true_profile_brings_the_simulation_to_the_recording(slalom):
    vehicle, dataset = slalom
    predictor = Predictor(vehicle, dataset)
    table = {
        point("effects.road_bank.bank", ROAD_SETTINGS.stretch / 2 + s): float(waves(s))
        for s in np.arange(0.0, 300.0, SPACING)
    }
    flat = Predictor(vehicle, build_dataset([driven(vehicle, "slalom")], vehicle))

    def error(of: Predictor, parameter_set: ParameterSet) -> float:
        (measured,), (simulated,) = of.measured, of.simulated(parameter_set)
        return float(np.std(simulated["lateral_acceleration"] - measured["lateral_acceleration"]))

    noise = error(flat, flat.start)
    assert error(predictor, predictor.start) > 2.0 * noise
    assert error(predictor, predictor.start.changed(table)) < 1.2 * noise


@pytest.mark.slow
def test_grip_that_varies_is_that_of_the_place(slalom):
    vehicle, dataset = slalom
    predictor = Predictor(vehicle, dataset)
    size = "effects.friction_change.relative"
    everywhere = {point(size, ROAD_SETTINGS.stretch / 2 + s): -0.3 for s in np.arange(-200.0, 500.0, SPACING)}
    slippery, alike = (
        predictor.simulated(predictor.start.changed(change))[0]["yaw_rate"] for change in ({size: -0.3}, everywhere)
    )
    assert alike == pytest.approx(slippery, abs=1e-9)
    far_away = predictor.start.changed({point(size, ROAD_SETTINGS.stretch / 2 + 1000.0): -0.3})
    assert predictor.simulated(far_away)[0]["yaw_rate"] == pytest.approx(
        predictor.simulated(predictor.start)[0]["yaw_rate"], abs=1e-12
    )


def test_a_plane_slopes_the_other_way_for_who_has_turned_round():
    parameter_set = ParameterSet(
        {"effects.road_bank.bank": 0.03, "effects.road_bank.follows": 0.0, "effects.road_grade.follows": 1.0}
    )
    effect = effect_of(parameter_set, "road_bank")
    assert effect.slope(0.0) == pytest.approx((0.0, 0.03))
    assert effect.slope(np.pi / 2) == pytest.approx((0.03, 0.0))
    assert effect.slope(np.pi) == pytest.approx((0.0, -0.03))


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_a_bank_that_changes_along_the_road_is_named_with_its_profile(tmp_path):
    recordings = [driven(prototype(), m, bank=waves) for m in ("sweep", "slalom")]
    recordings.append(driven(prototype(), "brake", duration=10.0, bank=waves))  # not further than the others
    result = explain_recordings(recordings[:2], wrong(prototype()), recordings[2:])
    found = result.answer
    assert found.verdict == "named"
    best = found.effects[0]
    assert best.id == "road_bank"
    assert best.gain_held_out > 0.3
    profile = told(best)
    within = [(s, value) for s, value in profile if 0 <= s < 220]
    assert [value for _, value in within] == pytest.approx([float(waves(np.array(s))) for s, _ in within], abs=0.012)

    result.write(tmp_path)
    assert read_answer(tmp_path).effects[0].profile
    with (tmp_path / "road.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["value"]) for row in rows] == pytest.approx([value for _, value in profile])
    extended = load_vehicle(tmp_path / "vehicle.extended.yaml")
    assert explain_recordings(recordings[:2], extended).answer.verdict == "no_mismatch"


@pytest.mark.exam
def test_what_a_bank_at_one_place_does_is_known_from_places_far_apart_that_are_changed_together():
    """Compared with each of 17 places by itself: what a road does there is over within 150 m."""
    vehicle = prototype()
    dataset = build_dataset([without_place(vehicle, hills)], vehicle)
    residuals = Residuals(Predictor(vehicle, dataset))
    start = residuals.predictor.start
    library = {c.name: c for c in candidates(dataset.points, start.values)}
    bank = library["road_bank along the road"]
    level = residuals(start)
    base = Fit(start, (), np.zeros(0), level, [np.zeros((len(rows), 0)) for rows in level], 1.0)
    search = Search(residuals, start, base, [library["road_bank"], bank])
    assert search.visible == {"road_bank"}
    search.secants.simulate_new([bank])
    assert len(bank.places) == 17
    for place in bank.places:
        together = np.concatenate(search.secants.column(place))
        search.secants.simulate([place])
        alone = np.concatenate(search.secants.column(place))
        assert np.linalg.norm(together - alone) < 0.25 * np.linalg.norm(alone), place.name


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_a_bank_that_changes_along_the_road_is_named_beside_a_brake_that_drags():
    def bank(x: np.ndarray) -> np.ndarray:
        return 0.05 + 1.25 * waves(x)

    true = having(prototype(), brake_drag={"fl": 17.0})
    recordings = [driven(true, m, bank=bank) for m in ("sweep", "slalom")]
    recordings.append(driven(true, "brake", duration=10.0, bank=bank))
    found = explain_recordings(recordings[:2], wrong(prototype()), recordings[2:]).answer
    assert (found.verdict, set(found.answer_set)) == ("named", {"brake_drag", "road_bank"})
    brake, road = sorted((e for e in found.effects if e.accepted), key=lambda e: e.id)
    assert (brake.wheel, brake.parameters[0].value) == ("fl", pytest.approx(17.0, rel=0.07))
    within = [(s, value) for s, value in told(road) if 0 <= s < 220]
    assert [value for _, value in within] == pytest.approx([float(bank(np.array(s))) for s, _ in within], abs=0.012)


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_where_one_bank_is_enough_no_profile_is_told():
    true = having(prototype())
    recordings = [driven(true, m, bank=lambda x: 0.03 + 0 * x) for m in ("sweep", "slalom", "brake")]
    best = explain_recordings(recordings[:2], wrong(prototype()), recordings[2:]).answer.effects[0]
    assert best.id == "road_bank"
    assert best.profile is None
    # The file allows for a bias of the accelerometer of 0.1 m/s², which is as much as 0.01 rad.
    assert best.parameters[0].value == pytest.approx(0.03, abs=0.01)


def test_a_profile_of_the_vehicle_file_stays_where_another_is_fitted_beside_it(slalom):
    vehicle, dataset = slalom
    size, origin = "effects.road_bank.bank", ROAD_SETTINGS.stretch / 2

    def row(way: float, bank: float) -> tuple[float, float, float, float]:
        at = dataset.road.place(origin + way)
        assert at is not None
        return (*dataset.on_map.latitude_longitude(*at[:2]), at[2], bank)

    surveyed = (row(0.0, 0.02), row(SPACING, 0.02), row(2 * SPACING, 0.02))
    known = having(vehicle, road_bank={"bank": 0.0, "profile": surveyed})
    fitted = parameters_of(known).changed({point(size, origin + way): 0.01 for way in (SPACING, 2 * SPACING)})
    extended = extension.extended(known, dataset, fitted)
    in_file = Predictor(extended, dataset).roads.profiles_of_file[size]
    place = origin + np.array([0.0, SPACING, 1.5 * SPACING, 2 * SPACING])
    assert profile(in_file, place) == pytest.approx([0.02, 0.03, 0.03, 0.03], abs=2e-3)
    assert extension.extended(known, dataset, parameters_of(known)).physics.effects.road_bank.profile == surveyed


def test_a_body_turns_with_its_road_and_is_heavier_on_its_way_into_a_climb(slalom):
    """The slope grows by 2·10⁻⁴ rad on every metre: at a speed v the nose rises at 2·10⁻⁴ v, and the path of the car
    has a radius of 5 km, which takes v²/5 km. On a bank that grows alike the left side rises, and nothing is heavier.
    """
    vehicle, dataset = slalom
    predictor = Predictor(vehicle, dataset)
    (window,) = dataset.windows
    t = grid(window)
    passing = np.gradient(np.interp(t, window.place.t, window.place.value[:, 0]), t)  # m of the road per second

    def changed(size: str) -> dict[str, float]:
        """Mean of what it adds to the signals, over what would be expected of the first."""
        along = predictor.start.changed(
            {point(size, ROAD_SETTINGS.stretch / 2 + s): 2e-4 * s for s in np.arange(0.0, 600.0, SPACING)}
        )
        (bent,), (flat,) = (predictor.simulated(one) for one in (along, predictor.start))
        return {name: float(np.mean(bent[name] - flat[name])) for name in bent}

    rate, heavier = 2e-4 * passing.mean(), np.mean(passing**2) / 5e3
    climb, bank = changed("effects.road_grade.grade"), changed("effects.road_bank.bank")
    assert climb["pitch_rate"] == pytest.approx(-rate, rel=0.1)
    assert climb["vertical_acceleration"] == pytest.approx(heavier, rel=0.1)
    assert bank["roll_rate"] == pytest.approx(rate, rel=0.1)
    assert abs(bank["vertical_acceleration"]) < 0.1 * heavier


@given(bank=st.floats(-0.1, 0.1), radius=st.floats(30.0, 300.0), turned=st.floats(-3.0, 3.0))
def test_a_plane_is_not_bent_and_a_banked_bend_is_a_cone(bank, radius, turned):
    """The normal of a cone turns about the vertical as the road does: at a bank β in a bend of radius R, the car's nose
    falls by β/R on every metre where the left side is higher and the bend goes to the left."""
    place = ROAD_SETTINGS.stretch / 2 + np.arange(0.0, 300.0, 0.1)
    angle = turned + place / radius
    bends = curvature(place, angle)
    assert bends == pytest.approx(1 / radius, rel=1e-6)
    plane, cone = (RoadBank(bank=bank, follows=follows) for follows in (0.0, 1.0))
    assert np.abs(bending(plane.slope, (0.0, 0.0), angle, bends)).max() < 1e-6
    along, across = bending(cone.slope, (0.0, 0.0), angle, bends)
    assert np.broadcast_to(along, len(place)) == pytest.approx(-bank / radius, abs=1e-9)
    assert np.broadcast_to(across, len(place)) == pytest.approx(0.0, abs=1e-9)


def test_a_car_that_weaves_on_a_straight_road_turns_back_and_its_road_does_not_turn():
    place = ROAD_SETTINGS.stretch / 2 + np.arange(0.0, 400.0, 0.1)
    weaving = curvature(place, 0.1 * np.sin(2 * np.pi * place / 40.0))
    assert np.abs(weaving[1000:-1000]).max() < 0.15 * 0.1 * 2 * np.pi / 40.0
    jump = np.concatenate([place, place + ROAD_SETTINGS.stretch])
    assert np.abs(curvature(jump, np.repeat([0.0, 2.0], len(place)))).max() == 0.0


def test_between_the_points_of_a_profile_a_road_bends_as_one_that_has_no_kinks():
    points = {float(s): float(np.sin(2 * np.pi * s / 200)) for s in np.arange(0.0, 2001.0, SPACING)}
    place = np.arange(500.0, 1500.0, 5.0)
    assert profile_change(points, place) == pytest.approx(
        2 * np.pi / 200 * np.cos(2 * np.pi * place / 200), abs=0.1 * 2 * np.pi / 200
    )


def hills(x: np.ndarray) -> np.ndarray:
    return 0.04 * np.sin(2 * np.pi * x / 400)


@pytest.mark.exam
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("duration", "known"), [(50.0, True), (20.0, False)])
def test_a_road_that_one_recording_passes_once_is_known_if_it_is_long_enough(duration, known):
    """Nothing is held out, and no place is met twice: each second piece of the road follows from its neighbours."""
    recording = driven(prototype(), "brake", duration=duration, bank=hills)
    found = explain_recordings([recording], wrong(prototype())).answer
    assert found.answer_set == (("road_bank",) if known else ())
    assert any(effect.profile for effect in found.effects) == known
    if known:
        bank = found.effects[0]
        assert bank.gain_left_out > 0.8 * bank.gain_training
        within = [(s, value) for s, value in told(bank) if 100 <= s < 800]
        off = np.array([value - float(hills(np.array(s))) for s, value in within])
        assert off - off.mean() == pytest.approx(np.zeros(len(off)), abs=0.01)


def other_hills(x: np.ndarray) -> np.ndarray:
    return 0.03 * np.sin(2 * np.pi * x / 300 + 1.0)


def without_place(vehicle: Vehicle, bank: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """Most of a kilometre without GNSS, so that nothing tells that it is where another recording was."""
    return unheard(driven(vehicle, "brake", duration=50.0, bank=bank), "gps/fix", "gps/velocity")


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_of_recordings_of_roads_of_their_own_each_road_is_known():
    recordings = [without_place(prototype(), bank) for bank in (hills, other_hills)]
    found = explain_recordings(recordings, wrong(prototype())).answer
    assert (found.verdict, found.answer_set) == ("named", ("road_bank",))
    (effect,) = (e for e in found.effects if e.id == "road_bank")
    for stretch, bank in enumerate((hills, other_hills)):
        places = [p for p in effect.profile if p.stretch == stretch and 100 <= p.distance < 700]
        off = np.array([p.value - float(bank(np.array(p.distance))) for p in places])
        assert len(off) > 10
        assert off - off.mean() == pytest.approx(np.zeros(len(off)), abs=0.01)


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_a_road_is_proven_on_one_that_no_fit_has_seen():
    known, unseen = (without_place(prototype(), bank) for bank in (hills, other_hills))
    found = explain_recordings([known], wrong(prototype()), [unseen]).answer
    assert (found.verdict, found.answer_set) == ("named", ("road_bank",))
    assert found.effects[0].gain_held_out > 0.2
    assert "on another road, where neighbouring pieces predict each other" in found.sentence
    assert any("each piece of 50 m" in remark for remark in found.remarks)


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_two_cars_are_not_taken_for_one_on_two_roads():
    van = prototype().with_parameters(
        {"chassis.mass": 1000.0, "front.unloaded_radius": 0.262, "rear.unloaded_radius": 0.262}
    )
    recordings = [without_place(vehicle, np.zeros_like) for vehicle in (prototype(), van)]
    found = explain_recordings(recordings, prototype()).answer
    assert found.verdict in ("unknown", "not_assessable")
    assert not any(effect.profile for effect in found.effects)


@pytest.mark.exam
def test_what_is_measured_on_a_piece_of_an_unseen_road_has_no_part_in_what_is_predicted_of_it():
    """All lateral accelerations on even pieces are 1 m/s² too large: that tells of these pieces alone."""
    vehicle = prototype()
    dataset = build_dataset([without_place(vehicle, hills)], vehicle)
    told = Residuals(Predictor(vehicle, dataset))
    (bank,) = (c for c in candidates([0.0], told.predictor.start.values) if c.name == "road_bank along the road")
    elsewhere = Fit(told.predictor.start, bank.free_parameters, np.zeros(2), [], [], 0.0)
    spoilt = Residuals(Predictor(vehicle, dataset))
    for window, measured in zip(dataset.windows, spoilt.predictor.measured, strict=True):
        measured["lateral_acceleration"] = measured["lateral_acceleration"] + np.where(odd(window), 0.0, 1.0)
    size = "effects.road_bank.bank"
    of = {}
    for residuals in (told, spoilt):
        there = predict_road(residuals, residuals(residuals.predictor.start), elsewhere)
        of[residuals] = [np.array([*profiles_of(s)[size].values()]) for s in (there.from_odd, there.from_even)]
    assert np.abs(of[spoilt][0] - of[told][0]).mean() < 0.004
    assert np.abs(of[spoilt][1] - of[told][1]).mean() > 0.05


@given(everywhere=st.floats(-0.95, 1.0), here=st.floats(-1.95, 1.95))
def test_grip_everywhere_and_at_a_place_together_is_never_below_nothing(everywhere, here):
    size = "effects.friction_change.relative"
    parameter_set = ParameterSet({size: everywhere, point(size, 0.0): here})
    sums = varying_sizes(parameter_set.values, [profiles_of(parameter_set)], np.array([0.0])).get(
        size, np.array([everywhere])
    )
    assert sums == pytest.approx(min(max(everywhere + here, -0.95), 1.0))
