"""Coefficients of the Magic Formula, by the sections and with the names that `.tir` files have for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vsense_ros.model.parameter import Part, parameter

# Coefficients without which a tyre would be the same on the left and on the right of the car.
ASYMMETRIC = (
    "rhx1", "pey3", "phy1", "phy2", "pvy1", "pvy2", "rby3", "rvy1", "rvy2",
    "qbz4", "qdz3", "qdz6", "qdz7", "qez4", "qhz1", "qhz2", "ssz1",
)  # fmt: skip
# Coefficients whose sign depends on whether y points to the left (ISO) or to the right (adapted SAE).
AXIS_DEPENDENT = (
    "pdy1", "pdy2", "pky1", "pky6", "pky7", "pvy1", "pvy2", "pvy3", "pvy4",
    "qdz6", "qdz7", "qdz8", "qdz9", "qdz10", "qdz11", "ssz1", "ssz3", "ssz4",
)  # fmt: skip


def _coefficient(description: str, default: float = 0.0, unit: str = "-", **limits: float) -> Any:
    return parameter(unit, description, default=default, **limits)


class Longitudinal(Part):
    """Longitudinal force, as the section LONGITUDINAL_COEFFICIENTS."""

    pcx1: float = parameter("-", "shape factor of the force", ge=1, le=2)
    pdx1: float = parameter("-", "friction at the nominal load")
    pdx2: float = _coefficient("friction, change with load")
    pdx3: float = _coefficient("friction, change with inclination²")
    pex1: float = _coefficient("curvature at the nominal load")
    pex2: float = _coefficient("curvature, change with load")
    pex3: float = _coefficient("curvature, change with load²")
    pex4: float = _coefficient("curvature, difference between driving and braking")
    pkx1: float = parameter("-", "slip stiffness over load, at the nominal load")
    pkx2: float = _coefficient("slip stiffness, change with load")
    pkx3: float = _coefficient("slip stiffness, exponent of the load")
    phx1: float = _coefficient("horizontal shift")
    phx2: float = _coefficient("horizontal shift, change with load")
    pvx1: float = _coefficient("vertical shift over load")
    pvx2: float = _coefficient("vertical shift over load, change with load")
    ppx1: float = _coefficient("slip stiffness, change with pressure")
    ppx2: float = _coefficient("slip stiffness, change with pressure²")
    ppx3: float = _coefficient("friction, change with pressure")
    ppx4: float = _coefficient("friction, change with pressure²")
    rbx1: float = _coefficient("combined slip, slope factor", ge=0)
    rbx2: float = _coefficient("combined slip, change of the slope with longitudinal slip")
    rbx3: float = _coefficient("combined slip, change of the slope with inclination²")
    rcx1: float = _coefficient("combined slip, shape factor", default=1.0)
    rex1: float = _coefficient("combined slip, curvature")
    rex2: float = _coefficient("combined slip, curvature, change with load")
    rhx1: float = _coefficient("combined slip, shift")
    ptx1: float = _coefficient("relaxation length over radius and load ratio (MF 5.2)")
    ptx2: float = _coefficient("relaxation length, change with load (MF 5.2)")
    ptx3: float = _coefficient("relaxation length, exponent of the load (MF 5.2)")
    pcfx1: float = _coefficient("tyre stiffness, change with load")
    pcfx2: float = _coefficient("tyre stiffness, change with load²")
    pcfx3: float = _coefficient("tyre stiffness, change with pressure")


class Lateral(Part):
    """Lateral force, as the section LATERAL_COEFFICIENTS."""

    pcy1: float = parameter("-", "shape factor of the force", ge=1, le=2)
    pdy1: float = parameter("-", "friction at the nominal load; may have either sign")
    pdy2: float = _coefficient("friction, change with load")
    pdy3: float = _coefficient("friction, change with inclination²")
    pey1: float = _coefficient("curvature at the nominal load")
    pey2: float = _coefficient("curvature, change with load")
    pey3: float = _coefficient("curvature, difference between left and right")
    pey4: float = _coefficient("curvature, that difference, change with inclination")
    pey5: float = _coefficient("curvature, change with inclination²")
    pky1: float = parameter("-", "largest cornering stiffness over nominal load; negative in ISO axes", lt=0)
    pky2: float = parameter("-", "load over nominal load at the largest cornering stiffness", gt=0)
    pky3: float = _coefficient("cornering stiffness, change with inclination")
    pky4: float = _coefficient("cornering stiffness, curvature over the load", default=2.0, gt=0, le=2.05)
    pky5: float = _coefficient("load of the largest cornering stiffness, change with inclination²")
    pky6: float = _coefficient("camber stiffness over load")
    pky7: float = _coefficient("camber stiffness over load, change with load")
    phy1: float = _coefficient("horizontal shift")
    phy2: float = _coefficient("horizontal shift, change with load")
    phy3: float = _coefficient("horizontal shift, change with inclination (MF 5.2)")
    pvy1: float = _coefficient("vertical shift over load")
    pvy2: float = _coefficient("vertical shift over load, change with load")
    pvy3: float = _coefficient("vertical shift over load, change with inclination")
    pvy4: float = _coefficient("that change, change with load")
    ppy1: float = _coefficient("cornering stiffness, change with pressure")
    ppy2: float = _coefficient("load of the largest cornering stiffness, change with pressure")
    ppy3: float = _coefficient("friction, change with pressure")
    ppy4: float = _coefficient("friction, change with pressure²")
    ppy5: float = _coefficient("camber stiffness, change with pressure")
    rby1: float = _coefficient("combined slip, slope factor", ge=0)
    rby2: float = _coefficient("combined slip, change of the slope with the slip angle")
    rby3: float = _coefficient("combined slip, slip angle of the largest slope")
    rby4: float = _coefficient("combined slip, change of the slope with inclination²")
    rcy1: float = _coefficient("combined slip, shape factor", default=1.0)
    rey1: float = _coefficient("combined slip, curvature")
    rey2: float = _coefficient("combined slip, curvature, change with load")
    rhy1: float = _coefficient("combined slip, shift")
    rhy2: float = _coefficient("combined slip, shift, change with load")
    rvy1: float = _coefficient("side force from longitudinal slip, over friction times load")
    rvy2: float = _coefficient("that force, change with load")
    rvy3: float = _coefficient("that force, change with inclination")
    rvy4: float = _coefficient("that force, how fast it fades with the slip angle")
    rvy5: float = _coefficient("that force, shape factor")
    rvy6: float = _coefficient("that force, slope factor")
    pty1: float = _coefficient("largest relaxation length over radius (MF 5.2)")
    pty2: float = _coefficient("load over nominal load at the largest relaxation length (MF 5.2)", default=1.0, gt=0)
    pcfy1: float = _coefficient("tyre stiffness, change with load")
    pcfy2: float = _coefficient("tyre stiffness, change with load²")
    pcfy3: float = _coefficient("tyre stiffness, change with pressure")


class Aligning(Part):
    """Aligning moment, as the section ALIGNING_COEFFICIENTS."""

    qbz1: float = _coefficient("trail, slope factor")
    qbz2: float = _coefficient("trail, slope factor, change with load")
    qbz3: float = _coefficient("trail, slope factor, change with load²")
    qbz4: float = _coefficient("trail, slope factor, change with inclination")
    qbz5: float = _coefficient("trail, slope factor, change with inclination to either side")
    qbz9: float = _coefficient("residual moment, slope factor")
    qbz10: float = _coefficient("residual moment, slope factor that goes with the lateral force")
    qcz1: float = _coefficient("trail, shape factor", default=1.0)
    qdz1: float = _coefficient("trail over radius at the nominal load")
    qdz2: float = _coefficient("trail, change with load")
    qdz3: float = _coefficient("trail, change with inclination")
    qdz4: float = _coefficient("trail, change with inclination²")
    qdz6: float = _coefficient("residual moment over radius and load")
    qdz7: float = _coefficient("residual moment, change with load")
    qdz8: float = _coefficient("residual moment, change with inclination")
    qdz9: float = _coefficient("that change, change with load")
    qdz10: float = _coefficient("residual moment, change with inclination²")
    qdz11: float = _coefficient("that change, change with load")
    qez1: float = _coefficient("trail, curvature at the nominal load")
    qez2: float = _coefficient("trail, curvature, change with load")
    qez3: float = _coefficient("trail, curvature, change with load²")
    qez4: float = _coefficient("trail, curvature, difference between left and right")
    qez5: float = _coefficient("that difference, change with inclination")
    qhz1: float = _coefficient("trail, shift")
    qhz2: float = _coefficient("trail, shift, change with load")
    qhz3: float = _coefficient("trail, shift, change with inclination")
    qhz4: float = _coefficient("that change, change with load")
    ppz1: float = _coefficient("trail, change with pressure")
    ppz2: float = _coefficient("residual moment, change with pressure")
    ssz1: float = _coefficient("arm of the longitudinal force over radius")
    ssz2: float = _coefficient("that arm, change with the lateral force")
    ssz3: float = _coefficient("that arm, change with inclination")
    ssz4: float = _coefficient("that change, change with load")


class Scaling(Part):
    """Factors on properties of the measured tyre, as the section SCALING_COEFFICIENTS."""

    lfzo: float = _coefficient("nominal load", default=1.0, gt=0)
    lcx: float = _coefficient("shape of the longitudinal force", default=1.0, gt=0)
    lmux: float = _coefficient("longitudinal friction", default=1.0, gt=0)
    lex: float = _coefficient("curvature of the longitudinal force", default=1.0)
    lkx: float = _coefficient("slip stiffness", default=1.0, gt=0)
    lhx: float = _coefficient("horizontal shift of the longitudinal force", default=1.0)
    lvx: float = _coefficient("vertical shift of the longitudinal force", default=1.0)
    lgax: float = _coefficient("inclination in the longitudinal force (MF 5.2)", default=1.0)
    lcy: float = _coefficient("shape of the lateral force", default=1.0, gt=0)
    lmuy: float = _coefficient("lateral friction", default=1.0, gt=0)
    ley: float = _coefficient("curvature of the lateral force", default=1.0)
    lky: float = _coefficient("cornering stiffness", default=1.0, gt=0)
    lhy: float = _coefficient("horizontal shift of the lateral force", default=1.0)
    lvy: float = _coefficient("vertical shift of the lateral force", default=1.0)
    lgay: float = _coefficient("inclination in the lateral force (MF 5.2)", default=1.0)
    lkyc: float = _coefficient("camber stiffness", default=1.0)
    lkzc: float = _coefficient("moment from inclination", default=1.0)
    ltr: float = _coefficient("trail", default=1.0)
    lres: float = _coefficient("residual moment", default=1.0)
    lgaz: float = _coefficient("inclination in the aligning moment (MF 5.2)", default=1.0)
    lxal: float = _coefficient("slip angle in the longitudinal force", default=1.0)
    lyka: float = _coefficient("longitudinal slip in the lateral force", default=1.0)
    lvyka: float = _coefficient("side force from longitudinal slip", default=1.0)
    ls: float = _coefficient("arm of the longitudinal force", default=1.0)
    lsgkp: float = _coefficient("longitudinal relaxation length (MF 5.2)", default=1.0)
    lsgal: float = _coefficient("lateral relaxation length (MF 5.2)", default=1.0)
    lmuv: float = _coefficient("loss of friction with sliding speed", ge=0)


def adapted_sae_to_iso(coefficients: Mapping[str, float]) -> dict[str, float]:
    """Coefficients by name, for y to the left and z up, from those for y to the right and z down.

    Lateral force and aligning moment change their signs. Slip angle and inclination keep them: in both systems the slip
    angle is positive where the wheel moves to its left, the inclination where its top leans to the right; adapted SAE
    axes have that slip angle make a positive force (Pacejka 2012, section 2.2).
    """
    return {name: -value if name in AXIS_DEPENDENT else value for name, value in coefficients.items()}
