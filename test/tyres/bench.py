"""A tyre on a test bench: forces by load, slip and inclination, for every model in the same way."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.files.tyre import load_tyre
from vsense_ros.model.parameter import numbers, symbols, vector, with_values
from vsense_ros.model.tyres import MagicFormula, TyreInput
from vsense_ros.model.tyres.magic_formula_coefficients import ASYMMETRIC

Array = NDArray[np.float64]
FOLDER = Path(__file__).parents[2] / "config/tyres"
DRIVE_AND_BRAKE_DIFFER = ("phx1", "phx2", "pvx1", "pvx2", "pex4", "rhy1", "rhy2")


def without(tyre: MagicFormula, names: tuple[str, ...]) -> MagicFormula:
    return with_values(tyre, {n: 0.0 for n, _ in numbers(tyre) if n.rsplit(".", 1)[-1] in names})


def _all() -> dict[str, Any]:
    tyres = {path.stem: load_tyre(path) for path in sorted(FOLDER.iterdir())}
    earlier = {"version": 5.2, "lateral.phy3": 0.075, "longitudinal.ptx1": 1.0, "lateral.pty1": 1.5}
    tyres["mf52"] = with_values(tyres["pacejka_2006_205_60r15"], earlier)
    return tyres


TYRES = _all()
# The same, with the Magic Formula rid of what distinguishes left from right and driving from braking.
SYMMETRIC = {
    name: without(tyre, ASYMMETRIC + DRIVE_AND_BRAKE_DIFFER) if isinstance(tyre, MagicFormula) else tyre
    for name, tyre in TYRES.items()
}

NAMES = ("load", "speed_x", "speed_y", "rolling_speed", "friction", "camber", "side")


@cache
def _functions(model: str) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Results (5), their Jacobian (5×7) and relaxation lengths (2) of (p, arguments)."""
    p, tyre = symbols(next(t for t in TYRES.values() if t.model == model))
    a = ca.SX.sym("a", len(NAMES))
    wheel = TyreInput(*ca.vertsplit(a))
    results = ca.vertcat(*tyre.forces(wheel))
    lengths = ca.vertcat(*tyre.relaxation_lengths(wheel))
    return (
        ca.Function("forces", [p, a], [results]),
        ca.Function("jacobian", [p, a], [ca.densify(ca.jacobian(results, a))]),
        ca.Function("lengths", [p, a], [lengths]),
    )


def arguments(load, speed_x, speed_y, rolling_speed, friction=1.0, camber=0.0, side=1.0) -> list[float]:
    return [load, speed_x, speed_y, rolling_speed, friction, camber, side]


def forces(tyre: Any, *a: float, **named: float) -> Array:
    """Force x, force y, moment, slip x, slip y."""
    return np.asarray(_functions(tyre.model)[0](vector(tyre), arguments(*a, **named)))[:, 0]


def jacobian(tyre: Any, *a: float, **named: float) -> Array:
    return np.asarray(_functions(tyre.model)[1](vector(tyre), arguments(*a, **named)))


def relaxation_lengths(tyre: Any, *a: float, **named: float) -> Array:
    return np.asarray(_functions(tyre.model)[2](vector(tyre), arguments(*a, **named)))[:, 0]


def at_slip(tyre: Any, load: float, slip_x: float, slip_y: float, *, speed: float = 20.0, **named: float) -> Array:
    """At given slips, whichever speed they are relative to in this model."""
    standstill = tyre.standstill_speed
    if tyre.model == "tmeasy":
        transport = np.hypot(speed, standstill)
        return forces(tyre, load, speed - slip_x * transport, -slip_y * transport, speed, **named)
    travel = np.hypot(speed, standstill)
    return forces(tyre, load, speed, -slip_y * travel, speed + slip_x * travel, **named)


def grip(tyre: Any, load: float) -> float:
    """Largest force that the parameters allow in any direction [N]."""
    if tyre.model == "tmeasy":
        ratio = min(load / tyre.nominal_load, 2.5)
        pairs = (tyre.longitudinal, tyre.lateral)
        return max(np.polyval(np.polyfit([0, 1, 2], [0, p.nominal.maximum, p.double.maximum], 2), ratio) for p in pairs)
    if tyre.model == "fiala":
        return tyre.static_friction * load
    if tyre.model == "similarity":
        return tyre.peak * load
    if tyre.model == "magic_formula":
        within = min(max(load, tyre.smallest_load), tyre.largest_load)
        dfz = within / tyre.nominal_load - 1
        x, y = tyre.longitudinal, tyre.lateral
        coefficient = max(abs(x.pdx1 + x.pdx2 * dfz), abs(y.pdy1 + y.pdy2 * dfz))
        return coefficient * within * min(load / tyre.smallest_load, 1)
    return np.inf
