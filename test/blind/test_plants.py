"""The plants asked about physics that has closed forms, and about each other."""

from __future__ import annotations

import ast
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind import cars, courses, knobs
from blind.cars import CARS, GRAVITY
from blind.driver import Drivers
from blind.physics import road, state
from blind.physics.actions import actions
from blind.plants import mujoco_tree, newton_euler
from blind.tyres import FORMULAS
from marks import exam_except

PLANTS = {"newton_euler": newton_euler.simulate, "mujoco_tree": mujoco_tree.simulate}


def _drive(plant: str, lanes, formula: str = "brush", hidden=None):
    batch = cars.side_by_side([car for car, _ in lanes])
    values = knobs.side_by_side(hidden or [{} for _ in lanes])
    return PLANTS[plant](batch, values, [course for _, course in lanes], FORMULAS[formula])


@pytest.mark.parametrize("folder", ["plants", "physics", "tyres"])
def test_a_plant_shares_nothing_with_the_tool(folder):
    modules = sorted((Path(cars.__file__).parent / folder).glob("*.py"))
    assert modules
    for module in modules:
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.startswith("vsense_ros")], module.name


@pytest.mark.exam
@pytest.mark.parametrize(("plant", "formula"), [("newton_euler", "brush"), ("mujoco_tree", "dugoff")])
def test_at_low_lateral_acceleration_each_plant_turns_as_the_single_track_car_does(plant, formula):
    lanes = [(car, courses.constant_turn(20.0, 0.5, 4.0)) for car in CARS]
    log = _drive(plant, lanes, formula)
    for i, (car, course) in enumerate(lanes):
        end = {name: v[-1] for name, v in log.lane(i, course.duration).items()}
        # The lateral forces act behind the axles by the pneumatic trail.
        ahead, behind = car.front_arm - car.front.trail, car.rear_arm + car.rear.trail
        stiffness = []
        for axle, far in ((car.front, car.rear_arm), (car.rear, car.front_arm)):
            ratio = car.mass * GRAVITY * far / car.wheelbase / 2 / axle.nominal_load
            stiffness.append(2 * axle.cornering * ratio * (1 + axle.stiffness_fall) / (1 + axle.stiffness_fall * ratio))
        gradient = car.mass / (ahead + behind) * (behind / stiffness[0] - ahead / stiffness[1])
        speed = end["velocity"][0]
        expected = speed * end["handwheel"][0] / car.ratio / (car.wheelbase + gradient * speed**2)
        assert end["rates"][2] == pytest.approx(expected, rel=0.02)


@pytest.mark.exam
def test_two_plants_that_share_no_dynamics_agree():
    lanes = [(CARS[i], course) for i, course in enumerate([
        replace(courses.steering_sweep(22.0, 2.5), duration=4.0),
        replace(courses.slalom(19.0, 5.0), duration=4.0),
        replace(courses.brake_in_turn(20.0, 3.0, 2.5), duration=5.0),
    ])]  # fmt: skip
    one, other = (_drive(plant, lanes, "magic_formula_1989") for plant in PLANTS)
    for i, (_, course) in enumerate(lanes):
        a, b = one.lane(i, course.duration), other.lane(i, course.duration)
        for name in ("velocity", "rates", "force", "spin", "travel"):
            spread = np.sqrt(np.mean((a[name] - a[name].mean(axis=0)) ** 2, axis=0))
            assert np.all(np.sqrt(np.mean((a[name] - b[name]) ** 2, axis=0)) < 0.03 * spread.max()), (i, name)


