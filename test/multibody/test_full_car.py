"""The car with all its bodies: its size, its rest, its agreement with textbook formulas and with the simplified car."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import ValidationError

from marks import exam_except
from vsense_ros.errors import InputError
from vsense_ros.model.car.corner_mechanism import RACK
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import WHEEL_OUTPUTS, WHEELS
from vsense_ros.model.multibody.integrator import Integrator
from vsense_ros.model.schema.linkage import Linkages
from vsense_ros.model.vehicle import Vehicle

STEP = 0.004  # [s]


@pytest.fixture(scope="module")
def car(vehicle: Vehicle) -> FullCar:
    return FullCar(vehicle)


@pytest.fixture(scope="module")
def driving(car: FullCar, vehicle: Vehicle) -> Callable[..., Integrator]:
    """Makes a car that rolls straight on at a speed [m/s], one at rest by default."""

    def make(speed: float = 0.0, like: Vehicle = vehicle) -> Integrator:
        integrator = car.integrator(like, STEP)
        integrator.state.dz[0] = speed
        for wheel in WHEELS:
            integrator.state.dz[car.spin_index(wheel)] = speed / 0.269
        integrator.settle()
        return integrator

    return make


def steps(integrator: Integrator, seconds: float) -> None:
    for _ in range(round(seconds / STEP)):
        integrator.step()


def tyres(integrator: Integrator) -> dict[str, np.ndarray]:
    """Values of the four wheels for each of `WHEEL_OUTPUTS`."""
    return dict(zip(WHEEL_OUTPUTS, integrator.outputs().reshape(4, len(WHEEL_OUTPUTS)).T, strict=True))


def changed(vehicle: Vehicle, axle: str, **parts: object) -> Vehicle:
    """A vehicle with other values in the linkage of an axle; dotted names with __ for the dot."""
    assert vehicle.linkage is not None
    data = vehicle.linkage.model_dump()
    for dotted, value in parts.items():
        *path, leaf = dotted.split("__")
        node = data[axle]
        for part in path:
            node = node[part]
        node[leaf] = value
    return vehicle.model_copy(update={"linkage": Linkages.model_validate(data)})


def test_it_has_29_bodies_56_coordinates_42_constraints_and_by_rank_14_degrees_of_freedom(
    car: FullCar, vehicle: Vehicle
):
    for rack in (-0.03, 0.0, 0.02):
        counts = car.counts(car.parameters(vehicle), rack)
        assert (counts.bodies, counts.coordinates, counts.constraints) == (29, 56, 42)
        assert counts.degrees_of_freedom == 14
    assert car.mechanism.guides == (RACK,)


def test_the_constraints_of_the_whole_car_leave_14_directions_free(driving: Callable[..., Integrator]):
    *_, jacobian = driving().dynamics()
    assert jacobian.shape == (42, 56)
    assert np.linalg.matrix_rank(jacobian) == 42


def test_the_whole_car_has_the_mass_and_the_inertia_of_the_vehicle_file(
    driving: Callable[..., Integrator], vehicle: Vehicle
):
    mass, *_ = driving().dynamics()
    chassis = vehicle.physics.chassis
    assert_allclose(mass[:3, :3], chassis.mass * np.eye(3), atol=1e-9)
    assert_allclose(mass[:3, 3:6], 0, atol=1e-9)  # the centre of gravity is the origin
    expected = np.diag([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
    assert_allclose(mass[3:6, 3:6], expected, atol=1e-9)


def test_it_rests_in_its_design_position(driving: Callable[..., Integrator], vehicle: Vehicle):
    integrator = driving()
    assert np.abs(integrator.state.ddz).max() < 1e-9
    before = integrator.state.z.copy()
    steps(integrator, 0.4)
    assert_allclose(integrator.state.z, before, atol=1e-9)
    assert_allclose(tyres(integrator)["force_z"].sum(), vehicle.physics.chassis.mass * GRAVITY, rtol=1e-9)


def test_it_sinks_under_a_load_as_wheel_rates_and_tyres_in_series_say(
    driving: Callable[..., Integrator], vehicle: Vehicle
):
    integrator = driving()
    integrator.wrench[5] = -100.0
    steps(integrator, 3.0)
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    sink = []
    for axle, share in (
        (vehicle.physics.front, chassis.cog_to_rear_axle / wheelbase),
        (vehicle.physics.rear, chassis.cog_to_front_axle / wheelbase),
    ):
        series = 1 / (1 / axle.suspension_stiffness + 1 / axle.tyre_stiffness)
        sink.append(100.0 * share / 2 / series)
    at_cog = (sink[0] * chassis.cog_to_rear_axle + sink[1] * chassis.cog_to_front_axle) / wheelbase
    assert_allclose(chassis.cog_height - integrator.state.z[2], at_cog, rtol=0.03)


def test_left_and_right_bends_are_mirror_images(driving: Callable[..., Integrator]):
    ends = []
    for side in (1.0, -1.0):
        integrator = driving(12.0)
        for i in range(200):
            integrator.guides[0, :] = side * 0.008 * min(1.0, i / 50), side * 0.04 * (i < 50), 0
            integrator.step()
        ends.append((integrator.state.copy(), tyres(integrator)))
    (left, left_tyres), (right, right_tyres) = ends
    mirror = np.array([1, -1, 1, -1, 1, -1])
    assert abs(left.z[5]) > 0.1
    assert_allclose(left.z[:6], mirror * right.z[:6], atol=1e-8)
    assert_allclose(left_tyres["force_z"], right_tyres["force_z"][[1, 0, 3, 2]], rtol=1e-6)
    assert_allclose(left_tyres["force_y"], -right_tyres["force_y"][[1, 0, 3, 2]], rtol=1e-6)


def test_constraints_hold_to_a_nanometre_through_a_rough_manoeuvre(car: FullCar, driving: Callable[..., Integrator]):
    integrator = driving(20.0)
    worst = np.zeros(3)
    for i in range(400):
        t = i * STEP
        integrator.guides[0, :] = 0.012 * np.sin(6 * t), 0.072 * np.cos(6 * t), -0.432 * np.sin(6 * t)
        for wheel in WHEELS:
            integrator.inputs[car.input_index(wheel, "torque")] = -150.0 if t > 0.8 else 40.0
        integrator.step()
        _, _, *constraints, _ = integrator.dynamics()
        worst = np.maximum(worst, [np.abs(c).max() for c in constraints])
    assert np.all(worst < [1e-9, 1e-9, 1e-8]), worst
    assert np.ptp(tyres(integrator)["force_z"]) > 200


@pytest.mark.exam
def test_a_shorter_step_changes_little(car: FullCar, vehicle: Vehicle):
    ends = []
    for h in (0.008, 0.004, 0.001):
        integrator = car.integrator(vehicle, h)
        integrator.state.dz[0] = 15.0
        for wheel in WHEELS:
            integrator.state.dz[car.spin_index(wheel)] = 15.0 / 0.269
        integrator.settle()
        for i in range(round(0.8 / h)):
            t = (i + 1) * h
            integrator.guides[0, :] = 0.005 * (1 - np.cos(4 * t)), 0.02 * np.sin(4 * t), 0.08 * np.cos(4 * t)
            integrator.step()
        ends.append(integrator.state.z[:6].copy())
    coarse, fine = (np.abs(end - ends[-1]).max() for end in ends[:2])
    assert fine < 1e-3
    assert fine < 0.5 * coarse


@pytest.mark.parametrize("speed", exam_except([-5.0, 0.0, 0.5], -5.0))
def test_it_rolls_backwards_and_at_walking_pace_and_stands(driving: Callable[..., Integrator], speed: float):
    integrator = driving(speed)
    steps(integrator, 1.0)
    assert abs(integrator.state.dz[0] - speed) < 0.2
    assert_allclose(integrator.state.z[[1, 3, 5]], 0, atol=1e-6)


def test_it_lands_after_a_fall_with_all_wheels_in_the_air(driving: Callable[..., Integrator]):
    integrator = driving()
    integrator.state.z[2] += 0.2
    integrator.settle()
    assert not tyres(integrator)["force_z"].any()
    mass, *_ = integrator.dynamics()
    assert_allclose(
        mass[2] @ integrator.state.ddz, -mass[2, 2] * GRAVITY, rtol=1e-9
    )  # of the whole; springs push inside
    steps(integrator, 3.0)
    assert_allclose(integrator.state.z[2], 0.42, atol=2e-3)


def test_braked_to_a_standstill_with_locked_wheels_it_stays_where_it_is(
    car: FullCar, driving: Callable[..., Integrator]
):
    integrator = driving(6.0)
    for _ in range(round(2.0 / STEP)):
        for wheel in WHEELS:
            spin = integrator.state.dz[car.spin_index(wheel)]
            integrator.inputs[car.input_index(wheel, "torque")] = -600.0 * np.tanh(spin / 4)
        integrator.step()
    assert abs(integrator.state.dz[0]) < 0.3
    assert integrator.state.z[0] < 5.0


def test_a_heavier_car_needs_no_other_code_and_rests_too(driving: Callable[..., Integrator], vehicle: Vehicle):
    heavier = vehicle.with_parameters({"chassis.mass": 700.0})
    integrator = driving(like=heavier)
    assert np.abs(integrator.state.ddz).max() < 1e-9
    assert_allclose(tyres(integrator)["force_z"].sum(), 700.0 * GRAVITY, rtol=1e-9)


def test_a_longer_tie_rod_sets_toe(car: FullCar, vehicle: Vehicle):
    longer = changed(vehicle, "front", tie_rod_length=0.290)
    parameters = car.parameters(longer)
    assert car.counts(parameters).degrees_of_freedom == 14


def test_a_linkage_that_does_not_close_is_refused(car: FullCar, vehicle: Vehicle):
    with pytest.raises(InputError, match=r"linkage 'front' does not close: .*tie rod by"):
        car.parameters(changed(vehicle, "front", tie_rod_length=0.9))


def test_links_that_outweigh_the_hub_are_refused(car: FullCar, vehicle: Vehicle):
    with pytest.raises(InputError, match=r"links and upright together \(hub_mass\) only 11 kg"):
        car.parameters(changed(vehicle, "front", lower__mass=12.0))


def test_a_strut_that_does_not_move_with_the_wheel_is_refused(car: FullCar, vehicle: Vehicle):
    with pytest.raises(InputError, match=r"strut of the rear suspension moves by only 0\.\d+ of the wheel's travel"):
        car.parameters(changed(vehicle, "rear", strut__upper=(0.6, -0.13, -0.1), strut__lower=(-0.02, -0.10, -0.1)))


def test_a_vehicle_without_linkages_is_refused(vehicle: Vehicle):
    with pytest.raises(InputError, match="has no section `linkage`"):
        FullCar(vehicle.model_copy(update={"linkage": None}))


def test_a_link_without_length_is_refused(vehicle: Vehicle):
    with pytest.raises(ValidationError, match="0 mm apart; at least 20 mm"):
        changed(vehicle, "front", tie_rod__outer=(-0.105, -0.352, -0.0739))


def test_links_that_repeat_each_other_are_refused(car: FullCar, vehicle: Vehicle):
    assert vehicle.linkage is not None
    data = vehicle.linkage.model_dump()
    data["rear"]["links"] = [*data["rear"]["links"][:4], data["rear"]["links"][3]]
    with pytest.raises(InputError, match=r"linkage 'rear' has 12 constraints of which only 11 .* link_4 repeats"):
        car.parameters(vehicle.model_copy(update={"linkage": Linkages.model_validate(data)}))
