"""Mass, centre of gravity, inertias, steering and drag of a car, from what a catalogue says and rules."""

from __future__ import annotations

from math import hypot

from vsense_ros.prepare.catalogue import CatalogueValues
from vsense_ros.prepare.estimated import Estimated
from vsense_ros.prepare.rules import Rules

_LESS_AT_FRONT = {"front": 0.0, "rear": 0.04, "all": 0.02}  # as the rule front_load_share says


def body(car: CatalogueValues, rules: Rules) -> dict[str, Estimated]:
    """Numbers of `physics.chassis`, `physics.steering` and `physics.aerodynamics` by dotted path."""
    mass = Estimated(car.mass, rules["mass_error"].deviation * car.mass)
    share = front_share(car, rules)
    behind = Estimated(car.wheelbase * (1 - share.value), car.wheelbase * share.deviation, share.rule, share.source)
    ahead = Estimated(car.wheelbase * share.value, car.wheelbase * share.deviation, share.rule, share.source)
    index, pitch, roll = rules["dynamic_index"], rules["pitch_over_yaw_inertia"], rules["roll_gyration"]
    yaw = index.times(mass.value * behind.value * ahead.value, mass.relative)
    width = (car.track + (car.track_rear or car.track)) / 2
    square = Estimated(roll.value**2, 2 * roll.value * roll.deviation, roll.rule, roll.source)
    return {
        "physics.chassis.mass": mass,
        "physics.chassis.roll_inertia": square.times(mass.value * width**2, mass.relative),
        "physics.chassis.pitch_inertia": pitch.times(yaw.value, yaw.relative),
        "physics.chassis.yaw_inertia": yaw,
        "physics.chassis.cog_height": cog_height(car, rules),
        "physics.chassis.cog_to_front_axle": behind,
        "physics.chassis.cog_to_rear_axle": ahead,
        "physics.steering.ratio": _ratio(car, rules),
        "physics.steering.ackermann": rules["ackermann"],
        "physics.aerodynamics.drag_area": rules["drag_area"],
    }


def front_share(car: CatalogueValues, rules: Rules) -> Estimated:
    """Share of the mass on the front axle [-]."""
    if car.axle_load_front is not None:
        return Estimated(car.axle_load_front / car.mass, rules["front_load_error"].deviation)
    usual = rules["front_load_share"]
    return Estimated(usual.value - _LESS_AT_FRONT[car.driven], usual.deviation, usual.rule, usual.source)


def cog_height(car: CatalogueValues, rules: Rules) -> Estimated:
    """Height of the centre of gravity [m]."""
    return rules["cog_height"] if car.height is None else rules["cog_over_roof"].times(car.height)


def sprung_mass(numbers: dict[str, Estimated], car: CatalogueValues, axle: str) -> Estimated:
    """Mass that a suspension of the axle carries [kg], one side of the car."""
    arm = "cog_to_rear_axle" if axle == "front" else "cog_to_front_axle"
    mass, distance = numbers["physics.chassis.mass"], numbers[f"physics.chassis.{arm}"]
    unsprung = [numbers[f"physics.{axle}.{part}"] for part in ("hub_mass", "wheel_mass")]
    load = mass.value * distance.value / car.wheelbase / 2
    return Estimated(
        load - sum(part_mass.value for part_mass in unsprung),
        hypot(load * mass.relative, load * distance.relative, *(part_mass.deviation for part_mass in unsprung)),
    )


def _ratio(car: CatalogueValues, rules: Rules) -> Estimated:
    if car.steering_ratio is None:
        return rules["steering_ratio"]
    return Estimated(car.steering_ratio, rules["given_ratio_error"].deviation * car.steering_ratio)