@pytest.mark.parametrize("plant", exam_except(PLANTS, "mujoco_tree"))
def test_a_car_on_level_ground_runs_straight_and_keeps_its_height(plant):
    log = _drive(plant, [(car, replace(courses.coast_down(25.0), duration=0.6)) for car in CARS])
    for i, car in enumerate(CARS):
        lane = log.lane(i, 0.6)
        assert np.all(np.abs(lane["position"][:, 1]) < 1e-4)
        assert np.all(np.abs(lane["position"][:, 2] - car.cog_height) < 2e-3)
        weight = lane["load"].sum(axis=1)
        assert weight == pytest.approx(car.mass * GRAVITY, rel=0.01)
        slowing = -np.gradient(lane["velocity"][:, 0], 0.005)[60:].mean()
        drag = 0.5 * 1.204 * car.drag_area * 25.0**2
        rolling = car.mass * GRAVITY * car.front.rolling_resistance
        spins = 2 * (car.front.spin_inertia / car.front.radius**2 + car.rear.spin_inertia / car.rear.radius**2)
        assert slowing == pytest.approx((drag + rolling) / (car.mass + spins), rel=0.05)


def test_a_car_that_spins_freely_without_any_force_keeps_momentum_and_energy():
    car = cars.side_by_side([CARS[1]])
    plant = newton_euler._Plant(car, knobs.side_by_side([{}]), FORMULAS["brush"])
    zero3, zero4 = np.zeros((3, 4, 1)), np.zeros((4, 1))

    def forceless(car, knobs, motion, extra, command, acceleration, formula):
        centre = car.centre + car.guide * motion.travel
        lift = np.zeros((3, 4, 1))
        lift[:] = car.unsprung * GRAVITY * motion.rotation[2][:, None]  # weight is cancelled body by body
        axle = np.zeros((3, 4, 1))
        axle[1] = 1
        body = plant.body_mass * GRAVITY * motion.rotation[2]
        about = np.cross(plant.first / plant.body_mass, body, axis=0)
        return SimpleNamespace(
            point=centre, centre=centre, force=lift, moment=zero3, spin_torque=zero4, axle_torque=zero4,
            strut=car.spring * motion.travel, body_force=body, body_moment=about, rate=np.zeros_like(extra),
            told=zero4, contact=SimpleNamespace(axle=axle),
        )  # fmt: skip

    original, newton_euler.actions = newton_euler.actions, forceless
    try:
        x = plant.start(np.array([3.0]))
        x[newton_euler.RATES, 0] = 0.8, -0.5, 1.1
        x[newton_euler.TRAVEL, 0] = 0.02, -0.01, 0.015, 0.0
        step = 0.001

        def energy(x):
            m = plant.motion(x, None)
            wheels = car.centre + car.guide * m.travel
            turn = np.broadcast_to(m.rates[:, None], wheels.shape)
            speed = m.velocity[:, None] + np.cross(turn, wheels, axis=0) + car.guide * m.travel_rate
            inertia = np.einsum("in,ijn,jn->n", m.rates, plant.inertia, m.rates)
            linear = plant.body_mass * (m.velocity**2).sum(axis=0)
            mixed = 2 * (m.velocity * np.cross(m.rates, plant.first, axis=0)).sum(axis=0)
            own = car.diametral_inertia * (m.rates[0] ** 2 + m.rates[2] ** 2)
            own = own + car.spin_inertia * (m.spin + m.rates[1]) ** 2
            moving = (car.unsprung * (speed**2).sum(axis=0) + own).sum(axis=0)
            return 0.5 * (inertia + linear + mixed + moving + (car.spring * m.travel**2).sum(axis=0))[0]

        before = energy(x)
        for _ in range(400):
            k1 = plant.derivative(x, None, None, None)[0]
            k2 = plant.derivative(x + step / 2 * k1, None, None, None)[0]
            k3 = plant.derivative(x + step / 2 * k2, None, None, None)[0]
            k4 = plant.derivative(x + step * k3, None, None, None)[0]
            x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        assert energy(x) == pytest.approx(before, rel=1e-8)
    finally:
        newton_euler.actions = original


