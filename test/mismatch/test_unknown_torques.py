"""Cars that tell the speed of their wheels but not the torques: the model follows the speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden import driven as driven_by
from hidden import having, prototype, silent, without
from vsense_ros.identification.least_squares import Settings, fit, slope, slopes_by
from vsense_ros.mismatch.candidates import TORQUE_SHARES, base_parameters, unknown_torques
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import Readings, build_dataset
from vsense_ros.model.schema.drivetrain import Drivetrain

VELOCITY = "gnss_velocity"
DELAY = "effects.sensor_delay.wheel_speeds"


def untold(front: float, manoeuvre: str = "brake", *, wheels: bool = True) -> Residuals:
    """Residuals of a car whose torques are not measured; the front wheels have this share of them."""
    car = prototype()
    vehicle = without(car, "wheel_torques") if wheels else without(car, "wheel_torques", "wheel_speeds")
    return Residuals(Predictor(vehicle, build_dataset([driven_by(car, manoeuvre, front=front)], vehicle)))


@pytest.mark.parametrize("front", [0.0, 0.5, 1.0])
def test_which_wheels_drive_is_found_and_leaves_nothing_over(front):
    residuals = untold(front)
    found = fit(residuals, residuals.predictor.start, unknown_torques(residuals.predictor.vehicle))
    assert found.parameter_set.values["torque.driving_front"] == pytest.approx(front, abs=0.1)
    assert found.parameter_set.values["torque.braking_front"] == pytest.approx(front, abs=0.1)
    assert residuals.worst(found.residuals) < 1.0


def test_a_car_accelerates_as_its_wheels_do_less_their_slip():
    residuals = untold(0.5, "brake again")
    off = residuals.deviations(residuals(residuals.predictor.start.changed(dict.fromkeys(TORQUE_SHARES, 0.5))))
    assert off["longitudinal_acceleration"] < 1.0
    assert off["pitch_rate"] < 1.0


def test_secants_of_a_car_that_follows_a_speed_are_those_of_whole_simulations():
    residuals = untold(0.5, "brake again")
    start, free_parameters = residuals.predictor.start, base_parameters(residuals.predictor.vehicle)
    fitted = fit(residuals, start, free_parameters, settings=Settings(iterations=1))
    for parameter, near in zip(free_parameters, slopes_by(residuals, start, fitted, free_parameters), strict=True):
        whole = np.concatenate(slope(residuals, start, fitted, parameter))
        assert np.linalg.norm(np.concatenate(near) - whole) < 0.1 * np.linalg.norm(whole) + 0.5, parameter.name


def test_a_gnss_velocity_now_and_then_and_an_accelerometer_tell_how_a_car_brakes():
    residuals = untold(0.5, "brake again", wheels=False)
    (window,) = residuals.predictor.dataset.windows
    gnss = next(r for name, r in window.readings.items() if residuals.predictor.dataset.sensors[name].kind == VELOCITY)
    assert np.median(np.diff(gnss.t)) > 0.05
    off = residuals.deviations(residuals(residuals.predictor.start.changed(dict.fromkeys(TORQUE_SHARES, 0.5))))
    assert off["longitudinal_acceleration"] < 1.0
    assert off["ground_speed"] < 1.4


def test_wheel_speeds_older_than_their_stamps_say_are_followed_as_the_wheels_turned():
    car = without(prototype(), "wheel_torques")
    late = driven_by(having(prototype(), sensor_delay={"wheel_speeds": 0.2}), "brake again", front=0.5)
    residuals = Residuals(Predictor(car, build_dataset([late], car)))
    even = dict.fromkeys(TORQUE_SHARES, 0.5)
    right, wrong = (
        residuals.deviations(residuals(residuals.predictor.start.changed(even | {DELAY: age}))) for age in (0.2, 0.0)
    )
    assert max(right["longitudinal_acceleration"], right["speed"]) < 1.0 < wrong["longitudinal_acceleration"] / 2


def test_a_road_needs_as_many_points_however_seldom_the_speed_is_told():
    dataset = build_dataset([driven_by(prototype(), "slalom")], prototype())
    ends = [Readings(w.place.t[[0, -1]], w.place.value[[0, -1]]) for w in dataset.windows]
    seldom = tuple(replace(w, place=end) for w, end in zip(dataset.windows, ends, strict=True))
    assert replace(dataset, windows=seldom).points == dataset.points
    assert len(dataset.points) > 3


def test_an_accelerometer_does_not_bridge_a_gap_of_gnss():
    car = prototype()
    gap = silent(driven_by(car, "brake", 20.0), 9.0, 11.0, "gps/velocity")
    dataset = build_dataset([gap], without(car, "wheel_torques", "wheel_speeds"))
    assert [(w.end < 9.6 or w.begin > 10.4) for w in dataset.windows] == [True, True]


@pytest.mark.parametrize(
    ("kinds", "fitted"),
    [({"wheel_speeds"}, True), ({"wheel_speeds", "wheel_torques"}, False), ({"gnss_velocity"}, False)],
)
def test_which_wheels_drive_is_fitted_where_their_speeds_tell_it_and_nothing_else_does(kinds, fitted):
    names = {parameter.name for parameter in base_parameters(prototype(), kinds=kinds)}
    assert {parameter.name in names for parameter in unknown_torques(prototype())} == {fitted}


@pytest.mark.parametrize(("driven", "axles"), [("front", {"front"}), ("rear", {"rear"}), (None, {"front", "rear"})])
def test_without_wheel_speeds_those_axles_are_driven_that_the_vehicle_file_says(driven, axles):
    car = without(prototype(), "wheel_torques", "wheel_speeds")
    car = car.model_copy(update={"drivetrain": Drivetrain(driven=driven)})
    predictor = Predictor(car, build_dataset([driven_by(prototype(), "brake")], car))
    assert predictor.drives.driven_axles(predictor.start) == axles
