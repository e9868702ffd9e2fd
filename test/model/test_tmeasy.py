"""Properties that any tyre has, and TMeasy against the formulas of its paper, coded a second time."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pydantic import ValidationError

from vsense_ros.model.parameter import symbols, vector
from vsense_ros.model.tyres import TMeasy, TyreInput


@st.composite
def tyres(draw: st.DrawFn) -> TMeasy:
    """Tyres from a racing car's to a lorry's."""
    number = lambda low, high: draw(st.floats(low, high))  # noqa: E731
    load = number(800, 30000)

    def pair() -> dict[str, Any]:
        maximum, slip = load * number(0.7, 1.6), number(0.05, 0.2)
        slope, sliding, slip_sliding = maximum / slip * number(2.1, 6), maximum * number(0.7, 1), slip * number(2, 6)
        more, wider = number(1.5, 2.0), number(1.0, 1.4)
        nominal = {
            "initial_slope": slope,
            "maximum": maximum,
            "slip_at_maximum": slip,
            "sliding": sliding,
            "slip_at_sliding": slip_sliding,
        }
        double = {
            "initial_slope": slope * more,
            "maximum": maximum * more,
            "slip_at_maximum": slip * wider,
            "sliding": sliding * more,
            "slip_at_sliding": slip_sliding * wider,
        }
        return {"nominal": nominal, "double": double}

    return TMeasy(
        nominal_load=load,
        longitudinal=pair(),
        lateral=pair(),
        pneumatic_trail=number(0, 0.08),
        slip_of_no_trail=number(0.1, 0.6),
        standstill_speed=number(0.05, 1),
    )


_symbols = {name: ca.SX.sym(name) for name in ("load", "speed_x", "speed_y", "rolling_speed", "friction")}


def _function(tyre: TMeasy) -> ca.Function:
    p, symbolic = symbols(tyre)
    results = symbolic.forces(TyreInput(**_symbols))
    return ca.Function("tyre", [p, *_symbols.values()], [ca.vertcat(*results)])


_compiled: list[ca.Function] = []


def forces(
    tyre: TMeasy, load: float, speed_x: float, speed_y: float, rolling_speed: float, friction: float = 1.0
) -> np.ndarray:
    """Force x, force y, moment, slip x, slip y."""
    if not _compiled:
        _compiled.append(_function(tyre))
    return np.asarray(_compiled[0](vector(tyre), load, speed_x, speed_y, rolling_speed, friction))[:, 0]


def at_slip(tyre: TMeasy, load: float, slip_x: float, slip_y: float, friction: float = 1.0) -> np.ndarray:
    """`forces` at 20 m/s of rolling with given slips."""
    transport = np.hypot(20.0, tyre.standstill_speed)
    return forces(tyre, load, 20.0 - slip_x * transport, -slip_y * transport, 20.0, friction)


def oracle(tyre: TMeasy, load: float, slip_x: float, slip_y: float, friction: float) -> tuple[float, float]:
    """Forces by Hirschberg, Rill & Weinfurter 2007, with the direction of the slip as an angle."""
    ratio = min(load / tyre.nominal_load, 2.5)

    def parameters(pair: Any) -> tuple[float, float, float, float, float]:
        near, far = pair.nominal, pair.double
        parabola = [
            np.polyval(np.polyfit([0, 1, 2], [0, getattr(near, name), getattr(far, name)], 2), ratio)
            for name in ("initial_slope", "maximum", "sliding")
        ]
        line = [
            np.interp(ratio, [-8, 12], [a - 9 * (b - a), a + 11 * (b - a)])
            for a, b in (
                (near.slip_at_maximum, far.slip_at_maximum),
                (near.slip_at_sliding, far.slip_at_sliding),
            )
        ]
        return parabola[0], friction * parabola[1], friction * line[0], friction * parabola[2], friction * line[1]

    slope_x, max_x, slip_max_x, slide_x, slip_slide_x = parameters(tyre.longitudinal)
    slope_y, max_y, slip_max_y, slide_y, slip_slide_y = parameters(tyre.lateral)
    hat_x = slip_max_x / (slip_max_x + slip_max_y) + (max_x / slope_x) / (max_x / slope_x + max_y / slope_y)
    hat_y = slip_max_y / (slip_max_x + slip_max_y) + (max_y / slope_y) / (max_x / slope_x + max_y / slope_y)
    direction = np.arctan2(slip_y / hat_y, slip_x / hat_x)
    cosine, sine = np.cos(direction), np.sin(direction)
    s = np.hypot(slip_x / hat_x, slip_y / hat_y)
    slope = np.hypot(slope_x * hat_x * cosine, slope_y * hat_y * sine)
    slip_max = np.hypot(slip_max_x / hat_x * cosine, slip_max_y / hat_y * sine)
    maximum = np.hypot(max_x * cosine, max_y * sine)
    slip_slide = np.hypot(slip_slide_x / hat_x * cosine, slip_slide_y / hat_y * sine)
    sliding = np.hypot(slide_x * cosine, slide_y * sine)
    if s <= slip_max:
        sigma = s / slip_max
        force = slip_max * slope * sigma / (1 + sigma * (sigma + slope * slip_max / maximum - 2))
    elif s <= slip_slide:
        sigma = (s - slip_max) / (slip_slide - slip_max)
        force = maximum - (maximum - sliding) * sigma**2 * (3 - 2 * sigma)
    else:
        force = sliding
    return force * cosine, force * sine


loads = st.floats(0.05, 3.0)  # relative to the nominal load
slips = st.floats(-1.5, 1.5)
frictions = st.floats(0.1, 1.2)
speeds = st.floats(-60, 60)
relaxed = settings(deadline=None, max_examples=60)


@relaxed
@given(tyres(), loads, slips, slips, frictions)
def test_forces_are_those_of_the_paper(tyre: TMeasy, load: float, slip_x: float, slip_y: float, friction: float):
    assume(np.hypot(slip_x, slip_y) > 1e-3)  # below, the model rounds the tip of the slip's length by design
    load *= tyre.nominal_load
    found = at_slip(tyre, load, slip_x, slip_y, friction)
    expected = oracle(tyre, load, slip_x, slip_y, friction)
    assert_allclose(found[:2], expected, rtol=2e-6, atol=1e-5 * load)


@relaxed
@given(tyres(), loads, speeds, speeds, speeds, frictions)
def test_forces_turn_round_with_the_velocities(
    tyre: TMeasy, load: float, speed_x: float, speed_y: float, rolling: float, friction: float
):
    load *= tyre.nominal_load
    x, y, moment, *_ = forces(tyre, load, speed_x, speed_y, rolling, friction)
    left_x, left_y, left_moment, *_ = forces(tyre, load, speed_x, -speed_y, rolling, friction)
    back_x, back_y, back_moment, *_ = forces(tyre, load, -speed_x, speed_y, -rolling, friction)
    near = {"rtol": 1e-12, "atol": 1e-9 * load}
    assert_allclose([left_x, left_y, left_moment], [x, -y, -moment], **near)
    assert_allclose(
        [back_x, back_y, back_moment], [-x, y, -moment], **near
    )  # rolling backwards: the trail changes side


@relaxed
@given(tyres(), loads, speeds, speeds, speeds, frictions)
def test_a_tyre_only_ever_takes_energy_out_of_the_sliding(
    tyre: TMeasy, load: float, speed_x: float, speed_y: float, rolling: float, friction: float
):
    load *= tyre.nominal_load
    x, y, *_ = forces(tyre, load, speed_x, speed_y, rolling, friction)
    assert x * (speed_x - rolling) + y * speed_y <= 1e-9 * load


@relaxed
@given(tyres(), loads, slips, slips, frictions)
def test_the_resultant_stays_within_the_friction_that_the_parameters_allow(
    tyre: TMeasy, load: float, slip_x: float, slip_y: float, friction: float
):
    load *= tyre.nominal_load
    x, y, *_ = at_slip(tyre, load, slip_x, slip_y, friction)
    limits = []
    for pair in (tyre.longitudinal, tyre.lateral):
        parabola = np.polyfit([0, 1, 2], [0, pair.nominal.maximum, pair.double.maximum], 2)
        limits.append(friction * np.polyval(parabola, min(load / tyre.nominal_load, 2.5)))
    assert np.hypot(x, y) <= max(limits) * (1 + 1e-9)


@relaxed
@given(tyres(), st.sampled_from([("nominal", 1), ("double", 2)]), st.sampled_from(["longitudinal", "lateral"]))
def test_one_directional_slip_follows_the_curve_of_the_file(tyre: TMeasy, at: tuple[str, int], direction: str):
    curve = getattr(getattr(tyre, direction), at[0])
    along = np.array([1.0, 0.0]) if direction == "longitudinal" else np.array([0.0, 1.0])
    axis = int(along[1])

    def force(slip: float) -> float:
        return at_slip(tyre, at[1] * tyre.nominal_load, *(slip * along))[axis]

    small = 1e-3 * curve.slip_at_maximum  # large against the rounded tip, small against the curvature
    assert force(small) / small == pytest.approx(curve.initial_slope, rel=1e-2)
    assert force(curve.slip_at_maximum) == pytest.approx(curve.maximum, rel=1e-9)
    assert force(1.01 * curve.slip_at_maximum) <= curve.maximum * (1 + 1e-9)
    assert force(0.99 * curve.slip_at_maximum) < curve.maximum
    assert force(curve.slip_at_sliding) == pytest.approx(curve.sliding, rel=1e-9)
    assert force(2 * curve.slip_at_sliding) == pytest.approx(curve.sliding, rel=1e-9)


@relaxed
@given(tyres(), st.floats(0.05, 1.0), st.sampled_from([(0.02, 0.01), (0.0, 0.001), (0.0, 1e-6), (0.7, 0.4)]))
def test_less_grip_keeps_the_initial_slope_and_shrinks_the_rest(
    tyre: TMeasy, friction: float, slip: tuple[float, float]
):
    load = tyre.nominal_load
    dry, wet = at_slip(tyre, load, *slip), at_slip(tyre, load, *(friction * s for s in slip), friction)
    assert_allclose(wet[:2], friction * dry[:2], rtol=1e-6, atol=1e-9 * tyre.nominal_load)


@relaxed
@given(tyres(), speeds, speeds, speeds, st.floats(-5000, 0))
def test_a_wheel_in_the_air_has_no_force(tyre: TMeasy, speed_x: float, speed_y: float, rolling: float, load: float):
    assert_allclose(forces(tyre, load, speed_x, speed_y, rolling)[:3], 0, atol=1e-12)


@relaxed
@given(tyres(), loads)
def test_a_wheel_at_rest_has_no_force_and_a_finite_slope(tyre: TMeasy, load: float):
    load *= tyre.nominal_load
    function = _function(tyre)
    velocity = ca.vertcat(_symbols["speed_x"], _symbols["speed_y"], _symbols["rolling_speed"])
    p, symbolic = symbols(tyre)
    result = ca.vertcat(*symbolic.forces(TyreInput(**_symbols))[:2])
    jacobian = ca.Function("j", [p, *_symbols.values()], [ca.jacobian(result, velocity)])
    rest = (vector(tyre), load, 0.0, 0.0, 0.0, 1.0)

    assert_allclose(np.asarray(function(*rest))[:, 0], 0, atol=1e-12)
    slope = np.asarray(jacobian(*rest))
    assert np.all(np.isfinite(slope))
    assert slope[0, 0] < 0 < slope[0, 2]
    assert slope[1, 1] < 0
    assert slope[0, 0] == pytest.approx(-slope[0, 2])


@relaxed
@given(tyres(), loads, st.floats(-3.1, 3.1), frictions)
def test_the_force_has_no_jump_along_any_direction_of_slip(tyre: TMeasy, load: float, angle: float, friction: float):
    load *= tyre.nominal_load
    steepest = 4 * max(p.nominal.initial_slope for p in (tyre.longitudinal, tyre.lateral)) * 2.5
    for slip in np.linspace(0.001, 2, 20):
        here = at_slip(tyre, load, slip * np.cos(angle), slip * np.sin(angle), friction)[:2]
        near = at_slip(tyre, load, (slip + 1e-7) * np.cos(angle), (slip + 1e-7) * np.sin(angle), friction)[:2]
        assert np.abs(near - here).max() <= steepest * 1e-7 + 1e-9 * load


def test_a_locked_wheel_slides_against_its_motion_with_the_sliding_force(vehicle):
    tyre = vehicle.physics.front.tyre
    x, y, *_ = forces(tyre, tyre.nominal_load, 20.0, 0.0, 0.0)
    assert (x, y) == pytest.approx((-tyre.longitudinal.nominal.sliding, 0.0), rel=1e-6)


def test_load_pairs_that_turn_negative_within_the_load_range_are_refused(vehicle):
    tyre = vehicle.physics.front.tyre.model_dump()
    tyre["lateral"]["double"]["maximum"] = tyre["lateral"]["double"]["sliding"] = 2000.0
    with pytest.raises(ValidationError, match="must stay positive from no load to"):
        TMeasy.model_validate(tyre)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"initial_slope": 1000.0}, "too flat"),
        ({"sliding": 9e5}, "exceeds maximum"),
        ({"slip_at_sliding": 0.01}, "larger than slip_at_maximum"),
    ],
)
def test_a_curve_without_a_single_maximum_is_refused(vehicle, change, complaint):
    tyre = vehicle.physics.front.tyre.model_dump()
    tyre["lateral"]["nominal"].update(change)
    with pytest.raises(ValidationError, match=complaint):
        TMeasy.model_validate(tyre)
