"""Functions in lanes are the functions that CasADi evaluates, and runs side by side are those of each car alone."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros import codegen
from vsense_ros.codegen import rows, simd
from vsense_ros.codegen.rows import OfRows
from vsense_ros.mismatch.prediction_settings import PREDICTION
from vsense_ros.model.car.car import car_of
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import INPUTS
from vsense_ros.model.effects import Effects
from vsense_ros.model.effects.sloshing_load import SloshingLoad
from vsense_ros.model.effects.tyre_heating import TyreHeating
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop, Run

pytestmark = pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")

NUMBERS = st.floats(-3.0, 3.0).filter(lambda x: abs(x) > 1e-3)
# Calls a function on plain arrays: lanes may want addresses that numpy does not give.
CALLER = """
const long long lanes_at_once = LANES;
void call(const double *x, double *y) {
    lanes in_0[4], out_0[COUNT], work[EVERY_WORK + 1];
    const lanes *in[1] = {in_0};
    lanes *out[1] = {out_0};
    memcpy(in_0, x, sizeof in_0);
    every(in, out, work);
    memcpy(y, out_0, sizeof out_0);
}
"""


def every_operation() -> ca.Function:
    """(4) → results of all that a car's equations may be made of."""
    x = ca.SX.sym("x", 4)
    a, b, c, d = ca.vertsplit(x)
    results = [
        a + b, a - b, a * b, a / b, c / b, 1 / a, -a, a**2, 2 * a, ca.fabs(a), ca.sign(a), ca.fmin(a, b), ca.fmax(a, b),
        a < b, a <= a, a >= b, ca.eq(a, a), ca.ne(a, b), ca.logic_not(a < 0), ca.logic_and(a < b, c < d),
        ca.logic_or(a < b, c < d), ca.if_else(a < b, c, d), ca.if_else(a < 0, ca.sqrt(-a), ca.sqrt(a)), ca.sin(a),
        ca.cos(a), ca.tan(a / 3), ca.asin(a / 4), ca.acos(a / 4), ca.atan(a), ca.atan2(a, b), ca.sinh(a), ca.cosh(a),
        ca.tanh(a), ca.exp(a), ca.log(ca.fabs(a)), ca.fabs(a) ** b, ca.fabs(a) ** 2.5, ca.fmin(a, ca.inf),
    ]  # fmt: skip
    return ca.Function("every", [x], [ca.vertcat(*results)])


def called(function: ca.Function, x: np.ndarray) -> np.ndarray:
    """(lanes, results) of arguments (as many as there are lanes at least, 4)."""
    count = function.size1_out(0)
    source = "\n".join((simd.source([function]), f"#define COUNT {count}", CALLER))
    built = codegen.library("every", source)
    library = ctypes.CDLL(str(built))
    width = ctypes.c_longlong.in_dll(library, "lanes_at_once").value
    given, found = np.ascontiguousarray(x[:width].T), np.zeros((count, width))
    library.call(given.ctypes.data_as(ctypes.c_void_p), found.ctypes.data_as(ctypes.c_void_p))
    return found.T


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), min_size=8, max_size=8))
def test_each_lane_has_what_casadi_makes_of_its_arguments(rows):
    x = np.array(rows)
    function = every_operation()
    found = called(function, x)
    expected = [np.array(function(row))[:, 0] for row in x[: len(found)]]
    assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("part", [1, 3, 20])
def test_a_function_in_parts_is_the_whole_function(monkeypatch, part):
    x = np.random.default_rng(1).uniform(-3, 3, (8, 4))
    whole = called(every_operation(), x)
    monkeypatch.setattr(simd, "PART", part)
    assert_allclose(called(every_operation(), x), whole, rtol=1e-14, atol=1e-15)


def test_an_operation_that_lanes_do_not_know_is_refused_by_name():
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="rounded has an operation that lanes do not know"):
        simd.source([ca.Function("rounded", [x], [ca.floor(x)])])
    matrix = ca.MX.sym("m", 2, 2)
    with pytest.raises(ValueError, match="expand it first"):
        simd.source([ca.Function("matrix", [matrix], [matrix @ matrix])])


def driven(vehicle, steps: int, amplitude: float, speed: float = 20.0) -> Run:
    middle = (np.arange(steps) + 0.5) * 0.005
    inputs = np.zeros((steps, len(INPUTS)))
    inputs[:, 0] = amplitude * np.sin(4 * middle)
    return Run(
        *rolling_straight(vehicle, speed), Inputs(0.005, inputs, np.zeros((steps, 7))), vehicle.parameter_vector()
    )


def test_runs_side_by_side_are_those_of_each_car_alone(vehicle):
    loop = OpenLoop(car_of(vehicle))
    heavy = vehicle.with_parameters({"chassis.mass": 2000.0})
    slippery = driven(vehicle, 301, 0.02)
    wet = {"road.friction": np.linspace(0.9, 0.5, 301)}
    runs = [
        *(driven(vehicle, 200 + 37 * i, 0.01 * i, 10.0 + 2 * i) for i in range(9)),
        driven(heavy, 250, 0.03),
        replace(slippery, inputs=replace(slippery.inputs, varying=wet)),
    ]
    for motion, run in zip(loop.runs(runs), runs, strict=True):
        alone = loop.run(run.q, run.u, run.inputs, run.parameters)
        assert np.isfinite(alone.u).all()
        for name in ("t", "q", "u", "udot"):
            assert_allclose(getattr(motion, name), getattr(alone, name), rtol=1e-12, atol=1e-12)


