"""What holds for every effect of the library."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from vsense_ros import mismatch
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model import effects
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import INPUTS, TORQUES, WHEELS
from vsense_ros.model.effects import BY_ID, EVERY, Effects
from vsense_ros.model.effects.unmodelled import Unmodelled
from vsense_ros.model.effects.unmodelled_reading import UnmodelledReading
from vsense_ros.model.sensors import Imu
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop
from vsense_ros.model.vehicle import Vehicle

DURATION, STEP = 6.0, 0.005
PROMISED = [
    "aero_drag",
    "aero_downforce",
    "road_grade",
    "road_bank",
    "rolling_resistance",
    "crosswind",
    "steering_offset",
    "steering_ratio",
    "steering_compliance",
    "roll_steer",
    "toe_compliance",
    "camber_thrust",
    "tyre_conicity",
    "tyre_relaxation",
    "tyre_load_sensitivity",
    "tyre_heating",
    "tyre_underinflation",
    "wheel_radius",
    "friction_change",
    "brake_drag",
    "limited_slip_differential",
    "suspension_friction",
    "bump_stop",
    "payload_offset",
    "sloshing_load",
    "body_roll_in_accelerometer",
    "imu_roll_misalignment",
    "imu_pitch_misalignment",
    "imu_yaw_misalignment",
    "imu_lever_arm",
    "gnss_lever_arm",
    "gyro_bias",
    "gyro_scale",
    "accelerometer_bias",
    "sensor_delay",
]
UNKNOWN = {"unmodelled", "unmodelled_reading"}  # effects without known physics


@pytest.fixture(scope="module")
def bare() -> Vehicle:
    return load_vehicle(vehicle_path("genesis"))


def having(vehicle: Vehicle, effects: Effects) -> Vehicle:
    return vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": effects})})


@pytest.fixture(scope="module")
def full(bare: Vehicle) -> Vehicle:
    """With every effect, all of size zero."""
    return having(bare, Effects(**{id: {} for id in BY_ID}))


def slalom(step: float = STEP) -> Inputs:
    n = round(DURATION / step)
    middle = (np.arange(n) + 0.5) * step
    inputs = np.zeros((n, len(INPUTS)))
    inputs[:, 0] = 0.04 * np.sin(2 * np.pi * 0.5 * middle)
    inputs[:, TORQUES] = 300 * np.cos(2 * np.pi * 0.2 * middle)[:, None]
    return Inputs(step, inputs, np.zeros((n, 7)))


def driven(vehicle: Vehicle, changes: dict[str, float] | None = None, step: float = STEP, keep: int = 2):
    loop = OpenLoop(car_of(vehicle), keep)
    parameters = vehicle.with_parameters(changes or {}).parameter_vector()
    return loop.run(*rolling_straight(vehicle, 25.0), slalom(step), parameters)


def sizes(id: str) -> dict[str, float]:
    """Typical sizes of an effect by dotted parameter name."""
    found = {}
    for name, field in BY_ID[id].model_fields.items():
        extra = field.json_schema_extra
        if extra["role"] == "size":
            found[f"effects.{id}.{name}"] = extra["typical"]
    return found


def test_the_library_has_all_the_effects_that_are_promised():
    assert set(PROMISED) <= set(BY_ID)


def test_every_file_of_the_folder_is_an_effect_of_its_name():
    files = {path.stem for path in Path(effects.__file__).parent.glob("*.py")} - {"__init__", "base"}
    assert set(EVERY) == files
    assert set(BY_ID) == files - UNKNOWN
    assert len(BY_ID) > 30


def test_nothing_that_looks_for_a_mismatch_names_an_effect():
    folder = Path(mismatch.__file__).parent
    literals = {
        (path.name, node.value)
        for path in folder.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert len(literals) > 100
    assert not {(name, text) for name, text in literals if text.removeprefix("effects.").split(".")[0] in BY_ID}


@pytest.mark.slow
def test_effects_of_size_zero_change_nothing(bare, full):
    without, present = driven(bare), driven(full)
    assert_allclose(present.u, without.u, rtol=1e-9, atol=1e-9)
    assert_allclose(present.q, without.q, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("id", sorted(BY_ID))
def test_an_effect_changes_the_motion_or_what_sensors_read(bare, full, id):
    changes = sizes(id)
    with_it = full.with_parameters(changes)
    moved = np.abs(driven(full, changes).u - driven(full).u).max() > 1e-4
    read = with_it.sensing() != full.sensing()
    sloped = getattr(with_it.physics.effects, id).slope(0.0) != (0.0, 0.0)
    assert moved + read + sloped == 1


@pytest.mark.parametrize("id", sorted(BY_ID))
def test_an_effect_names_its_kin_and_explains_itself(id):
    effect = BY_ID[id]
    assert effect.id == id
    assert effect.sentence
    assert set(effect.mistaken_for) <= set(BY_ID) - {id}
    for name, field in effect.model_fields.items():
        extra = field.json_schema_extra
        if extra["role"] == "profile":
            continue
        assert extra["unit"], name
        assert extra["typical"] > 0, name


@pytest.mark.parametrize("id", [i for i in sorted(BY_ID) if i != "tyre_relaxation"])
def test_the_motion_with_an_effect_does_not_depend_on_the_step(full, id):
    changes = sizes(id)
    coarse = driven(full, changes)
    fine = driven(full, changes, step=STEP / 4, keep=8)
    reach = np.abs(fine.u).max(axis=0) + 1e-3
    assert (np.abs(coarse.u - fine.u).max(axis=0) / reach)[[0, 1, 3, 5]].max() < 5e-3


def test_tyre_relaxation_lags_by_its_length_whatever_the_step(full):
    changes = {"effects.tyre_relaxation.front": 0.6, "effects.tyre_relaxation.rear": 0.6}
    coarse = driven(full, changes)
    fine = driven(full, changes, step=STEP / 8, keep=16)
    none = driven(full)
    effect = np.abs(fine.u[:, 5] - none.u[:, 5]).max()
    assert effect > 1e-3
    assert np.abs(coarse.u[:, 5] - fine.u[:, 5]).max() < 0.05 * effect


def test_a_tyre_that_has_lost_pressure_corners_less_by_its_share_of_the_loss(bare):
    soft = having(bare, Effects(tyre_underinflation={"rr": 0.4, "cornering": 0.5}))
    car = car_of(soft)
    side = ca.Function("side", [car.q, car.u, car.disturbances, car.inputs, car.p], [car.wheel_outputs[1, :]])
    q, u = rolling_straight(soft, 20.0)
    u[1] = 0.02  # 1 mrad of side slip: the linear range
    found, as_stiff = (
        np.array(side(q, u, np.zeros(7), np.zeros(len(INPUTS)), soft.with_parameters(changes).parameter_vector()))[0]
        for changes in ({}, {"effects.tyre_underinflation.cornering": 0.0})
    )
    assert found / as_stiff == pytest.approx([1, 1, 1, 1 - 0.5 * 0.4], rel=0.01)


@pytest.mark.parametrize(("slip", "least", "most"), [(0.0, 0.95, 1.05), (0.3, -0.1, 0.25)])
def test_what_a_tyre_pushes_to_one_side_without_slip_fades_where_slip_uses_its_grip(bare, slip, least, most):
    pushing = having(bare, Effects(tyre_conicity={}))
    car = car_of(pushing)
    arguments = [car.q, car.u, car.disturbances, car.inputs, car.p]
    outputs = ca.Function("outputs", arguments, [car.wheel_outputs[[1, 2, 5], :]])
    q, u = rolling_straight(pushing, 20.0)
    u[1] = 20.0 * slip
    changes = {f"effects.tyre_conicity.{wheel}": 0.05 for wheel in WHEELS}
    without, with_it = (
        np.array(outputs(q, u, np.zeros(7), np.zeros(len(INPUTS)), pushing.with_parameters(c).parameter_vector()))
        for c in ({}, changes)
    )
    share = (with_it[0] - without[0]) / (0.05 * without[1])
    assert np.all((share > least) & (share < most))
    assert_allclose(with_it[2], without[2], atol=1e-5)  # the slip angle is where the tyre goes


def test_a_load_swings_as_a_pendulum_on_a_cart_of_whose_mass_it_is_part(bare):
    swinging, omega, share = having(bare, Effects(sloshing_load={"mass": 1.0, "frequency": 4.0})), 4.0, 0.2
    mass = bare.physics.chassis.mass
    car, h = car_of(swinging), 1e-4
    arguments = [car.q, car.u, car.internal_state, car.disturbances, car.inputs, car.p]
    moved = ca.Function("moved", arguments, [car.next_internal_state(ca.SX(h)), ca.sum2(car.wheel_outputs[1:3, :])])
    q, u = rolling_straight(swinging, 20.0)
    parameters = swinging.with_parameters({"effects.sloshing_load.mass": share * mass}).parameter_vector()
    for roll, place in ((0.0, 0.05), (0.03, 0.0)):
        q[3] = roll
        unmoved = np.zeros(7), np.zeros(len(INPUTS))
        after, force = (np.array(x).ravel() for x in moved(q, u, [place, 0.0], *unmoved, parameters))
        # Free on a cart its frequency is that of a fixed pendulum over √(1 - m/M); what holds a tilted body up from
        # below is a force to its side.
        across = (force[0] * np.cos(roll) + force[1] * np.sin(roll)) / mass
        expected = -(omega**2 * place + across) / (1 - share)
        assert after[1] / h == pytest.approx(expected, rel=0.01)


def test_without_a_compiler_a_run_is_the_same(full, monkeypatch):
    changes = sizes("sloshing_load") | sizes("steering_compliance")
    wet = np.linspace(0.0, -0.4, len(slalom()))
    inputs = replace(slalom(), varying={"effects.friction_change.relative": wet, "road.friction": 0.9 + 0 * wet})
    run = (*rolling_straight(full, 25.0), inputs, full.with_parameters(changes).parameter_vector())
    loop = OpenLoop(car_of(full))
    expected = loop.run(*run)
    assert np.abs(expected.u - driven(full, changes).u).max() > 1e-3
    monkeypatch.setattr(loop, "_compiled", None)
    assert_allclose(loop.run(*run).u, expected.u, rtol=1e-8, atol=1e-8)


def test_terms_without_known_physics_push_the_chassis_where_they_say(bare):
    car = car_of(bare)
    terms = Unmodelled(longitudinal_force_constant=300.0, lateral_force_yaw_rate=5000.0, roll_moment_lateral=10.0)
    force = ca.Function(
        "force", [car.q, car.u, car.inputs, car.p], [terms.chassis_force(ca.SX.zeros(6), car, car.internal_state)]
    )
    q, u = rolling_straight(bare, 20.0)
    u[5] = 0.1  # yaw rate, and with it 2 m/s² to the left
    found = np.array(force(q, u, np.zeros(len(INPUTS)), bare.parameter_vector()))[:, 0]
    assert_allclose(found, [20.0, 0, 0, 300.0, 500.0, 0], atol=1e-9)


def test_terms_of_one_suspension_resist_the_compression_of_that_wheel_alone(bare):
    car = car_of(bare)
    terms = Unmodelled(suspension_force_fr_rate=1000.0, suspension_force_fr_travel=20_000.0)
    forces = ca.vertcat(*(terms.suspension_force(ca.SX(0), corner, car) for corner in car.corners))
    q, u = rolling_straight(bare, 20.0)
    q[6:10], u[6:10] = [0.01, 0.02, 0.03, 0.04], [0.1, 0.2, 0.3, 0.4]  # fl, fr, rl, rr
    found = np.array(ca.Function("forces", [car.q, car.u], [forces])(q, u))[:, 0]
    assert_allclose(found, [0, 1000.0 * 0.2 + 20_000.0 * 0.02, 0, 0], atol=1e-9)


def test_terms_between_the_wheels_of_an_axle_take_from_the_left_what_they_give_to_the_right(bare):
    car = car_of(bare)
    terms = Unmodelled(torque_across_rear_steering=2000.0, torque_across_front_lateral=5.0)
    torques = ca.vertcat(*(terms.wheel_torque(car.inputs[1 + i], corner, car) for i, corner in enumerate(car.corners)))
    q, u = rolling_straight(bare, 20.0)
    u[5] = 0.1  # yaw rate, and with it 2 m/s² to the left
    inputs = np.array([0.03, 100.0, 100.0, 50.0, 50.0, 0.0])
    found = np.array(ca.Function("torques", [car.q, car.u, car.inputs], [torques])(q, u, inputs))[:, 0]
    assert_allclose(found, [90.0, 110.0, -10.0, 110.0], atol=1e-9)


def test_terms_of_the_front_wheels_turn_them_by_more_the_further_they_are_steered(bare):
    car = car_of(bare)
    angle = Unmodelled(front_angle_steering_squared=0.5).front_angle(ca.SX(0), car, car.internal_state)
    turned = ca.Function("turned", [car.inputs], [angle])
    for side in (1.0, -1.0):
        assert float(turned([side * 0.1, 0, 0, 0, 0, 0])) == pytest.approx(side * 0.5 * 0.01)


def test_terms_in_readings_add_to_what_is_known_of_that_sensor():
    known = Imu(force_scale=(0.01, 0.0, 0.0), rate_by_force=((0, 0, 0), (0, 0, 0), (0, 0.001, 0.002)))
    sizes = {"accelerometer_x_scale": 0.02, "accelerometer_y_square": 0.003, "gyro_z_by_y": 0.004}
    terms = UnmodelledReading(**sizes, accelerometer_x_odd_square=-0.01)
    found = terms.sensors({"imu": known})["imu"]
    assert found.force_scale == pytest.approx((0.03, 0, 0))
    assert found.force_square == pytest.approx((0, 0.003, 0))
    assert found.force_odd_square == pytest.approx((-0.01, 0, 0))
    assert np.array(found.rate_by_force) == pytest.approx(np.array([[0, 0, 0], [0, 0, 0], [0, 0.005, 0.002]]))
