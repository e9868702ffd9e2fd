"""Which wheels are driven and braked, and what follows for radii and longitudinal forces of wheels."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from vsense_ros.assess.iterations import on_level_road, with_thesis_sensors
from vsense_ros.bag import read_bag
from vsense_ros.bag.importers import import_recording
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.sensing import SENSING, record
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES
from vsense_ros.messages.recording import Recording
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.schema.drivetrain import Drivetrain
from vsense_ros.model.schema.observer_settings import Disturbances
from vsense_ros.model.sensors import WheelSpeeds
from vsense_ros.model.simulation.closed_loop import simulate
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.state import Prior
from vsense_ros.observer.wheel_torques import BRAKING, RELEASED, TorqueErrors
from vsense_ros.runner import run

RAV4 = Path(os.environ.get("VSENSE_DATA", "../shared/recordings")) / "comma2k19_rav4"


def rav4(driven: str | None) -> Vehicle:
    vehicle = load_vehicle("config/vehicles/rav4.yaml")
    return vehicle.model_copy(update={"drivetrain": Drivetrain.model_validate({"driven": driven})})


def forces(output: Recording, axis: int) -> NDArray[np.float64]:
    """Forces of the four wheels along an axis, (n, 4) [N]."""
    return np.stack([output[f"vsense/wheel_force/{w}"].columns["force"][:, axis] for w in WHEELS], axis=1)


def test_a_wheel_that_is_not_driven_has_no_torque_while_the_brakes_are_released() -> None:
    vehicle = rav4("front")
    errors = TorqueErrors.of(vehicle, vehicle.sensing())
    inertia = vehicle.physics.rear.wheel_spin_inertia
    released, braking = np.sqrt(np.diagonal(errors.covariance, axis1=1, axis2=2)) * inertia
    assert released[2:] == pytest.approx(vehicle.drivetrain.free_torque)
    assert min(released[:2].min(), braking.min()) > 10 * released[2]


def test_wheels_of_a_differential_are_driven_alike_and_those_of_other_axles_braked_in_proportion() -> None:
    vehicle = rav4("front")
    errors = TorqueErrors.of(vehicle, vehicle.sensing())
    scale = np.sqrt(np.diagonal(errors.covariance, axis1=1, axis2=2))
    correlation = errors.covariance / (scale[:, :, None] * scale[:, None, :])
    assert correlation[RELEASED, 0, 1] > 0.98
    assert correlation[RELEASED, 0, 2] == 0.0
    assert correlation[BRAKING, 2, 3] > 0.9
    assert 0.3 < correlation[BRAKING, 0, 2] < 1.0


@pytest.mark.parametrize("driven", ["front", "rear", "all", None])
def test_torque_errors_are_a_covariance_and_the_prior_has_them(driven: str | None) -> None:
    vehicle = rav4(driven)
    prior = Prior.of(vehicle, vehicle.sensing())
    for covariance in prior.torques.covariance:
        assert np.linalg.eigvalsh(covariance).min() > 0
    assert np.linalg.eigvalsh(prior.covariance).min() > -1e-9
    assert prior.torques.shares.sum(axis=1) == pytest.approx(0.0 if driven is None else 1.0)


def test_torques_of_a_car_of_which_no_driven_axle_is_known_are_independent() -> None:
    vehicle = rav4(None)
    errors = TorqueErrors.of(vehicle, vehicle.sensing())
    expected = np.diag(np.full(4, vehicle.observer.force_errors.wheel_spin**2))
    assert np.array_equal(errors.covariance, np.array([expected, expected]))


def test_brakes_act_beyond_the_deceleration_by_engine_and_air_on_whatever_slope() -> None:
    vehicle = rav4("front")
    errors = TorqueErrors.of(vehicle, vehicle.sensing())
    udot, u, around = np.zeros(14), np.zeros(14), np.zeros(7)
    u[0] = 20.0
    air = errors.drag * u[0] ** 2
    for grade in (-0.05, 0.0, 0.05):
        around[0] = grade
        for beyond, expected in ((0.1, RELEASED), (-0.1, BRAKING)):
            udot[0] = beyond - air - vehicle.drivetrain.engine_braking - GRAVITY * np.sin(grade)
            assert errors.mode(udot, u, around) == expected
    u[0] = 0.0
    assert errors.mode(udot, u, around) == BRAKING


def test_radii_of_wheels_differ_by_a_share_of_what_they_err_in_common_unless_the_file_says_else() -> None:
    around = Disturbances(radius_error=0.01, radius_error_drift=1e-5)
    by_default = WheelSpeeds().of_surroundings(around).biases()
    assert [(b.name, b.deviation, b.drift) for b in by_default] == [
        (f"radius_error_{w}", pytest.approx(0.003), pytest.approx(3e-6)) for w in WHEELS
    ]
    assert WheelSpeeds(radius_error=0.02).of_surroundings(around).biases()[0].deviation == 0.02
    assert WheelSpeeds().of_surroundings(Disturbances(radius_error=0.0)).biases() == ()


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.004, 1.004), (1.0, 1.004, 1.0, 1.0)])
def test_the_radius_of_each_wheel_is_found_and_leaves_free_wheels_without_force(scale: tuple[float, ...]) -> None:
    """The bag's car is driven at the rear; wheels that turn slower are larger."""
    recording = read_bag(Path("bags/double_lane_change"))
    channel = recording["vehicle/wheel_speeds"]
    channel.columns["velocity"] = channel.columns["velocity"] / np.array(scale)
    vehicle = load_vehicle("config/vehicles/prototype_real.yaml")
    vehicle = vehicle.model_copy(update={"drivetrain": Drivetrain(driven="rear")})
    result = run(recording, vehicle)
    found = np.array([result.parameters[f"wheel_speeds.radius_error_{w}"][0] for w in WHEELS])
    assert found - found.mean() == pytest.approx(np.array(scale) - np.mean(scale), abs=1e-3)


