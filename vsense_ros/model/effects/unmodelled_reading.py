"""What an inertial sensor reads besides, of which only the form is known: fitted where nothing else explains it."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import create_model

from vsense_ros.model.effects.base import Effect, of_kind, size
from vsense_ros.model.sensors import Imu, SensorBase

_AXES = {"x": "roll", "y": "pitch", "z": "yaw"}
_ALONG = {"x": "longitudinal", "y": "lateral", "z": "vertical"}


class _UnmodelledReading(Effect):
    """A sum of terms, each a reading of a gyro or an accelerometer that follows what accelerometers feel."""

    id: ClassVar[str] = "unmodelled_reading"
    sentence: ClassVar[str] = "a reading that follows what an accelerometer feels"
    known: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        def with_defects(imu: Imu) -> dict[str, object]:
            defects = {
                "force_scale": tuple(getattr(self, f"accelerometer_{a}_scale") for a in _AXES),
                "force_square": tuple(getattr(self, f"accelerometer_{a}_square") for a in _AXES),
                "force_odd_square": (*(getattr(self, f"accelerometer_{a}_odd_square") for a in "xy"), 0.0),
                "rate_by_force": tuple((*(getattr(self, f"gyro_{a}_by_{b}") for b in "xy"), 0.0) for a in _AXES),
            }
            return {name: tuple(_sum(getattr(imu, name), defect)) for name, defect in defects.items()}

        return of_kind(sensors, "imu", with_defects)


def _sum(present: Any, added: Any) -> Any:
    """The sum of two tuples of numbers or of tuples."""
    if not isinstance(present, tuple):
        return present + added
    return tuple(_sum(a, b) for a, b in zip(present, added, strict=True))


def _fields() -> dict[str, Any]:
    fields = {}
    for axis, along in _ALONG.items():
        words = f"a reading of the {along} acceleration that"
        fields[f"accelerometer_{axis}_scale"] = float, size("-", f"{words} is a multiple of it", typical=0.02, high=0.5)
        square = f"{words} grows with its square"
        fields[f"accelerometer_{axis}_square"] = float, size("1/(m/s²)", square, typical=0.003, high=0.1)
        if axis != "z":  # its sign never changes
            fields[f"accelerometer_{axis}_odd_square"] = (
                float,
                size("1/(m/s²)", f"{square} to either side", typical=0.003, high=0.1),
            )
    for axis, direction in _AXES.items():
        for along in "xy":
            fields[f"gyro_{axis}_by_{along}"] = float, size(
                "rad/s/(m/s²)", f"a reading of the {direction} rate that follows the {_ALONG[along]} acceleration",
                typical=0.001, high=0.1,
            )  # fmt: skip
    return fields


UnmodelledReading: type[Effect] = create_model("UnmodelledReading", __base__=_UnmodelledReading, **_fields())
