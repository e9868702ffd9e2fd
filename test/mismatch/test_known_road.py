"""A road that the vehicle file knows from place to place, under an observer that drives on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.interpolate import BSpline, make_interp_spline

from hidden import driven, having, prototype, without
from vsense_ros.estimation.reading import Map
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import DISTURBANCES, YAW, X, Y
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.road_map import NEAR, SPACING, Profile, RoadMap
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import DISTURB
from vsense_ros.runner import Runner

ORIGIN = (43.5, -8.2, 50.0)
BANK = DISTURB.start + DISTURBANCES.index("bank")
EAST = np.arange(-50.0, 651.0, SPACING)


def banked(x: np.ndarray) -> np.ndarray:
    """Bank [rad] by the way to the east [m]."""
    return np.asarray(0.06 * np.sin(2 * np.pi * x / 300))


@pytest.fixture(scope="module")
def drive() -> Recording:
    return driven(prototype(), "slalom", duration=40.0, bank=banked)


@pytest.fixture(scope="module")
def rows(drive: Recording) -> list[tuple[float, float]]:
    """Latitude and longitude [deg] of places 50 m apart on the way, from the fixes."""
    fix, on_map = drive["gps/fix"].columns, Map(drive.map_origin)
    placed = [
        on_map.placed({k: fix[k][i] for k in ("latitude", "longitude", "altitude")})
        for i in range(len(fix["latitude"]))
    ]
    east, north = (np.array([float(one[k][0]) for one in placed]) for k in ("east", "north"))
    order = np.argsort(east)
    return [on_map.latitude_longitude(x, float(np.interp(x, east[order], north[order]))) for x in EAST]


def profile(rows: list[tuple[float, float]], values: np.ndarray) -> list[tuple[float, ...]]:
    return [(*place, 0.0, float(value)) for place, value in zip(rows, values, strict=True)]


def estimated(vehicle: Vehicle, recording: Recording) -> np.ndarray:
    """East [m], bank [rad] and lateral velocity less that of the reference [m/s], at every message."""
    observer, found = Runner(vehicle, recording.map_origin), []
    for sample in recording.samples(tuple(observer.topics)):
        observer.add(sample)
        if observer.converged:
            observer.snapshot()
            state = observer.filter.car.mean
            found.append((observer.stamp, state[X], state[BANK], state[15]))
    stamp, east, bank, lateral = np.array(found).T
    true = recording["reference/odometry"]
    return np.column_stack([east, bank, lateral - np.interp(stamp, true.stamp, true.columns["linear"][:, 1])])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.exam
def test_on_a_road_that_is_known_the_observer_has_less_doubt_of_its_bank_and_of_the_slip(drive, rows):
    """Against the truth; fixes come late, so that the observer keeps going back."""
    anywhere = estimated(prototype(), drive)
    known = estimated(having(prototype(), road_bank={"profile": profile(rows, banked(EAST))}), drive)
    off = [rms(one[:, 1] - banked(one[:, 0])) for one in (known, anywhere)]
    assert off[0] < 0.4 * off[1]
    assert rms(known[:, 2]) < rms(anywhere[:, 2])


@pytest.mark.exam
def test_the_grip_of_a_road_is_that_of_the_place(drive, rows):
    grip = np.linspace(-0.3, 0.1, len(EAST))
    vehicle = having(prototype(), friction_change={"relative": 0.05, "profile": profile(rows, grip)})
    observer = Runner(vehicle, drive.map_origin)
    index = car_of(vehicle).parameter_names.index("effects.friction_change.relative")
    for i, sample in enumerate(drive.samples(tuple(observer.topics))):
        observer.add(sample)
        if observer.converged and i % 200 == 0:
            observer.snapshot()
            expected = 0.05 + np.interp(observer.filter.car.mean[X], EAST, grip)
            assert observer.filter.car.parameters[index] == pytest.approx(expected, abs=0.01)  # a dozen metres
    observer.filter.start_rolling(10.0)
    assert not np.isfinite(observer.filter.car.surveyed[:2]).any()


def standing(vehicle: Vehicle, east: float) -> CarFilter:
    """A filter that knows its place and, surely, its heading."""
    ekf = FILTERS["error_ekf"].make(vehicle, sensors_of(vehicle))
    ekf.start_rolling(15.0)
    for index, value in ((X, east), (Y, 0.0), (YAW, 0.0)):
        ekf.set_element(index, value, 0.1)
    ekf.linearize()
    return ekf


@pytest.mark.exam
def test_where_a_surveyed_road_begins_and_ends_the_estimated_slope_stays():
    """It is not the road that ends."""
    on_map = Map(ORIGIN)
    places = [on_map.latitude_longitude(x, 0.0) for x in (100.0, 150.0, 200.0)]
    vehicle = having(
        prototype(),
        road_bank={"profile": [(*place, 0.0, bank) for place, bank in zip(places, (0.05, 0.07, 0.02), strict=True)]},
        friction_change={"profile": [(*on_map.latitude_longitude(x, 0.0), 0.0, -0.1) for x in range(-500, 800, 50)]},
    )
    survey, ekf = RoadMap.of(vehicle, on_map), standing(vehicle, 0.0)
    ekf.car.mean[BANK] = 0.05
    for east, expected in (
        (0.0, 0.05),
        (60.0, 0.05),
        (100.1, 0.05),
        (150.0, 0.07),
        (199.9, 0.02),
        (230.0, 0.02),
        (400.0, 0.02),
    ):
        ekf.set_element(X, east, 0.1)
        survey.follow(ekf)
        assert ekf.car.mean[BANK] == pytest.approx(expected, abs=1e-3), east


@pytest.mark.exam
def test_who_no_longer_knows_where_he_is_does_not_keep_the_grip_of_the_last_place():
    on_map = Map(ORIGIN)
    rows = [(*on_map.latitude_longitude(x, 0.0), 0.0, -0.3) for x in (0.0, 50.0, 100.0)]
    vehicle = having(prototype(), friction_change={"relative": 0.1, "profile": rows})
    survey, ekf = RoadMap.of(vehicle, on_map), standing(vehicle, 40.0)
    index = car_of(vehicle).parameter_names.index("effects.friction_change.relative")
    survey.follow(ekf)
    assert ekf.car.parameters[index] == pytest.approx(-0.2, abs=1e-3)
    before = ekf.car.udot.copy()
    ekf.linearize()
    assert np.array_equal(ekf.car.udot, before)
    ekf.set_element(X, 60.0, 30.0)
    survey.follow(ekf)
    assert ekf.car.parameters[index] == pytest.approx(0.1)
    ekf.set_element(X, 60.0, 0.1)
    survey.follow(ekf)
    assert ekf.car.parameters[index] == pytest.approx(-0.2, abs=1e-3)
    ekf.start_rolling(10.0)
    assert ekf.car.parameters[index] == pytest.approx(0.1)


def test_what_the_observer_estimates_itself_is_left_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("VSENSE_COMPILE", "0")  # takes longer than calling a few functions once
    on_map, name = Map(ORIGIN), "effects.friction_change.relative"
    rows = [(*on_map.latitude_longitude(x, 0.0), 0.0, -0.3) for x in (0.0, 50.0)]
    vehicle = having(prototype(), friction_change={"relative": 0.1, "profile": rows})
    ekf, index = standing(vehicle, 20.0), car_of(vehicle).parameter_names.index(name)
    estimating = vehicle.observer.model_copy(update={"parameters": {name: None}})
    RoadMap.of(vehicle.model_copy(update={"observer": estimating}), on_map).follow(ekf)
    assert ekf.car.parameters[index] == pytest.approx(0.1)


def test_a_file_without_profiles_has_no_survey():
    assert RoadMap.of(having(prototype(), road_bank={"bank": 0.03}), Map(ORIGIN)) is None


def test_who_does_not_know_where_the_car_is_does_not_look_up_its_road():
    known = having(prototype(), road_bank={"profile": [(*ORIGIN[:2], 0.0, 0.05)]})
    assert RoadMap.of(known, Map(ORIGIN)) is not None
    assert RoadMap.of(without(known, "gnss_position"), Map(ORIGIN)) is None


def test_grip_at_one_place_is_that_of_the_place_alone():
    vehicle = having(prototype(), friction_change={"profile": [(*ORIGIN[:2], 0.0, -0.3)]})
    survey = RoadMap.of(vehicle, Map(ORIGIN))
    here = survey.at(0.0, 0.0, 0.0)
    assert here.sizes == {"effects.friction_change.relative": pytest.approx(-0.3, abs=1e-3)}
    assert not here.slopes.any()
    assert not here.on_profile.any()
    for elsewhere in (survey.at(0.0, 0.0, np.pi), survey.at(500.0, 0.0, 0.0)):
        assert elsewhere.sizes == {"effects.friction_change.relative": 0.0}
    assert RoadMap.of(vehicle, Map(None)).at(0.0, 0.0, 0.0) is None


def natural_spline(at: np.ndarray, values: np.ndarray) -> BSpline:
    """By the basis splines in which it is written as well (de Boor 1978), without second derivatives at its ends."""
    flat = [(2, 0.0)]
    return make_interp_spline(at, values, bc_type=(flat, flat))


@given(
    heading=st.floats(-np.pi, np.pi),
    values=st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=6),
    share=st.floats(0.01, 0.99),
    across=st.floats(-0.99 * NEAR, 0.99 * NEAR),
    askew=st.floats(-0.8, 0.8),
)
@example(heading=-1.6521719041126177, values=[0.0, 0.1, 0.0, 0.0], share=1 / 3, across=14.0, askew=0.0)
def test_between_its_rows_a_profile_has_no_kinks_for_who_drives_its_way(heading, values, share, across, askew):
    """Along a straight road in any direction."""
    way, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    on_map, length = Map(ORIGIN), SPACING * (len(values) - 1)
    places = [on_map.latitude_longitude(*(SPACING * i * way)) for i in range(len(values))]
    found = Profile(tuple((*place, heading, v) for place, v in zip(places, values, strict=True)), on_map)
    place = share * length * way + across * left
    spline = natural_spline(SPACING * np.arange(len(values)), np.array(values))
    value, change = float(spline(share * length)), float(spline(share * length, 1))
    told = found.at(*place, heading + askew)
    assert told == (pytest.approx(value, abs=1e-3), pytest.approx(change, abs=1e-3), True)
    off = [(place, np.pi), (place + (1.02 * NEAR - across) * left, 0.0), ((length + 1.02 * SPACING) * way, 0.0)]
    for elsewhere, turned in off:
        assert found.at(*elsewhere, heading + turned) == (0.0, 0.0, False)
    beyond = (length + 0.5 * SPACING) * way
    assert found.at(*beyond, heading) == (pytest.approx(0.5 * values[-1], abs=1e-3), 0.0, False)