@pytest.mark.skipif(not RAV4.exists(), reason="no recordings")
def test_undriven_wheels_of_the_rav4_roll_freely_at_constant_speed_and_forces_add_up() -> None:
    output = run(import_recording(RAV4), load_vehicle("config/vehicles/rav4.yaml")).output
    along, time = forces(output, 0), (output["vsense/odometry"].stamp - output["vsense/odometry"].stamp[0]) * 1e-9
    acceleration = output["vsense/acceleration"].columns["linear"][:, 0]
    on_slope = acceleration + GRAVITY * np.sin(output["vsense/road"].columns["vector"][:, 0])
    constant = (np.abs(on_slope) < 0.25) & (time > 10)
    assert constant.sum() > 500
    assert np.all((along[constant, 2:] > -150) & (along[constant, 2:] < 0))
    speed = output["vsense/odometry"].columns["linear"][:, 0]
    vehicle = load_vehicle("config/vehicles/rav4.yaml")
    drag = 0.5 * AIR_DENSITY * vehicle.physics.aerodynamics.drag_area * speed**2
    needed = vehicle.physics.chassis.mass * on_slope + drag
    hard = np.abs(on_slope) > 0.6
    assert along[hard].sum(axis=1) == pytest.approx(needed[hard], rel=0.03)


def test_where_torques_are_measured_the_forces_of_wheels_are_right_though_the_file_has_a_wrong_mass() -> None:
    """Newton's law for the true car, pushed for three seconds along a level road; its observer has 100 kg more."""
    plant = with_thesis_sensors(load_vehicle("config/vehicles/prototype_real.yaml"))
    heavier = plant.with_parameters({"chassis.mass": plant.physics.chassis.mass + 100.0})
    heavier = heavier.model_copy(update={"drivetrain": Drivetrain(driven="rear")})
    trajectory = simulate(plant, MANOEUVRES[0].driver(plant), 3.0, step=1e-3)
    recording = record(trajectory, plant, 0, name="push", biased=False)
    output = run(recording, on_level_road(heavier, 4)).output
    pushing = output["vsense/odometry"].stamp > SENSING.epoch + 2_000_000_000
    drag = 0.5 * AIR_DENSITY * plant.physics.aerodynamics.drag_area * trajectory.u[2000:, 0] ** 2
    needed = (plant.physics.chassis.mass * trajectory.udot[2000:, 0] + drag).mean()
    assert forces(output, 0)[pushing].sum(axis=1).mean() == pytest.approx(needed, rel=0.03)
