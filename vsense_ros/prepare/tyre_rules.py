"""Tyre parameters from the size of a tyre and its load: a TMeasy tyre, the same on all wheels with the same size."""

from __future__ import annotations

from math import atan, degrees, hypot, sin
from typing import Any

from vsense_ros.errors import InputError
from vsense_ros.model.constants import GRAVITY
from vsense_ros.prepare.axle_rules import sizes
from vsense_ros.prepare.catalogue import CatalogueValues
from vsense_ros.prepare.estimated import Estimated
from vsense_ros.prepare.rules import Rules
from vsense_ros.prepare.tyre_size import TyreSize

_OVERLOAD = 1.1  # of the load capacity: more than that, no tyre is chosen for


def tyres(
    car: CatalogueValues, rules: Rules, of_body: dict[str, Estimated]
) -> tuple[dict[str, Any], dict[str, Estimated]]:
    """Tyre of each axle as in a vehicle file, by dotted path, and the scales of its stiffness and grip, in which all of
    its uncertainty is; `of_body` are the numbers of the body. Raises `InputError` for a tyre that is too small."""
    models: dict[str, Any] = {}
    scales: dict[str, Estimated] = {}
    for axle, size in sizes(car).items():
        arm = of_body[f"physics.chassis.cog_to_{'rear' if axle == 'front' else 'front'}_axle"].value
        load = car.mass * GRAVITY * arm / car.wheelbase / 2
        capacity = _capacity(size, rules)
        if load > _OVERLOAD * capacity.value:
            raise InputError(
                f"--tyre: each wheel at the {axle} carries {load:.0f} N, but a tyre {size.designation} at most about "
                f"{capacity.value:.0f} N; are mass and axle load in kg, and is this the tyre's size?"
            )
        models[f"physics.{axle}.tyre"] = _tmeasy(car.mass * GRAVITY / 4, capacity.value, size, rules)
        scales |= {f"physics.{axle}.{name}": scale for name, scale in _scales(axle, load, capacity, rules).items()}
    return models, scales


def _capacity(size: TyreSize, rules: Rules) -> Estimated:
    """Load that a tyre can carry [N]: by its load index, or usual for its size."""
    rule = rules["load_capacity"]
    if size.stated_load is not None:
        return Estimated(size.stated_load, 0.01 * size.stated_load)
    return rule.times(size.usual_load)


def _cornering_stiffness(load: float, capacity: float, rules: Rules) -> float:
    """Cornering stiffness of a tyre [N/rad] under a load [N] (Pacejka 2012, eq. 4.E25)."""
    largest = rules["peak_stiffness"].value * capacity
    return largest * sin(2 * atan(load / (rules["load_of_peak_stiffness"].value * capacity)))


def _tmeasy(nominal: float, capacity: float, size: TyreSize, rules: Rules) -> dict[str, Any]:
    """The tyre with its curves at the nominal load [N] and at twice that load."""
    slopes = [_cornering_stiffness(load, capacity, rules) for load in (nominal, 2 * nominal)]
    growth = rules["force_of_double_load"].value
    lateral = rules["friction"].value * nominal
    longitudinal = lateral * rules["longitudinal_over_lateral"].value
    slip_stiffness = rules["slip_stiffness"].value * nominal
    trail = rules["pneumatic_trail"].value * size.radius
    pairs = {
        "longitudinal": _curves((slip_stiffness, 1.9 * slip_stiffness), longitudinal, growth, rules),
        "lateral": _curves((slopes[0], slopes[1]), lateral, growth, rules),
    }
    past = pairs["lateral"]["nominal"]["slip_at_maximum"]
    return {
        "model": "tmeasy", "nominal_load": _rounded(nominal), **pairs, "pneumatic_trail": _rounded(trail),
        "slip_of_no_trail": _rounded(1.5 * past),
    }  # fmt: skip


def _curves(slopes: tuple[float, float], force: float, growth: float, rules: Rules) -> dict[str, dict[str, float]]:
    """Force curves at one and two nominal loads, from initial slopes and the largest force at the first."""
    stretch, sliding, sliding_slip = (rules[name].value for name in ("stretch", "sliding_share", "sliding_slip"))
    pair, first = {}, stretch * force / slopes[0]
    for name, slope, largest in (("nominal", slopes[0], force), ("double", slopes[1], growth * force)):
        slip = min(stretch * largest / slope, 1.8 * first)  # beyond twice it, curves at small loads would have none
        curve = {
            "initial_slope": slope, "maximum": largest, "slip_at_maximum": slip, "sliding": sliding * largest,
            "slip_at_sliding": sliding_slip * slip,
        }  # fmt: skip
        pair[name] = {key: _rounded(value) for key, value in curve.items()}
    return pair


def _scales(axle: str, load: float, capacity: Estimated, rules: Rules) -> dict[str, Estimated]:
    """What axle and road make of the tyre: the compliance of the axle adds to that of its tyres (Bundorf & Leffert
    1976)."""
    peak, place, added = rules["peak_stiffness"], rules["load_of_peak_stiffness"], rules[f"compliance_{axle}"]
    tyre = degrees(load / _cornering_stiffness(load, capacity.value, rules))  # [deg/g]
    share = tyre / (tyre + added.value)
    relative = hypot(peak.relative, place.relative / 2, share * added.deviation / tyre)
    friction, along, slip = rules["friction"], rules["longitudinal_over_lateral"], rules["slip_stiffness"]
    return {
        "cornering_scale": Estimated(share, share * relative, added.rule, added.source),
        "grip_scale": Estimated(1.0, hypot(friction.relative, along.relative / 2), friction.rule, friction.source),
        "longitudinal_scale": Estimated(1.0, slip.relative, slip.rule, slip.source),
    }


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
