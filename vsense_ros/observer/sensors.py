"""The sensors that a filter of the multibody car needs."""

from __future__ import annotations

from collections.abc import Mapping

from vsense_ros.errors import InputError
from vsense_ros.model.sensors import KINDS, SensorBase
from vsense_ros.model.vehicle import Vehicle


def sensors_of(vehicle: Vehicle) -> dict[str, SensorBase]:
    """Sensors of a vehicle by name, with what they take over from it. Raises `InputError` as `check_sensors`."""
    sensors = vehicle.sensing()
    check_sensors(vehicle, sensors)
    return sensors


def check_sensors(vehicle: Vehicle, sensors: Mapping[str, SensorBase]) -> None:
    """Raises `InputError` if no sensor measures the car's speed, or its steering angle."""
    kinds = sorted({sensor.kind for sensor in sensors.values()}) or "none"
    needed = {
        "the car's speed": {"rolling speed", "ground speed"},
        "how the car turns": {"steering", "rates and forces"},
    }
    for quantity, any_of in needed.items():
        if all(sensor.measures.isdisjoint(any_of) for sensor in sensors.values()):
            able = " or ".join(name for name, kind in KINDS.items() if not kind.measures.isdisjoint(any_of))
            raise InputError(
                f"{vehicle.name}: no sensor measures {quantity}; the vehicle file lists {kinds}, one of {able} is "
                "needed"
            )
