"""TMeasy: a handling tyre model from a few parameters with physical meaning (Hirschberg, Rill & Weinfurter 2007).

Combined-slip forces with degressive load influence. Each force curve is given at the nominal load and at twice that
load by its initial slope, its maximum and the slip there, and the sliding force and the slip where it sets in.
Inclination acts as additional lateral slip, the lag behind the slip comes from the elasticity of the carcass.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import casadi as ca
from pydantic import model_validator

from vsense_ros.model.parameter import Part, Scalar, parameter
from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.slip import SLIP, contact, slips

LARGEST_LOAD_RATIO = 2.5  # the force curves are those of this ratio to the nominal load beyond it


class ForceCurve(Part):
    """Force against slip at one load."""

    initial_slope: float = parameter("N", "initial slope dF/ds", gt=0)
    maximum: float = parameter("N", "largest force", gt=0)
    slip_at_maximum: float = parameter("-", "slip at the largest force", gt=0, lt=2)
    sliding: float = parameter("N", "force of full sliding", gt=0)
    slip_at_sliding: float = parameter("-", "slip where full sliding begins", gt=0, lt=5)

    @model_validator(mode="after")
    def _curve_has_one_maximum(self) -> ForceCurve:
        least = 2 * self.maximum / self.slip_at_maximum
        if self.initial_slope < least:
            raise ValueError(
                f"initial_slope {self.initial_slope:g} N is too flat for a maximum of {self.maximum:g} N at slip "
                f"{self.slip_at_maximum:g}; at least 2·maximum/slip_at_maximum = {least:g} N is needed"
            )
        if self.sliding > self.maximum:
            raise ValueError(f"sliding {self.sliding:g} N exceeds maximum {self.maximum:g} N")
        if self.slip_at_sliding <= self.slip_at_maximum:
            raise ValueError("slip_at_sliding must be larger than slip_at_maximum")
        return self


def _force_at_load(nominal: Scalar, double: Scalar, ratio: Scalar) -> Scalar:
    """Quadratic load influence through zero, `nominal` at ratio 1 and `double` at 2 (Rill 2012, eq. 3.58)."""
    return ratio * (2 * nominal - 0.5 * double - (nominal - 0.5 * double) * ratio)


def _slip_at_load(nominal: Scalar, double: Scalar, ratio: Scalar) -> Scalar:
    """Linear load influence of a slip parameter."""
    return nominal + (double - nominal) * (ratio - 1)


class CurveAtLoad(NamedTuple):
    """A force curve at the present load and friction: symbols or numbers, as in `ForceCurve`."""

    initial_slope: Scalar
    maximum: Scalar
    slip_at_maximum: Scalar
    sliding: Scalar
    slip_at_sliding: Scalar


class LoadPair(Part):
    """A force curve at the nominal load and at twice the nominal load."""

    nominal: ForceCurve
    double: ForceCurve

    @model_validator(mode="after")
    def _curves_keep_their_shape_at_every_load(self) -> LoadPair:
        # Forces over load and slips are linear in the load, so looking at the ends of the range is enough.
        for ratio in (0.0, LARGEST_LOAD_RATIO):
            force = {
                name: 2 * at_nominal - at_double / 2 - (at_nominal - at_double / 2) * ratio
                for name in ("initial_slope", "maximum", "sliding")
                for at_nominal, at_double in [(getattr(self.nominal, name), getattr(self.double, name))]
            }
            slip = {
                name: at_nominal + (at_double - at_nominal) * (ratio - 1)
                for name in ("slip_at_maximum", "slip_at_sliding")
                for at_nominal, at_double in [(getattr(self.nominal, name), getattr(self.double, name))]
            }
            for name, value in (force | slip).items():
                if value <= 0:
                    raise ValueError(
                        f"{name} must stay positive from no load to {LARGEST_LOAD_RATIO:g} times the nominal load, "
                        f"but {getattr(self.nominal, name):g} at the nominal load and {getattr(self.double, name):g} "
                        "at its double differ too much"
                    )
            if force["sliding"] > force["maximum"] * (1 + 1e-9) or slip["slip_at_sliding"] <= slip["slip_at_maximum"]:
                raise ValueError(
                    f"nominal and double fit together badly: at {ratio:g} times the nominal load sliding would exceed "
                    "maximum, or slip_at_sliding would not exceed slip_at_maximum"
                )
        return self

    def initial_slope(self, load_ratio: Scalar) -> Scalar:
        """Slope of the force at zero slip [N] under a load over the nominal one."""
        return _force_at_load(self.nominal.initial_slope, self.double.initial_slope, load_ratio)

    def at(self, load_ratio: Scalar, friction: Scalar) -> CurveAtLoad:
        """The curve under a load over the nominal one, on a road with that grip."""
        nominal, double = self.nominal, self.double
        return CurveAtLoad(
            initial_slope=self.initial_slope(load_ratio),
            maximum=friction * _force_at_load(nominal.maximum, double.maximum, load_ratio),
            slip_at_maximum=friction * _slip_at_load(nominal.slip_at_maximum, double.slip_at_maximum, load_ratio),
            sliding=friction * _force_at_load(nominal.sliding, double.sliding, load_ratio),
            slip_at_sliding=friction * _slip_at_load(nominal.slip_at_sliding, double.slip_at_sliding, load_ratio),
        )


class TMeasy(Tyre):
    """Parameters of a TMeasy tyre."""

    model: Literal["tmeasy"] = "tmeasy"
    nominal_load: float = parameter("N", "nominal load", gt=0)
    longitudinal: LoadPair
    lateral: LoadPair
    pneumatic_trail: float = parameter("m", "pneumatic trail at zero slip and nominal load", ge=0, lt=0.2, default=0.03)
    slip_of_no_trail: float = parameter("-", "lateral slip where the trail changes its sign", gt=0, lt=2, default=0.3)
    end_of_trail: float = parameter("-", "slip where the trail ends over slip_of_no_trail", gt=1, lt=20, default=2.0)
    camber_slip: float = parameter(
        "-", "lateral slip to which inclination is equivalent, per sine of its angle: contact length over 6 radii",
        ge=0, lt=1, default=0.0,
    )  # fmt: skip
    longitudinal_stiffness: float = parameter("N/m", "of the carcass: slope over it is the lag", gt=0, default=3e5)
    lateral_stiffness: float = parameter("N/m", "of the carcass: slope over it is the lag", gt=0, default=1.5e5)
    standstill_speed: float = parameter(
        "m/s", "added to the transport velocity so that slip stays finite at standstill", gt=0, le=2, default=0.3
    )

    def steepest_slope(self, load: Scalar) -> Scalar:
        """Largest increase of longitudinal force per longitudinal slip at a wheel load, that at zero slip [N]."""
        return self.longitudinal.initial_slope(self._load_ratio(load))

    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        """Lateral force per slip angle at zero slip [N/rad]."""
        return self.lateral.initial_slope(self._load_ratio(load))

    def forces(self, wheel: TyreInput) -> TyreForces:
        """Steady forces and slips; the side of the car is without effect.

        A wheel that leans rolls like a cone: its tread is deflected towards the lean in the middle of the contact
        patch, on average as by a third of the slip at the ends (Hirschberg et al. 2007, section 2.6). That deflection
        is symmetric and has no trail.
        """
        slip = slips(wheel, wheel.rolling_speed, self.standstill_speed)
        rolling = wheel.rolling_speed / slip.reference_speed
        by_camber = self._camber_slip(wheel.camber, rolling)
        over_x, over_y = self._forces_over_slips(wheel, slip.longitudinal, slip.lateral + by_camber)
        # The trail points against the direction of rolling.
        moment = -self._trail(wheel.load, slip.lateral) * rolling * over_y * slip.lateral
        return TyreForces(
            over_x * slip.longitudinal, over_y * (slip.lateral + by_camber), moment, slip.longitudinal, slip.lateral
        )

    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        """Distance over which the longitudinal and the lateral force build up [m].

        Force over slip over the stiffness of the carcass, so shorter the more the tyre slides (Hirschberg et al. 2007,
        section 3, with the carcass's damping left out).
        """
        slip = slips(wheel, wheel.rolling_speed, self.standstill_speed)
        by_camber = self._camber_slip(wheel.camber, wheel.rolling_speed / slip.reference_speed)
        over_x, over_y = self._forces_over_slips(wheel, slip.longitudinal, slip.lateral + by_camber)
        return RelaxationLengths(over_x / self.longitudinal_stiffness, over_y / self.lateral_stiffness)

    def _load_ratio(self, load: Scalar) -> Scalar:
        """Over the nominal load; limited, because the parabola that describes load influence turns down beyond."""
        return ca.fmin(ca.fmax(load, SLIP.smallest_load) / self.nominal_load, LARGEST_LOAD_RATIO)

    def _forces_over_slips(self, wheel: TyreInput, slip_x: Scalar, slip_y: Scalar) -> tuple[Scalar, Scalar]:
        """Longitudinal and lateral force over the slip in the same direction [N]: positive everywhere."""
        ratio = self._load_ratio(wheel.load)
        x, y = self.longitudinal.at(ratio, wheel.friction), self.lateral.at(ratio, wheel.friction)

        # Normalising factors that make both directions comparable (Hirschberg et al. 2007, eqs. 9-11).
        range_x, range_y = x.maximum / x.initial_slope, y.maximum / y.initial_slope
        factor_x = x.slip_at_maximum / (x.slip_at_maximum + y.slip_at_maximum) + range_x / (range_x + range_y)
        factor_y = y.slip_at_maximum / (x.slip_at_maximum + y.slip_at_maximum) + range_y / (range_x + range_y)
        normal_x, normal_y = slip_x / factor_x, slip_y / factor_y
        # All slips of the curves go with the friction, and so must the one that counts as none, or a tyre on ice, whose
        # slips are small, would not be the dry one made smaller.
        none = SLIP.smallest_slip * wheel.friction
        slip = ca.sqrt(normal_x**2 + normal_y**2 + none**2)
        share_x = (normal_x**2 + 0.5 * none**2) / slip**2  # cos² of the slip direction; an even mix at zero slip

        def combine(along: Scalar, across: Scalar) -> Scalar:
            return ca.sqrt(along**2 * share_x + across**2 * (1 - share_x))

        combined = CurveAtLoad(
            initial_slope=combine(x.initial_slope * factor_x, y.initial_slope * factor_y),
            maximum=combine(x.maximum, y.maximum),
            slip_at_maximum=combine(x.slip_at_maximum / factor_x, y.slip_at_maximum / factor_y),
            sliding=combine(x.sliding, y.sliding),
            slip_at_sliding=combine(x.slip_at_sliding / factor_x, y.slip_at_sliding / factor_y),
        )
        force_over_slip = contact(wheel.load) * _force_over_slip(combined, slip)
        return force_over_slip / factor_x, force_over_slip / factor_y

    def _camber_slip(self, camber: Scalar, rolling: Scalar) -> Scalar:
        """Lateral slip to which inclination is equivalent; `rolling` is the rolling speed over its size."""
        return -self.camber_slip * ca.sin(camber) * rolling**2

    def _trail(self, load: Scalar, slip_y: Scalar) -> Scalar:
        """Pneumatic trail [m]: falls to zero, overshoots while the tyre slides more and more, and ends in full sliding.

        Hirschberg et al. 2007, section 2.5. It goes with the length of the contact patch, which grows with the square
        root of the load.
        """
        slip, end = ca.fabs(slip_y) / self.slip_of_no_trail, self.end_of_trail
        share = 1 / end
        adhering = (1 - share) * (1 - slip) + share * (1 - (3 - 2 * slip) * slip**2)
        sliding = -(1 - share) * (slip - 1) * (ca.fmax(end - slip, 0) / (end - 1)) ** 2
        return self.pneumatic_trail * ca.sqrt(self._load_ratio(load)) * ca.if_else(slip < 1, adhering, sliding)


def _force_over_slip(curve: CurveAtLoad, slip: Scalar) -> Scalar:
    """Force over a positive slip [N]: up to the maximum on a fraction, then down on a cubic, then constant."""
    adhesion = ca.fmin(slip / curve.slip_at_maximum, 1)
    steepness = curve.initial_slope * curve.slip_at_maximum / curve.maximum
    rising = curve.initial_slope / (1 + adhesion * (adhesion + steepness - 2))
    to_sliding = curve.slip_at_sliding - curve.slip_at_maximum
    sliding_share = ca.fmin(ca.fmax((slip - curve.slip_at_maximum) / to_sliding, 0), 1)
    falling = (curve.maximum - (curve.maximum - curve.sliding) * sliding_share**2 * (3 - 2 * sliding_share)) / slip
    return ca.if_else(slip < curve.slip_at_maximum, rising, falling)