def test_what_turns_a_wheel_is_the_moment_about_its_axle_of_all_that_the_road_does_to_it():
    car = cars.side_by_side(list(CARS))
    plant = newton_euler._Plant(car, knobs.side_by_side([{} for _ in CARS]), FORMULAS["brush"])
    x = plant.start(np.array([20.0, 25.0, 30.0]))
    x[newton_euler.ANGLES] = np.array([[0.01], [0.0], [0.4]])
    x[newton_euler.VELOCITY][1] = -0.8
    x[newton_euler.RATES][2] = 0.3
    x[newton_euler.SPIN] *= 1.01
    path = SimpleNamespace(x=0.0, y=0.0, heading=0.0, along=0.0, surface=SimpleNamespace(rms=np.zeros(3)))
    command = SimpleNamespace(handwheel=np.zeros(3), acceleration=np.zeros(3))
    act = actions(
        car, plant.knobs, plant.motion(x, path), x[newton_euler.EXTRA], command, np.zeros((3, 3)), plant.formula
    )
    moment = np.cross(act.point - act.centre, act.force, axis=0) + act.moment
    assert np.abs(act.force_y).min() > 300
    assert act.spin_torque == pytest.approx((moment * act.contact.axle).sum(axis=0))


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_tyre_has_its_stiffness_at_zero_slip_and_its_friction_at_large_slip(formula):
    car = cars.side_by_side(list(CARS))
    force = FORMULAS[formula]
    load, grip, none = car.nominal_load, np.ones((4, 1)), np.zeros((4, 3))
    small = 1e-4
    assert force(car, none + small, none, load, grip)[0] / small == pytest.approx(car.slip_stiffness, rel=0.01)
    assert force(car, none, none + small, load, grip)[1] / small == pytest.approx(car.cornering, rel=0.01)
    slips = np.linspace(0.01, 0.4, 80)
    largest = np.max([force(car, none, none + s, load, grip)[1] for s in slips], axis=0)
    assert largest == pytest.approx(car.friction_y * load, rel=0.15)  # Dugoff's friction falls with slip
    for kappa in (-0.3, -0.05, 0.05, 0.3):
        for alpha in (-0.2, 0.03, 0.2):
            x, y = force(car, none + kappa, none + alpha, load, grip)
            assert np.all(np.sign(x) == np.sign(kappa))
            assert np.all(np.sign(y) == np.sign(alpha))
            assert np.all(np.hypot(x / car.friction_x, y / car.friction_y) < 1.03 * load)
            mirrored = force(car, none + kappa, none - alpha, load, grip)
            assert mirrored[1] == pytest.approx(-y)


def test_states_beside_the_bodies_do_not_overlap():
    rows = sorted((p.start, p.stop) for p in state.PLACES.values())
    assert rows[0][0] == 0
    assert rows[-1][1] == state.SIZE
    assert all(a[1] == b[0] for a, b in pairwise(rows))


def test_the_slope_of_a_road_is_the_derivative_of_its_height():
    hidden = knobs.side_by_side([{"grade": 0.03, "bank": -0.04, "undulation": 0.005}])
    along, across, step = np.linspace(0, 400, 50)[:, None], 3.0, 1e-4
    grade, bank = road.slopes(hidden, along, across)
    change = road.height(hidden, along + step, across) - road.height(hidden, along - step, across)
    assert grade == pytest.approx(change / (2 * step), abs=1e-7)
    change = road.height(hidden, along, across + step) - road.height(hidden, along, across - step)
    assert bank == pytest.approx(change / (2 * step), abs=1e-7)


def test_an_uneven_road_has_the_roughness_that_is_asked_for():
    course = replace(courses.coast_down(20.0), roughness=0.002, seed=7)
    surface = Drivers(cars.side_by_side([CARS[0]]), [course]).surface
    height = road.roughness(surface, np.linspace(0, 40_000, 400_000)[:, None, None] * np.ones((4, 1)))
    assert height.std(axis=0)[0] == pytest.approx(0.002, rel=0.02)
    assert np.all(height[:, 0] == height[:, 2])
    assert np.any(height[:, 0] != height[:, 1])
