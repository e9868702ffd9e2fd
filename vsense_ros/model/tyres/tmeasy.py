"""TMeasy: a handling tyre model from a few parameters with physical meaning (Hirschberg, Rill & Weinfurter 2007).

Combined-slip forces with degressive load influence. Each force curve is given at the nominal load and at twice that
load by its initial slope, its maximum and the slip there, and the sliding force and the slip where it sets in.
Inclination acts as additional lateral slip, the lag behind the slip comes from the elasticity of the carcass.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Literal

import casadi as ca
from pydantic import model_validator

from vsense_ros.model.parameter import Part, parameter
from vsense_ros.model.tyres.slip import SMALLEST_LOAD, SMALLEST_SLIP, contact, slips

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


class LoadPair(Part):
    """A force curve at the nominal load and at twice the nominal load."""

    nominal: ForceCurve
    double: ForceCurve

    @model_validator(mode="after")
    def _curves_keep_their_shape_at_every_load(self) -> LoadPair:
        # Forces over load and slips are linear in the load, so looking at the ends of the range is enough.
        for ratio in (0.0, LARGEST_LOAD_RATIO):
            force = {
                name: 2 * near - far / 2 - (near - far / 2) * ratio
                for name in ("initial_slope", "maximum", "sliding")
                for near, far in [(getattr(self.nominal, name), getattr(self.double, name))]
            }
            slip = {
                name: near + (far - near) * (ratio - 1)
                for name in ("slip_at_maximum", "slip_at_sliding")
                for near, far in [(getattr(self.nominal, name), getattr(self.double, name))]
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


class TMeasy(Part):
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


def _force_at_load(nominal: ca.SX, double: ca.SX, ratio: ca.SX) -> ca.SX:
    """Quadratic load influence through zero, `nominal` at ratio 1 and `double` at 2 (Rill 2012, eq. 3.58)."""
    return ratio * (2 * nominal - 0.5 * double - (nominal - 0.5 * double) * ratio)


def _slip_at_load(nominal: ca.SX, double: ca.SX, ratio: ca.SX) -> ca.SX:
    """Linear load influence of a slip parameter."""
    return nominal + (double - nominal) * (ratio - 1)


def _curve(p: SimpleNamespace, load_ratio: ca.SX, friction: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    near, far = p.nominal, p.double
    slope = _force_at_load(near.initial_slope, far.initial_slope, load_ratio)
    maximum = friction * _force_at_load(near.maximum, far.maximum, load_ratio)
    sliding = friction * _force_at_load(near.sliding, far.sliding, load_ratio)
    slip_max = friction * _slip_at_load(near.slip_at_maximum, far.slip_at_maximum, load_ratio)
    slip_slide = friction * _slip_at_load(near.slip_at_sliding, far.slip_at_sliding, load_ratio)
    return slope, maximum, slip_max, sliding, slip_slide


def steepest_slope(p: SimpleNamespace, load: ca.SX) -> ca.SX:
    """Largest increase of longitudinal force per longitudinal slip at a wheel load, that at zero slip [N]."""
    ratio = _load_ratio(p, load)
    return _force_at_load(p.longitudinal.nominal.initial_slope, p.longitudinal.double.initial_slope, ratio)


def _load_ratio(p: SimpleNamespace, load: ca.SX) -> ca.SX:
    """Over the nominal load; limited, because the parabola that describes load influence turns down beyond."""
    return ca.fmin(ca.fmax(load, SMALLEST_LOAD) / p.nominal_load, LARGEST_LOAD_RATIO)


def cornering_stiffness(p: SimpleNamespace, load: ca.SX) -> ca.SX:
    """Lateral force per slip angle at zero slip [N/rad]."""
    return _force_at_load(p.lateral.nominal.initial_slope, p.lateral.double.initial_slope, _load_ratio(p, load))


def _forces_over_slips(
    p: SimpleNamespace, load: ca.SX, slip_x: ca.SX, slip_y: ca.SX, friction: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Longitudinal and lateral force over the slip in the same direction [N]: positive everywhere."""
    ratio = _load_ratio(p, load)

    slope_x, max_x, slip_max_x, slide_x, slip_slide_x = _curve(p.longitudinal, ratio, friction)
    slope_y, max_y, slip_max_y, slide_y, slip_slide_y = _curve(p.lateral, ratio, friction)

    # Normalising factors that make both directions comparable (Hirschberg et al. 2007, eqs. 9-11).
    range_x, range_y = max_x / slope_x, max_y / slope_y
    factor_x = slip_max_x / (slip_max_x + slip_max_y) + range_x / (range_x + range_y)
    factor_y = slip_max_y / (slip_max_x + slip_max_y) + range_y / (range_x + range_y)
    normal_x, normal_y = slip_x / factor_x, slip_y / factor_y
    slip = ca.sqrt(normal_x**2 + normal_y**2 + SMALLEST_SLIP**2)
    share_x = (normal_x**2 + 0.5 * SMALLEST_SLIP**2) / slip**2  # cos² of the slip direction; an even mix at zero slip

    def combine(x: ca.SX, y: ca.SX) -> ca.SX:
        return ca.sqrt(x**2 * share_x + y**2 * (1 - share_x))

    slope = combine(slope_x * factor_x, slope_y * factor_y)
    maximum = combine(max_x, max_y)
    slip_max = combine(slip_max_x / factor_x, slip_max_y / factor_y)
    sliding = combine(slide_x, slide_y)
    slip_slide = combine(slip_slide_x / factor_x, slip_slide_y / factor_y)

    adhesion = ca.fmin(slip / slip_max, 1)
    rising = slope / (1 + adhesion * (adhesion + slope * slip_max / maximum - 2))  # force over slip
    beyond = ca.fmin(ca.fmax((slip - slip_max) / (slip_slide - slip_max), 0), 1)
    falling = (maximum - (maximum - sliding) * beyond**2 * (3 - 2 * beyond)) / slip
    force_over_slip = ca.if_else(slip < slip_max, rising, falling)

    on_road = contact(load)
    return on_road * force_over_slip / factor_x, on_road * force_over_slip / factor_y


