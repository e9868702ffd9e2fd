"""The usual sensors of a car, and how far its observer trusts the model: both follow from rules and uncertainties."""

from __future__ import annotations

from collections.abc import Collection
from math import hypot, radians
from typing import Any

from vsense_ros.model.sensors import KINDS
from vsense_ros.prepare.axle_rules import AXLES
from vsense_ros.prepare.body_rules import cog_height
from vsense_ros.prepare.catalogue import CatalogueValues
from vsense_ros.prepare.estimated import Estimated
from vsense_ros.prepare.rules import Rules


def sensors(
    car: CatalogueValues, rules: Rules, topics: Collection[str] = ()
) -> tuple[dict[str, Any], dict[str, Estimated]]:
    """The section `sensors` of a vehicle file: inertial sensor, wheel speeds, steering wheel, GNSS, and a velocity in
    the axes of the car if its topic is among the `topics` of recordings; and how far the places may be off, by dotted
    path."""
    roof = rules["roof_height"] if car.height is None else Estimated(car.height, 0.02)
    above = round(roof.value - cog_height(car, rules).value, 2)
    antenna = [rules["antenna_place"].value, 0.0, above]
    sensor_settings: dict[str, Any] = {
        "imu": {"kind": "imu", "position": [rules["mounting_place"].value, 0.0, 0.0]},
        "wheel_speeds": {"kind": "wheel_speeds"},
        "steering": {"kind": "steering"},
        "position": {"kind": "gnss_position", "position": antenna},
        "velocity": {"kind": "gnss_velocity", "position": antenna},
    }
    places = {
        "sensors.imu.position": rules["mounting_place"],
        "sensors.position.position": rules["antenna_place"],
        "sensors.velocity.position": rules["antenna_place"],
    }
    if KINDS["body_velocity"].model_fields["topic"].default in topics:
        place = [rules["mounting_place"].value, 0.0, 0.0]
        sensor_settings["body_velocity"] = {"kind": "body_velocity", "position": place}
        places["sensors.body_velocity.position"] = rules["mounting_place"]
    return sensor_settings, places


def observer(car: CatalogueValues, rules: Rules, numbers: dict[str, Estimated]) -> dict[str, Any]:
    """The section `observer`: errors of the forces as large as the uncertainties of the tyres make them, those of the
    wheels as large as torques that nothing measures."""
    usual, unknown = rules["usual_acceleration"].value, rules["unknown_acceleration"].value
    chassis = {
        name: numbers[f"physics.chassis.{name}"].value
        for name in ("mass", "yaw_inertia", "cog_to_front_axle", "cog_to_rear_axle")
    }
    arms = chassis["cog_to_front_axle"], chassis["cog_to_rear_axle"]
    shares = arms[1] / car.wheelbase, arms[0] / car.wheelbase
    stiffness_errors = [numbers[f"physics.{axle}.cornering_scale"].relative for axle in AXLES]
    lateral = usual * hypot(*(share * error for share, error in zip(shares, stiffness_errors, strict=True)))
    moments = [share * arm * error for share, arm, error in zip(shares, arms, stiffness_errors, strict=True)]
    yaw = usual * chassis["mass"] * hypot(*moments) / chassis["yaw_inertia"]
    radius = numbers["physics.front.unloaded_radius"]
    spin = numbers["physics.front.wheel_spin_inertia"].value
    torque = unknown * chassis["mass"] * radius.value / 4
    offset = radians(rules["steering_wheel_offset"].deviation) / numbers["physics.steering.ratio"].value
    return {
        "force_errors": {
            "lateral": _rounded(lateral), "yaw": _rounded(yaw), "time_constant": 1.0,
            "wheel_spin": _rounded(torque / spin), "wheel_spin_time_constant": 5.0,
        },
        "surroundings": {
            "bank": rules["road_bank"].value,
            "radius_error": _rounded(radius.relative), "steering_offset": _rounded(offset),
            "load": _rounded(numbers["physics.chassis.mass"].deviation),
        },
    }  # fmt: skip


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")
