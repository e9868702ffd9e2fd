"""The Magic Formula against its equations, coded a second time in plain numbers, and against published properties."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pydantic import ValidationError

from bench import TYRES, forces, relaxation_lengths
from vsense_ros.model.parameter import numbers, with_values
from vsense_ros.model.tyres import MagicFormula
from vsense_ros.model.tyres.magic_formula_coefficients import AXIS_DEPENDENT, adapted_sae_to_iso

relaxed = settings(deadline=None, max_examples=150)
VERSIONS = ("pacejka_2006_205_60r15", "pacejka_2012_205_60r15", "mf52")


def coefficients(tyre: MagicFormula) -> dict[str, float]:
    return {name.rsplit(".", 1)[-1].upper(): value for name, value in numbers(tyre)}


def oracle(k: dict[str, float], version: float, load: float, kappa: float, alpha: float, gamma: float, v: float):
    """Fx, Fy, Mz by Pacejka 2012, eqs. 4.E1 to 4.E78, in the axes of the coefficients; alpha is an angle."""
    c = SimpleNamespace(**k)
    mf6 = version > 6
    fz0 = c.LFZO * c.NOMINAL_LOAD
    df, dp = (load - fz0) / fz0, c.INFLATION_PRESSURE / c.NOMINAL_PRESSURE - 1
    a = math.tan(alpha) if mf6 else alpha
    g = math.sin(gamma) if mf6 else gamma
    gx, gy, gz = g * c.LGAX, g * c.LGAY, g * c.LGAZ

    vsx, vsy = -kappa * abs(v), math.tan(alpha) * abs(v)
    slowdown = 1 + c.LMUV * math.hypot(vsx, vsy) / c.REFERENCE_SPEED
    lmux, lmuy = c.LMUX / slowdown, c.LMUY / slowdown
    cosine = v / math.hypot(v, vsy)

    def curve(b, e, x):
        return b * x - e * (b * x - math.atan(b * x))

    def signum(x):
        return (x > 0) - (x < 0)

    # pure longitudinal slip
    kx = load * (c.PKX1 + c.PKX2 * df) * math.exp(c.PKX3 * df) * (1 + c.PPX1 * dp + c.PPX2 * dp**2) * c.LKX
    mux = (c.PDX1 + c.PDX2 * df) * (1 + c.PPX3 * dp + c.PPX4 * dp**2) * (1 - c.PDX3 * gx**2) * lmux
    dx, cx = mux * load, c.PCX1 * c.LCX
    bx, x = kx / (cx * dx), kappa + (c.PHX1 + c.PHX2 * df) * c.LHX
    ex = min((c.PEX1 + c.PEX2 * df + c.PEX3 * df**2) * (1 - c.PEX4 * signum(x)) * c.LEX, 1)
    fx0 = dx * math.sin(cx * math.atan(curve(bx, ex, x))) + load * (c.PVX1 + c.PVX2 * df) * c.LVX * lmux

    # pure lateral slip
    def lateral(gy):
        ky = c.PKY1 * fz0 * (1 + c.PPY1 * dp) * (1 - c.PKY3 * abs(gy)) * c.LKY
        ky *= math.sin(c.PKY4 * math.atan(load / fz0 / ((c.PKY2 + c.PKY5 * gy**2) * (1 + c.PPY2 * dp))))
        muy = (c.PDY1 + c.PDY2 * df) * (1 + c.PPY3 * dp + c.PPY4 * dp**2) * (1 - c.PDY3 * gy**2) * lmuy
        svg = load * (c.PVY3 + c.PVY4 * df) * gy * c.LKYC * lmuy
        kg = load * (c.PKY6 + c.PKY7 * df) * (1 + c.PPY5 * dp) * c.LKYC
        shift = (kg * gy - svg) / ky if mf6 else c.PHY3 * gy * c.LKYC
        sh = (c.PHY1 + c.PHY2 * df) * c.LHY + shift
        sv = load * (c.PVY1 + c.PVY2 * df) * c.LVY * lmuy + svg
        y, cy, dy = a + sh, c.PCY1 * c.LCY, muy * load
        e = (c.PEY1 + c.PEY2 * df) * (1 + c.PEY5 * gy**2 - (c.PEY3 + c.PEY4 * gy) * signum(y)) * c.LEY
        by = ky / (cy * dy)
        return dy * math.sin(cy * math.atan(curve(by, min(e, 1), y))) + sv, ky, muy, by * cy, sh + sv / ky

    fy0, ky, muy, bycy, shf = lateral(gy)

    # combined slip
    ex = min(c.REX1 + c.REX2 * df, 1)
    bx = (c.RBX1 + c.RBX3 * g**2) * math.cos(math.atan(c.RBX2 * kappa)) * c.LXAL
    gxa = math.cos(c.RCX1 * math.atan(curve(bx, ex, a + c.RHX1))) / math.cos(c.RCX1 * math.atan(curve(bx, ex, c.RHX1)))
    fx = max(gxa, 0) * fx0
    ey, sh = min(c.REY1 + c.REY2 * df, 1), c.RHY1 + c.RHY2 * df
    by = (c.RBY1 + c.RBY4 * gy**2) * math.cos(math.atan(c.RBY2 * (a - c.RBY3))) * c.LYKA
    gyk = math.cos(c.RCY1 * math.atan(curve(by, ey, kappa + sh))) / math.cos(c.RCY1 * math.atan(curve(by, ey, sh)))
    gyk = max(gyk, 0)
    dv = muy * load * (c.RVY1 + c.RVY2 * df + c.RVY3 * gy) * math.cos(math.atan(c.RVY4 * a))
    sv = dv * math.sin(c.RVY5 * math.atan(c.RVY6 * kappa)) * c.LVYKA
    fy = gyk * fy0 + sv

    # aligning moment
    at, ar = a + c.QHZ1 + c.QHZ2 * df + (c.QHZ3 + c.QHZ4 * df) * gz, a + shf
    at_eq, ar_eq = (math.sqrt(x**2 + (kx / ky * kappa) ** 2) * signum(x) for x in (at, ar))
    bt = (c.QBZ1 + c.QBZ2 * df + c.QBZ3 * df**2) * (1 + c.QBZ4 * gz + c.QBZ5 * abs(gz)) * c.LKY / lmuy
    dt = load * (c.QDZ1 + c.QDZ2 * df) * (1 - c.PPZ1 * dp) * (1 + c.QDZ3 * gz + c.QDZ4 * gz**2)
    dt *= c.UNLOADED_RADIUS / c.NOMINAL_LOAD * c.LTR
    et = (c.QEZ1 + c.QEZ2 * df + c.QEZ3 * df**2) * (
        1 + (c.QEZ4 + c.QEZ5 * gz) * 2 / math.pi * math.atan(bt * c.QCZ1 * at)
    )
    t = dt * math.cos(c.QCZ1 * math.atan(curve(bt, min(et, 1), at_eq))) * cosine
    br = c.QBZ9 * c.LKY / lmuy + c.QBZ10 * bycy
    by_camber = (c.QDZ8 + c.QDZ9 * df) * (1 + c.PPZ2 * dp) + (c.QDZ10 + c.QDZ11 * df) * abs(gz)
    dr = load * c.UNLOADED_RADIUS * ((c.QDZ6 + c.QDZ7 * df) * c.LRES + by_camber * gz * c.LKZC) * lmuy * cosine
    s = c.UNLOADED_RADIUS * (c.SSZ1 + c.SSZ2 * fy / c.NOMINAL_LOAD + (c.SSZ3 + c.SSZ4 * df) * gz) * c.LS
    trailing = gyk * lateral(0.0)[0] if mf6 else fy - sv
    return np.array([fx, fy, dr * math.cos(math.atan(br * ar_eq)) - t * trailing + s * fx])


@st.composite
def tyres(draw: st.DrawFn) -> MagicFormula:
    """Published tyres with all coefficients that are zero there set to something, and the rest changed."""
    tyre = with_values(TYRES[draw(st.sampled_from(VERSIONS))], {"standstill_speed": 1e-6, "largest_camber": 0.3})
    version, changes = tyre.version, {}
    for name, value in numbers(tyre):
        if name.startswith(("longitudinal.", "lateral.", "aligning.", "scaling.")):
            factor = draw(st.floats(0.95, 1.05))
            changes[name] = value * factor if value else 0.02 * (factor - 1) / 0.05
    changes["lateral.pky4"] = 2.0
    changes["scaling.lmuv"] = 0.05
    changes["inflation_pressure"] = tyre.nominal_pressure * draw(st.floats(0.85, 1.15))
    if version < 6:
        changes["inflation_pressure"] = tyre.nominal_pressure
    return with_values(tyre, changes)


loads = st.floats(1000, 8500)


@relaxed
@given(tyres(), loads, st.floats(-0.9, 1.5), st.floats(-0.6, 0.6), st.floats(-0.25, 0.25), st.floats(-50, 50))
def test_forces_and_moment_are_those_of_the_book(tyre, load, kappa, alpha, gamma, v):
    v = math.copysign(max(abs(v), 5.0), v)
    found = forces(tyre, load, v, math.tan(alpha) * abs(v), v + kappa * abs(v), 1.0, gamma)
    expected = oracle(coefficients(tyre), tyre.version, load, kappa, alpha, gamma, v)
    assert_allclose(found[:3], expected, rtol=1e-6, atol=1e-6 * load)
    assert_allclose(found[3:], [kappa, -math.tan(alpha)], rtol=1e-9, atol=1e-12)


@relaxed
@given(tyres(), loads, st.floats(-0.9, 1.5), st.floats(-0.6, 0.6), st.floats(-0.25, 0.25))
def test_a_tyre_described_in_adapted_sae_axes_makes_the_same_forces_to_the_other_side(tyre, load, kappa, alpha, gamma):
    """Evaluated there with y to the right and z down, here with the converted coefficients."""
    in_sae = coefficients(tyre) | {n.upper(): -coefficients(tyre)[n.upper()] for n in AXIS_DEPENDENT}
    fx, fy, mz = oracle(in_sae, tyre.version, load, kappa, alpha, gamma, 20.0)
    assert fy * math.tan(alpha) > 0 or abs(alpha) < 0.1 or abs(kappa) > 0.02
    converted = adapted_sae_to_iso({n.lower(): v for n, v in in_sae.items()})
    iso = with_values(tyre, {n: converted[n.rsplit(".", 1)[-1]] for n, _ in numbers(tyre)})
    found = forces(iso, load, 20.0, math.tan(alpha) * 20.0, 20.0 * (1 + kappa), 1.0, gamma)
    assert_allclose(found[:3], [fx, -fy, -mz], rtol=1e-6, atol=1e-6 * load)


def test_the_tyre_of_the_book_has_its_stiffnesses_and_frictions():
    """Pacejka 2006, appendix 3: at the nominal load K_xκ is p_Kx1 F_z0, and K_yα p_Ky1 F_z0 sin(2 arctan(1/p_Ky2))."""
    tyre = TYRES["pacejka_2006_205_60r15"]
    assert float(tyre.steepest_slope(4000.0)) == pytest.approx(86040.0)
    assert float(tyre.cornering_stiffness_at(4000.0)) * math.pi / 180 == pytest.approx(803.0, abs=0.1)
    peak = max(forces(tyre, 4000.0, 20.0, 0.0, 20 * (1 + kappa))[0] for kappa in np.linspace(0, 0.3, 301))
    assert peak == pytest.approx(1.21 * 4000, rel=1e-3)
    sideways = [forces(tyre, 4000.0, 20.0, 20 * math.tan(alpha), 20.0)[1] for alpha in np.linspace(0, 0.4, 401)]
    assert min(sideways) == pytest.approx((-0.99 + 0.045) * 4000, rel=1e-3)


def test_more_pressure_makes_it_stiffer_along_and_across_as_the_coefficients_say():
    tyre = TYRES["pacejka_2012_205_60r15"]
    hard = with_values(tyre, {"inflation_pressure": 1.1 * tyre.nominal_pressure})
    slope = [float(t.steepest_slope(4000.0)) for t in (tyre, hard)]
    assert slope[1] / slope[0] == pytest.approx(1 - 0.3485 * 0.1 + 0.37824 * 0.01)


def test_below_the_smallest_load_forces_are_proportional_to_the_load_and_beyond_the_largest_constant():
    tyre = TYRES["pacejka_2006_205_60r15"]
    state = (20.0, 0.5, 20.5)
    assert_allclose(forces(tyre, 100.0, *state)[:3], 0.5 * forces(tyre, 200.0, *state)[:3])
    assert_allclose(forces(tyre, 50_000.0, *state)[:3], forces(tyre, 9000.0, *state)[:3])


def test_less_grip_keeps_the_stiffness_and_shrinks_the_largest_force():
    tyre = TYRES["pacejka_2012_205_60r15"]
    for axis, small in ((0, (20.0, 0.0, 20.002)), (1, (20.0, -0.002, 20.0))):
        dry, wet = (forces(tyre, 4000.0, *small, mu)[axis] - forces(tyre, 4000.0, 20.0, 0.0, 20.0, mu)[axis]
                    for mu in (1.0, 0.5))  # fmt: skip
        assert wet == pytest.approx(dry, rel=0.02)
    slips = np.linspace(0, 1, 200)
    dry, wet = (max(forces(tyre, 4000.0, 20.0, 0.0, 20 * (1 + s), mu)[0] for s in slips) for mu in (1.0, 0.5))
    assert wet == pytest.approx(0.5 * dry, rel=1e-2)


def test_relaxation_lengths_follow_the_version():
    later, earlier = TYRES["pacejka_2006_205_60r15"], TYRES["mf52"]
    state = (4000.0, 20.0, 0.0, 20.0)
    assert_allclose(relaxation_lengths(later, *state), [86040 / 3e5, 46009.14 / 1e5], rtol=1e-6)
    assert_allclose(relaxation_lengths(earlier, *state), [0.313 * 1.0, 0.313 * 1.5 * math.sin(2 * math.atan(1.0))])


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"lateral.pdy2": 0.9}, "lateral friction pdy1"),
        ({"longitudinal.pkx2": 60.0}, "slip stiffness pkx1"),
        ({"lateral.pdy3": 30.0}, "lateral friction vanishes before the inclination"),
        ({"largest_load": 100.0}, "is not below largest_load"),
        ({"inflation_pressure": 1e7, "lateral.ppy1": -0.6}, "vanishes at an inflation_pressure"),
        ({"lateral.pky1": 15.0}, "less than 0"),
    ],
)
def test_coefficients_that_make_no_tyre_are_refused(change, complaint):
    with pytest.raises(ValidationError, match=complaint):
        with_values(TYRES["pacejka_2006_205_60r15"], change)