def forces(
    p: SimpleNamespace,
    load: ca.SX,
    speed_x: ca.SX,
    speed_y: ca.SX,
    rolling_speed: ca.SX,
    friction: ca.SX,
    camber: ca.SX | float = 0.0,
    side: float = 1.0,
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Forces and slips as `tyres.forces` describes them; `side` is without effect.

    A wheel that leans rolls like a cone: its tread is deflected towards the lean in the middle of the contact patch, on
    average as by a third of the slip at the ends (Hirschberg et al. 2007, section 2.6). That deflection is symmetric
    and has no trail.
    """
    transport, slip_x, slip_y = slips(rolling_speed, speed_x, speed_y, rolling_speed, p.standstill_speed)
    by_camber = _camber_slip(p, camber, rolling_speed / transport)
    over_x, over_y = _forces_over_slips(p, load, slip_x, slip_y + by_camber, friction)
    # The trail points against the direction of rolling.
    moment = -_trail(p, load, slip_y) * (rolling_speed / transport) * over_y * slip_y
    return over_x * slip_x, over_y * (slip_y + by_camber), moment, slip_x, slip_y


def _camber_slip(p: SimpleNamespace, camber: ca.SX | float, rolling: ca.SX) -> ca.SX:
    """Lateral slip to which inclination is equivalent; `rolling` is the rolling over the transport speed."""
    return -p.camber_slip * ca.sin(camber) * rolling**2


def _trail(p: SimpleNamespace, load: ca.SX, slip_y: ca.SX) -> ca.SX:
    """Pneumatic trail [m]: falls to zero, overshoots while the tyre slides more and more, and ends in full sliding.

    Hirschberg et al. 2007, section 2.5. It goes with the length of the contact patch, which grows with the square root
    of the load.
    """
    slip, end = ca.fabs(slip_y) / p.slip_of_no_trail, p.end_of_trail
    share = 1 / end
    adhering = (1 - share) * (1 - slip) + share * (1 - (3 - 2 * slip) * slip**2)
    sliding = -(1 - share) * (slip - 1) * (ca.fmax(end - slip, 0) / (end - 1)) ** 2
    return p.pneumatic_trail * ca.sqrt(_load_ratio(p, load)) * ca.if_else(slip < 1, adhering, sliding)


def relaxation_lengths(
    p: SimpleNamespace,
    load: ca.SX,
    speed_x: ca.SX,
    speed_y: ca.SX,
    rolling_speed: ca.SX,
    friction: ca.SX,
    camber: ca.SX | float = 0.0,
    side: float = 1.0,
) -> tuple[ca.SX, ca.SX]:
    """Distance over which the longitudinal and the lateral force build up [m].

    Force over slip over the stiffness of the carcass, so shorter the more the tyre slides (Hirschberg et al. 2007,
    section 3, with the carcass's damping left out).
    """
    transport, slip_x, slip_y = slips(rolling_speed, speed_x, speed_y, rolling_speed, p.standstill_speed)
    by_camber = _camber_slip(p, camber, rolling_speed / transport)
    over_x, over_y = _forces_over_slips(p, load, slip_x, slip_y + by_camber, friction)
    return over_x / p.longitudinal_stiffness, over_y / p.lateral_stiffness