def test_effects_remember_in_each_lane_from_where_a_run_begins_to_where_it_ends(vehicle):
    heating = Effects(tyre_heating=TyreHeating(front=0.01), sloshing_load=SloshingLoad(mass=50.0))
    vehicle = vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": heating})})
    loop, plain = OpenLoop(car_of(vehicle)), OpenLoop(car_of(vehicle))
    plain._compiled = None
    runs = [driven(vehicle, 100 + 31 * i, 0.02 + 0.01 * i) for i in range(3)]
    for run, whole, in_python in zip(runs, loop.runs(runs), plain.runs(runs), strict=True):
        assert_allclose(whole.internal_state, in_python.internal_state, rtol=1e-9, atol=1e-12)
        first = loop.runs([replace(run, inputs=run.inputs.first(60))])[0]
        heat = loop.car.internal_state_slices["tyre_heating"]
        assert (first.internal_state[heat] > 0.0).all()
        assert (first.internal_state[heat] < whole.internal_state[heat]).all()
        warm = loop.runs([replace(run, internal_state=first.internal_state)])[0]
        assert (warm.internal_state[heat] > whole.internal_state[heat] + 0.5 * first.internal_state[heat]).all()


def test_a_car_that_leaves_the_range_of_numbers_stops_alone(vehicle):
    loop = OpenLoop(car_of(vehicle))
    good, bad = driven(vehicle, 200, 0.02), driven(vehicle, 200, 0.02)
    bad.inputs.disturbances[100:, 0] = np.nan
    expected, motion, lost = loop.run(good.q, good.u, good.inputs, good.parameters), *loop.runs([good, bad])
    assert_allclose(motion.u, expected.u, rtol=1e-12, atol=1e-12)
    assert np.isfinite(lost.u[:50]).all()
    assert np.isnan(lost.u[51:]).all()
    assert np.isnan(lost.internal_state).all()


@pytest.mark.parametrize("renew", [8, PREDICTION.renew_every])
def test_a_jacobian_that_is_renewed_seldom_moves_a_run_by_less_than_a_step_of_twice_the_length(vehicle, renew):
    run = driven(vehicle, 400, 0.05)
    every, seldom = (OpenLoop(car_of(vehicle), 2, steps).runs([run])[0] for steps in (1, renew))
    inputs = Inputs(0.01, run.inputs.inputs[::2], run.inputs.disturbances[::2])
    longer = OpenLoop(car_of(vehicle), 1).runs([replace(run, inputs=inputs)])[0]
    for name in ("u", "udot"):
        moved, coarser = (np.abs(getattr(one, name) - getattr(every, name)).max() for one in (seldom, longer))
        assert 0 < moved < 0.5 * coarser


def test_the_loop_without_a_compiler_renews_its_jacobian_as_often(vehicle):
    loop, plain = OpenLoop(car_of(vehicle), 2, 8), OpenLoop(car_of(vehicle), 2, 8)
    plain._compiled = None
    run = driven(vehicle, 60, 0.05)
    held = replace(run.inputs, target=np.full(60, 60.0), gain=np.full((60, 4), 300.0))
    runs = [run, replace(run, inputs=held)]
    for motion, other in zip(loop.runs(runs), plain.runs(runs), strict=True):
        for name in ("q", "u", "udot"):
            assert_allclose(getattr(motion, name), getattr(other, name), rtol=1e-9, atol=1e-9)


def test_runs_with_steps_of_different_lengths_do_not_go_together(vehicle):
    loop, run = OpenLoop(car_of(vehicle)), driven(vehicle, 10, 0.0)
    with pytest.raises(ValueError, match="same length"):
        loop.runs([run, replace(run, inputs=replace(run.inputs, step=0.002))])


def test_a_rolling_car_in_any_lane_is_accelerated_by_gravity_along_its_slope(vehicle):
    loop, runs = OpenLoop(car_of(vehicle)), [driven(vehicle, 400, 0.0) for _ in range(3)]
    for slope, run in zip((0.0, 0.02, 0.04), runs, strict=True):
        run.inputs.disturbances[:, 0] = slope
    motions = loop.runs(runs)
    begin = 100  # the first second: until the car has settled on its slope
    duration = motions[0].t[-1] - motions[0].t[begin]
    level, *sloping = (motion.u[-1, 0] - motion.u[begin, 0] for motion in motions)
    for slope, change in zip((0.02, 0.04), sloping, strict=True):
        assert abs(change - level) == pytest.approx(slope * GRAVITY * duration, rel=0.1)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 30])
@pytest.mark.parametrize("found_compiler", [codegen.compiler, lambda: None])
def test_of_many_rows_each_has_what_casadi_makes_of_it(monkeypatch, found_compiler, count):
    monkeypatch.setattr(rows, "compiler", found_compiler)
    x, size, nothing = ca.SX.sym("x", 4), ca.SX.sym("size"), ca.SX.sym("nothing", 0)
    scaled = ca.Function("scaled", [x, size, nothing], [size * every_operation()(x)], ["x", "size", "nothing"], ["y"])
    numbers = np.random.default_rng(2).uniform(0.1, 3.0, (count, 4))
    expected = [np.array(scaled(row, 0.7, []))[:, 0] for row in numbers]
    assert_allclose(OfRows(scaled, {"size"})(numbers, np.array([0.7]), np.zeros((count, 0))), expected, rtol=1e-12)
