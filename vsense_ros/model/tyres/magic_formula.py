"""The Magic Formula with combined slip: MF 5.2, and of MF 6.1 what `.tir` files in use carry.

Equations by their numbers in Pacejka 2012, section 4.3.2, without turn slip (all ζ are 1, all terms in φ vanish). Where
the programs that write `.tir` files differ from the book, they are followed (Besselink, Schmeitz & Pacejka 2010, eqs.
A54 to A60): Q_Bz4 and Q_Dz3 act on the signed inclination, Q_Bz6 does not exist, A_μ is 1. Coefficients keep the names
they have in the file.

Axes are those of the file, ISO: the slip angle is positive where the wheel moves to its left, so that PKY1 is negative.
`magic_formula_coefficients.adapted_sae_to_iso` converts coefficients of the book's other axes, once and for all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
from pydantic import model_validator

from vsense_ros.model.parameter import Scalar, parameter
from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.magic_formula_coefficients import Aligning, Lateral, Longitudinal, Scaling
from vsense_ros.model.tyres.slip import SLIP, Slips, slips


def _bent(slope: Scalar, curvature: Scalar, slip: Scalar) -> Scalar:
    """B x − E (B x − arctan B x), what sine and cosine of the Magic Formula take."""
    scaled = slope * slip
    return scaled - ca.fmin(curvature, 1) * (scaled - ca.atan(scaled))


def _sine(slope: Scalar, shape: Scalar, curvature: Scalar, slip: Scalar) -> Scalar:
    return ca.sin(shape * ca.atan(_bent(slope, curvature, slip)))


def _cosine(slope: Scalar, shape: Scalar, curvature: Scalar, slip: Scalar) -> Scalar:
    return ca.cos(shape * ca.atan(_bent(slope, curvature, slip)))


def _weight(slope: Scalar, shape: Scalar, curvature: Scalar, slip: Scalar, shift: Scalar) -> Scalar:
    """Share of a force that slip across it leaves. Fitted shapes above 1 would make it negative far out."""
    return ca.fmax(_cosine(slope, shape, curvature, slip + shift) / _cosine(slope, shape, curvature, shift), 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Conditions:
    """Load and pressure against their nominal values, and the friction of road and tyre."""

    load: Scalar  # within the range of the measurement [N]
    contact: Scalar  # falls from 1 to 0 below that range
    nominal: Scalar  # load [N]
    dfz: Scalar  # relative difference of the load from the nominal one
    dpi: Scalar  # relative difference of the pressure from the nominal one
    grip_x: Scalar
    grip_y: Scalar


@dataclass(frozen=True, slots=True, eq=False)
class _Rolling:
    """How a wheel moves, seen from the side of the car for which the tyre was measured."""

    along: Scalar  # longitudinal slip
    across: Scalar  # lateral slip as the version of the formula measures it
    lean: Scalar  # inclination as that version measures it
    heading: Scalar  # cosine of the slip angle
    shifted: Scalar  # 1 where the tyre rolls, 0 at standstill: what is left of the shifts of the curves
    friction: Scalar  # of the road


@dataclass(frozen=True, slots=True, eq=False)
class _PureLateral:
    """The lateral force without longitudinal slip, and what the aligning moment takes from it."""

    force: Scalar  # [N]
    friction: Scalar
    stiffness: Scalar  # negative [N/rad]
    initial: Scalar  # B times C
    shift: Scalar  # of the slip at which the force vanishes


class MagicFormula(Tyre):
    """Parameters of a Magic Formula tyre: given here, or in a vehicle file as `tir: FILE`."""

    model: Literal["magic_formula"]
    version: float = parameter("-", "5.2, or 6.1 for all later files", ge=5, lt=7, default=6.1)
    measured_side: float = parameter(
        "-", "side of the car the tyre was measured for: 1 left, -1 right", ge=-1, le=1, default=1.0
    )
    nominal_load: float = parameter("N", "nominal load, FNOMIN", gt=0)
    unloaded_radius: float = parameter("m", "radius to which trails refer, UNLOADED_RADIUS", gt=0.05, lt=2)
    smallest_load: float = parameter("N", "forces are proportional to the load below it, FZMIN", gt=0)
    largest_load: float = parameter("N", "forces stay as they are beyond it, FZMAX", gt=0)
    largest_camber: float = parameter("rad", "inclinations count up to it, CAMMAX", gt=0, lt=1.5, default=0.26)
    nominal_pressure: float = parameter("Pa", "NOMPRES", gt=0, default=220000.0)
    inflation_pressure: float = parameter("Pa", "INFLPRES", gt=0, default=220000.0)
    reference_speed: float = parameter("m/s", "speed of the measurement, LONGVL", gt=0, default=16.7)
    longitudinal_stiffness: float = parameter("N/m", "of the tyre at rest, LONGITUDINAL_STIFFNESS", gt=0, default=3e5)
    lateral_stiffness: float = parameter("N/m", "of the tyre at rest, LATERAL_STIFFNESS", gt=0, default=1.5e5)
    standstill_speed: float = parameter(
        "m/s", "added to the velocity so that slip stays finite at standstill", gt=0, le=2, default=0.3
    )
    longitudinal: Longitudinal
    lateral: Lateral
    aligning: Aligning = Aligning()
    scaling: Scaling = Scaling()

    @model_validator(mode="after")
    def _friction_and_stiffness_keep_their_signs(self) -> MagicFormula:
        if self.smallest_load >= self.largest_load:
            raise ValueError(
                f"smallest_load {self.smallest_load:g} N is not below largest_load {self.largest_load:g} N"
            )
        if self.lateral.pdy1 == 0:
            raise ValueError("pdy1 is 0: no lateral friction")
        for load in (self.smallest_load, self.largest_load):
            self._check_load(load)
        self._check_camber()
        self._check_pressure()
        return self

    def _check_load(self, load: float) -> None:
        x, y, nominal = self.longitudinal, self.lateral, self.scaling.lfzo * self.nominal_load
        dfz = (load - nominal) / nominal
        for name, value in (
            ("the longitudinal friction pdx1 + pdx2·dfz", x.pdx1 + x.pdx2 * dfz),
            ("the slip stiffness pkx1 + pkx2·dfz", x.pkx1 + x.pkx2 * dfz),
            ("the lateral friction pdy1 + pdy2·dfz", math.copysign(1, y.pdy1) * (y.pdy1 + y.pdy2 * dfz)),
        ):
            if value <= 0:
                raise ValueError(
                    f"{name} changes its sign on the way to a load of {load:g} N; "
                    "narrow the range from smallest_load to largest_load (FZMIN, FZMAX)"
                )

    def _check_camber(self) -> None:
        x, y = self.longitudinal, self.lateral
        for name, value in (
            ("longitudinal friction", 1 - x.pdx3 * self.largest_camber**2),
            ("lateral friction", 1 - y.pdy3 * self.largest_camber**2),
            ("cornering stiffness", 1 - y.pky3 * self.largest_camber),
        ):
            if value <= 0:
                raise ValueError(
                    f"the {name} vanishes before the inclination reaches {self.largest_camber:g} rad; "
                    "lower largest_camber (CAMMAX)"
                )

    def _check_pressure(self) -> None:
        x, y = self.longitudinal, self.lateral
        dpi = (self.inflation_pressure - self.nominal_pressure) / self.nominal_pressure
        for name, value in (
            ("longitudinal friction", 1 + x.ppx3 * dpi + x.ppx4 * dpi**2),
            ("slip stiffness", 1 + x.ppx1 * dpi + x.ppx2 * dpi**2),
            ("lateral friction", 1 + y.ppy3 * dpi + y.ppy4 * dpi**2),
            ("cornering stiffness", min(1 + y.ppy1 * dpi, 1 + y.ppy2 * dpi)),
        ):
            if value <= 0:
                raise ValueError(
                    f"the {name} vanishes at an inflation_pressure of {self.inflation_pressure:g} Pa; "
                    f"the tyre was measured at {self.nominal_pressure:g} Pa"
                )

    def _conditions(self, load: Scalar, friction: Scalar) -> _Conditions:
        """Load and pressure against their nominal values, and the friction of road and tyre."""
        limited_load = ca.fmin(ca.fmax(load, self.smallest_load), self.largest_load)
        nominal = self.scaling.lfzo * self.nominal_load  # 4.E1
        return _Conditions(
            load=limited_load,
            contact=ca.fmin(ca.fmax(load, 0) / self.smallest_load, 1),
            nominal=nominal,
            dfz=(limited_load - nominal) / nominal,  # 4.E2a
            dpi=(self.inflation_pressure - self.nominal_pressure) / self.nominal_pressure,  # 4.E2b
            grip_x=self.scaling.lmux * friction,
            grip_y=self.scaling.lmuy * friction,
        )

    def _slip_stiffness(self, at: _Conditions) -> Scalar:
        """4.E15 [N]"""
        c = self.longitudinal
        by_load = at.load * (c.pkx1 + c.pkx2 * at.dfz) * ca.exp(c.pkx3 * at.dfz)
        return by_load * (1 + c.ppx1 * at.dpi + c.ppx2 * at.dpi**2) * self.scaling.lkx

    def _cornering_stiffness(self, at: _Conditions, camber: Scalar) -> Scalar:
        """4.E25, negative [N/rad]"""
        c = self.lateral
        summit = (c.pky2 + c.pky5 * camber**2) * (1 + c.ppy2 * at.dpi)
        by_load = ca.sin(c.pky4 * ca.atan(at.load / at.nominal / summit))
        return c.pky1 * at.nominal * (1 + c.ppy1 * at.dpi) * (1 - c.pky3 * ca.fabs(camber)) * by_load * self.scaling.lky

    def _pure_longitudinal(self, at: _Conditions, slip: Scalar, camber: Scalar, shifted: Scalar) -> Scalar:
        """4.E9 to 4.E18 [N]; `shifted` fades the shifts."""
        c, scale = self.longitudinal, self.scaling
        friction = (c.pdx1 + c.pdx2 * at.dfz) * (1 + c.ppx3 * at.dpi + c.ppx4 * at.dpi**2) * (1 - c.pdx3 * camber**2)
        peak = friction * at.grip_x * at.load
        shape = c.pcx1 * scale.lcx
        slope = self._slip_stiffness(at) / (shape * peak)
        slip = slip + shifted * (c.phx1 + c.phx2 * at.dfz) * scale.lhx
        curvature = (c.pex1 + c.pex2 * at.dfz + c.pex3 * at.dfz**2) * (1 - c.pex4 * ca.sign(slip)) * scale.lex
        lift = shifted * at.load * (c.pvx1 + c.pvx2 * at.dfz) * scale.lvx * at.grip_x
        return peak * _sine(slope, shape, curvature, slip) + lift

    def _pure_lateral(self, at: _Conditions, slip: Scalar, camber: Scalar, shifted: Scalar) -> _PureLateral:
        """4.E19 to 4.E30: force [N], and what the aligning moment takes from it; `shifted` fades the shifts."""
        c, scale = self.lateral, self.scaling
        stiffness = self._cornering_stiffness(at, camber)
        friction = (c.pdy1 + c.pdy2 * at.dfz) * (1 + c.ppy3 * at.dpi + c.ppy4 * at.dpi**2) * (1 - c.pdy3 * camber**2)
        friction = friction * at.grip_y
        peak = friction * at.load
        shape = c.pcy1 * scale.lcy
        slope = stiffness / (shape * peak)
        lift_by_camber = at.load * (c.pvy3 + c.pvy4 * at.dfz) * camber * scale.lkyc * at.grip_y
        camber_stiffness = at.load * (c.pky6 + c.pky7 * at.dfz) * (1 + c.ppy5 * at.dpi) * scale.lkyc
        shift_by_camber = ca.if_else(
            self.version < 6, c.phy3 * camber * scale.lkyc, (camber_stiffness * camber - lift_by_camber) / stiffness
        )
        shift = shifted * ((c.phy1 + c.phy2 * at.dfz) * scale.lhy + shift_by_camber)
        lift = shifted * (at.load * (c.pvy1 + c.pvy2 * at.dfz) * scale.lvy * at.grip_y + lift_by_camber)
        slip = slip + shift
        asymmetry = (c.pey3 + c.pey4 * camber) * ca.sign(slip)
        curvature = (c.pey1 + c.pey2 * at.dfz) * (1 + c.pey5 * camber**2 - asymmetry) * scale.ley
        return _PureLateral(
            force=peak * _sine(slope, shape, curvature, slip) + lift,
            friction=friction,
            stiffness=stiffness,
            initial=slope * shape,
            shift=shift + lift / stiffness,  # 4.E38
        )

    def steepest_slope(self, load: Scalar) -> Scalar:
        """Largest increase of longitudinal force per longitudinal slip at a wheel load, that at zero slip [N]."""
        return self._slip_stiffness(self._conditions(load, 1.0))

    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        """Lateral force per slip angle at zero slip [N/rad], positive."""
        return -self._cornering_stiffness(self._conditions(load, 1.0), 0.0)

    def forces(self, wheel: TyreInput) -> TyreForces:
        """Steady forces and slips.

        At standstill, where slip says nothing about rolling, the shifts of the curves fade away; so does what they come
        from, the asymmetry of a rolling tyre.
        """
        slip = slips(wheel, wheel.speed_x, self.standstill_speed)
        mirrored = wheel.side * self.measured_side
        roll = self._rolling(wheel, slip, mirrored)
        at = self._sliding_conditions(wheel)
        pure = self._pure_lateral(at, roll.across, roll.lean * self.scaling.lgay, roll.shifted)
        weight, from_slip_x = self._combined_lateral(at, roll, pure)
        force_x = self._combined_longitudinal(at, roll)
        force_y = weight * pure.force + from_slip_x
        # The moment comes from the lateral force behind the centre, without what inclination adds to it.
        upright = self._pure_lateral(at, roll.across, 0.0, roll.shifted)
        trailing = ca.if_else(self.version > 6, weight * upright.force, force_y - from_slip_x)
        moment = self._moment(at, roll, pure, trailing, force_x, force_y)
        return TyreForces(
            longitudinal=at.contact * force_x,
            lateral=mirrored * at.contact * force_y,
            aligning_moment=mirrored * at.contact * moment,
            longitudinal_slip=slip.longitudinal,
            lateral_slip=slip.lateral,
        )

    def _rolling(self, wheel: TyreInput, slip: Slips, mirrored: Scalar) -> _Rolling:
        """4.E3 to 4.E6; `mirrored` is -1 on the other side of the car than that of the measurement."""
        later = self.version > 6
        across = mirrored * wheel.speed_y / slip.reference_speed
        lean = mirrored * ca.fmin(ca.fmax(wheel.camber, -self.largest_camber), self.largest_camber)
        rolling = wheel.speed_x / slip.reference_speed
        return _Rolling(
            along=slip.longitudinal,
            across=ca.if_else(later, across, ca.atan(across)),  # 4.E3
            lean=ca.if_else(later, ca.sin(lean), lean),  # 4.E4
            heading=wheel.speed_x / ca.sqrt(slip.reference_speed**2 + wheel.speed_y**2),  # cos α', 4.E6
            shifted=rolling**2,
            friction=wheel.friction,
        )

    def _sliding_conditions(self, wheel: TyreInput) -> _Conditions:
        """`_conditions`, with the grip that sliding leaves (4.E7)."""
        at = self._conditions(wheel.load, wheel.friction)
        sliding = ca.sqrt((wheel.rolling_speed - wheel.speed_x) ** 2 + wheel.speed_y**2 + SLIP.smallest_slip**2)
        loss = 1 + self.scaling.lmuv * sliding / self.reference_speed
        return replace(at, grip_x=at.grip_x / loss, grip_y=at.grip_y / loss)

    def _combined_longitudinal(self, at: _Conditions, roll: _Rolling) -> Scalar:
        """Longitudinal force [N] that slip across it leaves, 4.E50 to 4.E57.

        On a road with less grip slip does so earlier, or the resultant would leave the friction circle: the similarity
        of section 4.3.1 applied to the weights, here and for the lateral force.
        """
        c = self.longitudinal
        along, across = roll.along / roll.friction, roll.across / roll.friction
        slope = (c.rbx1 + c.rbx3 * roll.lean**2) / ca.sqrt(1 + (c.rbx2 * along) ** 2) * self.scaling.lxal
        weight = _weight(slope, c.rcx1, c.rex1 + c.rex2 * at.dfz, across, c.rhx1)
        return weight * self._pure_longitudinal(at, roll.along, roll.lean * self.scaling.lgax, roll.shifted)

    def _combined_lateral(self, at: _Conditions, roll: _Rolling, pure: _PureLateral) -> tuple[Scalar, Scalar]:
        """Share of the lateral force that longitudinal slip leaves, and the force that it makes [N]; 4.E58 to 4.E67."""
        c, lean = self.lateral, roll.lean * self.scaling.lgay
        along, across = roll.along / roll.friction, roll.across / roll.friction
        slope = (c.rby1 + c.rby4 * lean**2) / ca.sqrt(1 + (c.rby2 * (across - c.rby3)) ** 2) * self.scaling.lyka
        weight = _weight(slope, c.rcy1, c.rey1 + c.rey2 * at.dfz, along, c.rhy1 + c.rhy2 * at.dfz)
        largest = pure.friction * at.load * (c.rvy1 + c.rvy2 * at.dfz + c.rvy3 * lean)
        ply_steer_force = largest / ca.sqrt(1 + (c.rvy4 * across) ** 2) * ca.sin(c.rvy5 * ca.atan(c.rvy6 * along))
        return weight, roll.shifted * self.scaling.lvyka * ply_steer_force

    def _moment(
        self, at: _Conditions, roll: _Rolling, pure: _PureLateral, trailing: Scalar, force_x: Scalar, force_y: Scalar
    ) -> Scalar:
        """Aligning moment [N m] of a lateral force `trailing` behind the centre, 4.E71 to 4.E78."""
        c, lean = self.aligning, roll.lean * self.scaling.lgaz
        stretched = self._slip_stiffness(at) / pure.stiffness * roll.along
        trail = roll.heading * self._trail(at, roll, stretched)
        residual = roll.heading * self._residual_moment(at, roll, pure, stretched)
        arm = c.ssz1 + c.ssz2 * force_y / self.nominal_load + (c.ssz3 + c.ssz4 * at.dfz) * lean
        return residual - trail * trailing + self.unloaded_radius * arm * self.scaling.ls * force_x

    def _trail(self, at: _Conditions, roll: _Rolling, stretched: Scalar) -> Scalar:
        """Pneumatic trail, 4.E33 to 4.E44 [m]."""
        c, camber = self.aligning, roll.lean * self.scaling.lgaz
        slip = roll.across + roll.shifted * (c.qhz1 + c.qhz2 * at.dfz + (c.qhz3 + c.qhz4 * at.dfz) * camber)
        slope = (c.qbz1 + c.qbz2 * at.dfz + c.qbz3 * at.dfz**2) * (1 + c.qbz4 * camber + c.qbz5 * ca.fabs(camber))
        slope = slope * self.scaling.lky / at.grip_y
        longest = at.load / self.nominal_load * (c.qdz1 + c.qdz2 * at.dfz) * (1 - c.ppz1 * at.dpi)
        longest = self.unloaded_radius * longest * (1 + c.qdz3 * camber + c.qdz4 * camber**2) * self.scaling.ltr
        asymmetry = (c.qez4 + c.qez5 * camber) * (2 / math.pi) * ca.atan(slope * c.qcz1 * slip)
        curvature = (c.qez1 + c.qez2 * at.dfz + c.qez3 * at.dfz**2) * (1 + asymmetry)
        # The cosine is even, so the equivalent slip needs no sign.
        equivalent = ca.sqrt(slip**2 + stretched**2 + SLIP.smallest_slip**2)
        return longest * _cosine(slope, c.qcz1, curvature, equivalent)

    def _residual_moment(self, at: _Conditions, roll: _Rolling, pure: _PureLateral, stretched: Scalar) -> Scalar:
        """Moment that is left where the trail has vanished, 4.E36 to 4.E47 [N m]."""
        c, camber = self.aligning, roll.lean * self.scaling.lgaz
        by_camber = (c.qdz8 + c.qdz9 * at.dfz) * (1 + c.ppz2 * at.dpi) + (c.qdz10 + c.qdz11 * at.dfz) * ca.fabs(camber)
        largest = (c.qdz6 + c.qdz7 * at.dfz) * self.scaling.lres + by_camber * camber * self.scaling.lkzc
        slope = c.qbz9 * self.scaling.lky / at.grip_y + c.qbz10 * pure.initial
        equivalent = (roll.across + pure.shift) ** 2 + stretched**2
        return at.load * self.unloaded_radius * largest * at.grip_y / ca.sqrt(1 + slope**2 * equivalent)

    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        """Distance over which the longitudinal and the lateral force build up [m].

        By coefficients of their own in MF 5.2, from stiffnesses in MF 6.1 (Besselink et al. 2010, eqs. 17 to 19).
        """
        at = self._conditions(wheel.load, wheel.friction)
        x, y, scale = self.longitudinal, self.lateral, self.scaling
        camber = ca.fmin(ca.fabs(wheel.camber), self.largest_camber) * scale.lgay
        earlier_x = (x.ptx1 + x.ptx2 * at.dfz) * ca.exp(-x.ptx3 * at.dfz) * at.load / self.nominal_load * scale.lsgkp
        earlier_y = y.pty1 * ca.sin(2 * ca.atan(at.load / (y.pty2 * at.nominal))) * (1 - y.pky3 * camber)
        earlier_y = earlier_y * scale.lfzo * scale.lsgal
        stiff_x = self.longitudinal_stiffness * (1 + x.pcfx1 * at.dfz + x.pcfx2 * at.dfz**2) * (1 + x.pcfx3 * at.dpi)
        stiff_y = self.lateral_stiffness * (1 + y.pcfy1 * at.dfz + y.pcfy2 * at.dfz**2) * (1 + y.pcfy3 * at.dpi)
        later_x = ca.fabs(self._slip_stiffness(at) / stiff_x)
        later_y = ca.fabs(self._cornering_stiffness(at, camber) / stiff_y)
        return RelaxationLengths(
            ca.if_else(self.version > 6, later_x, self.unloaded_radius * earlier_x),
            ca.if_else(self.version > 6, later_y, self.unloaded_radius * earlier_y),
        )
