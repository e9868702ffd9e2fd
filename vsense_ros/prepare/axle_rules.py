"""Masses, springs, dampers and anti-roll bars of the axles, from how a body moves on them."""

from __future__ import annotations

from math import hypot, pi, radians

from vsense_ros.model.constants import GRAVITY
from vsense_ros.prepare.body_rules import sprung_mass
from vsense_ros.prepare.catalogue import CatalogueValues
from vsense_ros.prepare.estimated import Estimated
from vsense_ros.prepare.rules import Rules
from vsense_ros.prepare.tyre_size import TyreSize, tyre_size

AXLES = ("front", "rear")


def sizes(car: CatalogueValues) -> dict[str, TyreSize]:
    """The tyres of both axles. Raises `InputError` for a designation that names none."""
    return {"front": tyre_size(car.tyre), "rear": tyre_size(car.tyre_rear or car.tyre)}


def axles(car: CatalogueValues, rules: Rules, of_body: dict[str, Estimated]) -> dict[str, Estimated]:
    """Numbers of `physics.front` and `physics.rear` but for the tyres' forces, by dotted path; `of_body` are those of
    the body."""
    numbers = dict(of_body)
    for axle, size in sizes(car).items():
        track = car.track if axle == "front" else car.track_rear or car.track
        numbers |= {f"physics.{axle}.{name}": value for name, value in _unsprung(car, rules, size, track, axle).items()}
        numbers |= {f"physics.{axle}.{name}": value for name, value in _suspension(car, rules, numbers, axle).items()}
    numbers |= _bars(numbers, rules)
    return {name: value for name, value in numbers.items() if name not in of_body}


def _unsprung(car: CatalogueValues, rules: Rules, size: TyreSize, track: float, axle: str) -> dict[str, Estimated]:
    """What does not move with the body, and the tyre as a spring."""
    density, gyration = rules["wheel_density"], rules["wheel_gyration"]
    wheel = density.times(size.width * (2 * size.radius) ** 2)
    square = Estimated(gyration.value**2, 2 * gyration.value * gyration.deviation, gyration.rule, gyration.source)
    spin = square.times(wheel.value * size.radius**2, wheel.relative)
    pressure = rules["inflation"]
    stiffness = size.vertical_stiffness(1e3 * pressure.value)
    return {
        "track": Estimated(track, 0.01),
        "roll_centre_height": rules[f"roll_centre_{axle}"],
        "hub_mass": rules["hub_share"].times(car.mass),
        "wheel_mass": wheel,
        "wheel_spin_inertia": spin,
        "wheel_diametral_inertia": rules["diametral_over_spin"].times(spin.value, spin.relative),
        "unloaded_radius": Estimated(size.radius, 0.0).by(rules["radius_error"]).times(
            1.0, rules["radius_error"].deviation
        ),
        "tyre_stiffness": Estimated(stiffness, 0.0).by(rules["vertical_stiffness_error"]).times(
            1.0, rules["vertical_stiffness_error"].deviation, pressure.relative
        ),
        "tyre_damping": rules["tyre_damping"],
        "rolling_resistance": rules["rolling_resistance"],
    }  # fmt: skip


def _suspension(car: CatalogueValues, rules: Rules, numbers: dict[str, Estimated], axle: str) -> dict[str, Estimated]:
    """Springs by the natural frequency of the body on suspension and tyre, dampers by its damping ratio."""
    frequency, ratio = rules[f"bounce_frequency_{axle}"], rules["damping_ratio"]
    mass, tyre = sprung_mass(numbers, car, axle), numbers[f"physics.{axle}.tyre_stiffness"]
    ride = mass.value * (2 * pi * frequency.value) ** 2
    spring = ride * tyre.value / (tyre.value - ride)
    relative = hypot(2 * frequency.relative, mass.relative) * spring / ride
    damper = 2 * (spring * mass.value) ** 0.5
    return {
        "suspension_stiffness": Estimated(spring, spring * relative, frequency.rule, frequency.source),
        "suspension_damping": ratio.times(damper, frequency.relative, mass.relative),
    }


def _bars(numbers: dict[str, Estimated], rules: Rules) -> dict[str, Estimated]:
    """Anti-roll bars that bring the springs' roll stiffness to that of the roll gradient, shared as the load is."""
    chassis = {name: numbers[f"physics.chassis.{name}"].value for name in ("mass", "cog_height", "cog_to_rear_axle")}
    arms = [numbers[f"physics.chassis.cog_to_{axle}_axle"].value for axle in AXLES]
    unsprung = 2 * sum(numbers[f"physics.{a}.{part}"].value for a in AXLES for part in ("hub_mass", "wheel_mass"))
    share = chassis["cog_to_rear_axle"] / sum(arms)
    heights = [numbers[f"physics.{axle}.roll_centre_height"].value for axle in AXLES]
    arm = chassis["cog_height"] - (share * heights[0] + (1 - share) * heights[1])
    moment = (chassis["mass"] - unsprung) * arm  # per lateral acceleration [kg m]
    gradient = radians(rules["roll_gradient"].value) / GRAVITY  # [rad s²/m]
    total = moment / gradient + moment * GRAVITY
    shares = {"front": share + rules["front_roll_excess"].value}
    shares["rear"] = 1 - shares["front"]
    bars = {}
    for axle in AXLES:
        half_square = numbers[f"physics.{axle}.track"].value ** 2 / 2
        spring = numbers[f"physics.{axle}.suspension_stiffness"].value
        bar = max((shares[axle] * total / half_square - spring) / 2, 0.0)
        rule = rules["roll_gradient"]
        deviation = rules["roll_stiffness_error"].deviation * max(bar, 0.1 * spring)
        bars[f"physics.{axle}.antiroll_stiffness"] = Estimated(bar, deviation, rule.rule, rule.source)
    return bars
