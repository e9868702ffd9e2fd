"""Rodríguez's tables: a full car, observed by a simplified model of another mass on another road."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from rich.console import Console

from studies.thesis import HIS_PERCENT, KINDS, LEFT, PARAMETERS, ROWS, STEPS, repeat, show, write
from vsense_ros.manoeuvre import MANOEUVRES as MANOEUVRES_BY_NAME
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import model_functions
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.full_car import simulate_full_car

pytestmark = pytest.mark.exam
FORCES = ("wheel_force_rr_x", "wheel_force_rr_y", "wheel_force_rr_z")
SPI = ("SPI_UKF", "SPI_EKF")
FRICTION = {m.name: m.friction for m in MANOEUVRES}


@pytest.fixture(scope="module")
def results(plant, model):
    return repeat(plant, model, seeds=(0,), kinds=[kind for kind in KINDS if kind.name != "UKF" and not kind.full])


@pytest.fixture(scope="module")
def full(plant, model):
    """With the full car as the observer's model; the UKF on it takes twice as long for the same."""
    kinds = [kind for kind in KINDS if kind.full and kind.name != "full_SPI_UKF"]
    return repeat(plant, model, seeds=(0,), kinds=kinds, steps=(4,))


@pytest.mark.parametrize("kind", SPI)
@pytest.mark.parametrize("manoeuvre", FRICTION)
def test_forces_are_better_known_than_in_the_thesis(results, manoeuvre, kind):
    for force, limit in zip(FORCES, (5.0, 6.0, 5.0), strict=True):
        assert results[manoeuvre, kind, 4].percent[force] <= limit
    for force, his in zip(FORCES, HIS_PERCENT["SPI", 4], strict=True):
        assert results[manoeuvre, kind, 8].percent[force] <= his


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("kind", SPI)
@pytest.mark.parametrize("manoeuvre", FRICTION)
def test_mass_and_friction_are_found_and_their_deviations_are_honest(results, manoeuvre, kind, step):
    (mass, mass_deviation), (friction, friction_deviation) = results[manoeuvre, kind, step].parameters.values()
    assert mass == pytest.approx(600.0, rel=0.02)
    assert friction == pytest.approx(FRICTION[manoeuvre], abs=0.03)
    assert abs(mass - 600.0) < 4 * mass_deviation
    assert abs(friction - FRICTION[manoeuvre]) < 3 * friction_deviation


@pytest.mark.parametrize("manoeuvre", FRICTION)
def test_the_errorekf_alone_is_no_worse_than_in_the_thesis(results, manoeuvre):
    number = list(FRICTION).index(manoeuvre)
    found = results[manoeuvre, "errorEKF", 4]
    for force, his in zip(FORCES, HIS_PERCENT["errorEKF", 4], strict=True):
        assert found.percent[force] <= his
    for row in ROWS:
        if row.signal not in FORCES:
            assert found.rmse[row.signal] <= row.error_ekf[number]


@pytest.mark.parametrize("manoeuvre", FRICTION)
def test_on_the_full_car_the_spi_finds_the_same_and_longitudinal_forces_better(results, full, manoeuvre):
    simplified, found = results[manoeuvre, "SPI_EKF", 4], full[manoeuvre, "full_SPI_EKF", 4]
    for force, limit in zip(FORCES, (5.0, 6.0, 5.0), strict=True):
        assert found.percent[force] <= limit
    assert found.percent[FORCES[0]] < simplified.percent[FORCES[0]]
    (mass, mass_deviation), (friction, friction_deviation) = found.parameters.values()
    assert mass == pytest.approx(600.0, rel=0.02)
    assert friction == pytest.approx(FRICTION[manoeuvre], abs=0.03)
    assert abs(mass - 600.0) < 4 * mass_deviation
    assert abs(friction - FRICTION[manoeuvre]) < 3 * friction_deviation
    assert found.percent[FORCES[1]] < 0.5 * full[manoeuvre, "full_errorEKF", 4].percent[FORCES[1]]


@pytest.mark.parametrize("manoeuvre", FRICTION)
def test_force_estimation_is_worth_its_states(results, manoeuvre):
    for force in FORCES:
        assert results[manoeuvre, "errorEKF", 4].percent[force] < results[manoeuvre, "DEKF", 4].percent[force]


def test_the_tables_stand_beside_his_and_in_a_file(results, full, tmp_path):
    text = io.StringIO()
    show(results | full, Console(file=text, width=160))
    for word in ("thesis SPI", "28.3", "SPI_EKF", "full_SPI_EKF", "600"):
        assert word in text.getvalue()
    write(results | full, tmp_path / "out" / "thesis.json")
    content = json.loads((tmp_path / "out" / "thesis.json").read_text(encoding="utf-8"))
    assert set(content) == {"manoeuvre_1", "manoeuvre_2"}
    for manoeuvre in content.values():
        assert set(manoeuvre) == {"errorEKF", *SPI, "full_errorEKF", "full_SPI_EKF"}
        for kind, steps in manoeuvre.items():
            assert set(steps) == ({"4ms"} if kind.startswith("full") else {"4ms", "8ms"})
    one = content["manoeuvre_2"]["SPI_EKF"]["4ms"]
    assert one["fx_percent"] == results["rodriguez_2", "SPI_EKF", 4].percent["wheel_force_rr_x"]
    assert set(one) == {
        *("fx_percent", "fy_percent", "fz_percent", "position_rmse_m", "mass_kg", "friction", "step_us_median")
    }


def test_what_the_filter_takes_the_model_to_lack_is_no_less_than_it_does(plant, model):
    """In a manoeuvre that is not one of the two, with the right mass and friction."""
    manoeuvre = MANOEUVRES_BY_NAME["sine_with_dwell"]
    q, u = rolling_straight(plant, manoeuvre.speed)
    car = simulate_full_car(plant, manoeuvre.driver(plant), manoeuvre.duration, step=0.002, keep_every=5, q=q, u=u)
    right = {name: plant.values()[name] for name in PARAMETERS}
    known = model.with_parameters(right)
    rows = slice(20, None)
    count = len(car.t[rows])
    dynamics = model_functions(car_of(known))["dynamics"].map(count)
    memory = np.zeros((car_of(known).internal_state.numel(), 1))
    state = (car.q[rows].T, car.u[rows].T, np.zeros((14, 1)), np.zeros((7, 1)), car.inputs[rows].T)
    explained = np.array(dynamics(*state, known.parameter_vector(), memory)[0]).T
    lacking = np.sqrt(np.mean((car.udot[rows] - explained) ** 2, axis=0))[:10]
    believed = [LEFT.longitudinal, LEFT.lateral, LEFT.vertical, LEFT.roll, LEFT.pitch, LEFT.yaw] + [LEFT.suspension] * 4
    assert (lacking <= believed).all()
