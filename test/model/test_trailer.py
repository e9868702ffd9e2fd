"""A trailer behind the car with all its motions, beside the linear single track; what the observer is without it."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

import vsense_ros as vs
from vsense_ros.errors import InputError
from vsense_ros.identification.combination import SingleTrack, linear
from vsense_ros.manoeuvre import drive, generate, recorded
from vsense_ros.manoeuvre.trailer_sway import SETTINGS, driver
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import YAW_RATE
from vsense_ros.model.sensors import Articulation
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.trailer import Trailer
from vsense_ros.model.vehicle import Vehicle

BEFORE = vs.load_vehicle("rav4")
TRAILER = Trailer(mass=1400, nose_load=20)


def towing(trailer: Trailer | None = TRAILER) -> Vehicle:
    physics = BEFORE.physics.model_copy(update={"trailer": trailer})
    sensors = {**BEFORE.sensors, **({"hitch": Articulation()} if trailer else {})}
    return BEFORE.model_copy(update={"physics": physics, "sensors": sensors})


@pytest.fixture(scope="module")
def swaying() -> Trajectory:
    return drive("trailer_sway", towing())


def test_a_sway_has_frequency_and_damping_of_the_linear_single_track(swaying: Trajectory) -> None:
    free = swaying.t > 3.5
    angle, t = swaying.internal_state[free, 0], swaying.t[free]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(angle)))) + 1  # extremes, half a period apart
    peaks = np.abs(angle[turns][:4])
    decrement = -np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0]
    found = decrement / np.hypot(decrement, np.pi)
    values = np.linalg.eigvals(linear(SingleTrack.of(BEFORE), TRAILER, 25.0))
    slowest = min(values[values.imag > 0.1], key=lambda value: -value.real / abs(value))
    assert found == pytest.approx(-slowest.real / abs(slowest), abs=0.03)
    assert np.pi / np.diff(t[turns][:4]).mean() == pytest.approx(slowest.imag, rel=0.1)


def test_a_step_ten_times_as_long_gives_the_same_sway(swaying: Trajectory) -> None:
    car = towing()
    q, u = rolling_straight(car, SETTINGS.speed)
    coarse = simulate(car, driver(car), 12.0, step=0.01, q=q, u=u)
    for found, fine in (
        (coarse.u[:, YAW_RATE], swaying.u[::10, YAW_RATE]),
        (coarse.internal_state[:, 0], swaying.internal_state[::10, 0]),
    ):
        assert np.abs(found - fine).max() < 0.1 * np.abs(fine).max()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*has no sensor for vehicle/articulation")
def test_an_observer_that_knows_the_trailer_does_not_take_its_pull_and_weight_for_forces_of_tyres(
    swaying: Trajectory,
) -> None:
    recording = recorded("trailer_sway", swaying, towing(), 0)
    assert "vehicle/articulation" in recording
    signals = ["side_slip", *(f"wheel_force_{wheel}_{axis}" for wheel in ("rl", "rr") for axis in "yz")]
    known, unknown = (vs.estimate(recording, towing(trailer)) for trailer in (TRAILER, None))
    for name in signals:
        assert known[name].rmse < 0.75 * unknown[name].rmse, name


def test_cars_and_files_that_do_not_fit_are_refused_in_a_sentence() -> None:
    with pytest.raises(InputError, match="tows no trailer"):
        generate("trailer_sway", BEFORE)
    content = BEFORE.model_dump()
    content["sensors"]["hitch"] = {"kind": "articulation"}
    with pytest.raises(ValidationError, match="mass is enough"):
        Vehicle.model_validate(content)
    assert car_of(towing()).internal_state_slices == {"trailer": slice(0, 3)}
