"""What all effects have in common: where they enter the equations of motion, and what is known of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.fields import FieldInfo

from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.moving_car import Corner, MovingCar
from vsense_ros.model.parameter import Part
from vsense_ros.model.schema.observer_settings import ObserverSettings
from vsense_ros.model.schema.physics import Axle, NominalPhysics
from vsense_ros.model.sensors import SensorBase

CORNERS = {"fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right"}
AXLES = ("front", "rear")
_PROFILE = "its profile along the road"
SPACING = 50.0  # [m] from one row of a profile to the next; so far beyond its last one a road is as everywhere

# What of a car an effect acts on, by the method with which it does.
_ACTS_ON = {
    "chassis": "chassis",
    "chassis_force": "chassis",
    "suspension_force": "suspension",
    "toe": "suspension",
    "front_angle": "steering",
    "wheel": "wheel",
    "wheel_torque": "wheel",
    "friction": "tyre",
    "lateral_speed": "tyre",
    "thrust": "tyre",
    "slope": "road",
    "sensors": "sensor",
}


def size(unit: str, description: str, *, typical: float, low: float | None = None, high: float) -> Any:
    """A field for how large an effect is, zero where it is absent.

    `typical` is the size that practice makes likely (the standard deviation of its prior); `low` (default `-high`) and
    `high` bound what is physical.
    """
    low = -high if low is None else low
    extra: dict[str, Any] = {"unit": unit, "typical": typical, "role": "size"}
    return Field(default=0.0, description=description, ge=low, le=high, json_schema_extra=extra)


def shape(unit: str, description: str, *, default: float, typical: float, low: float, high: float) -> Any:
    """A field for how an effect looks, without meaning while its sizes are zero; `typical` is how far it varies."""
    extra: dict[str, Any] = {"unit": unit, "typical": typical, "role": "shape"}
    return Field(default=default, description=description, ge=low, le=high, json_schema_extra=extra)


def form(description: str, *, default: float) -> Any:
    """A field between 0 and 1 that distinguishes the variants of an effect."""
    extra: dict[str, Any] = {"unit": "-", "typical": 0.5, "role": "form"}
    return Field(default=default, description=description, ge=0.0, le=1.0, json_schema_extra=extra)


class VehicleFile(Protocol):
    """A vehicle file, as far as priors of effects refer to it."""

    @property
    def physics(self) -> NominalPhysics:
        """Parameters of the equations of motion."""

    @property
    def observer(self) -> ObserverSettings:
        """Settings of the observer."""

    def sensing(self) -> Mapping[str, SensorBase]:
        """The sensors by name, with what the car's effects do to them."""


class Effect(Part):
    """A physical effect that a car, its road or its sensors may have, and that a model may lack.

    The fields are its parameters. Equations refer to them as `self.…`: they are numbers, or symbols where the effect is
    part of a `Car`. With all sizes zero an effect changes nothing. Methods return what they are given, changed; an
    effect overrides those that concern it. Vectors are in body axes.

    `internal_state` names the states of effects that depend on the past; `update` moves them on, and they are constant
    during a time step.
    """

    id: ClassVar[str]
    sentence: ClassVar[str]  # the physics in words, as the end of "the model leaves out …"
    known: ClassVar[bool] = True  # False: terms that describe, and explain nothing
    mistaken_for: ClassVar[tuple[str, ...]] = ()  # ids of effects that look alike
    # Other forms of the effect by the words for where it is, each with the values of its fields.
    variants: ClassVar[Mapping[str, Mapping[str, float]]] = MappingProxyType({})
    needs: ClassVar[tuple[str, ...]] = ()  # kinds of sensors without which nothing can be said of it
    # By what measures the motion of a car (gyro, accelerometer, or the kind of a sensor) the size that is how much
    # older than its stamps that one is [s].
    delays: ClassVar[Mapping[str, str]] = MappingProxyType({})
    on_map: ClassVar[bool] = False  # whether its sizes have directions on the map
    each: ClassVar[str] = "axis"  # what it has a size of each of, where that is neither wheel nor axle
    changes_sides: ClassVar[tuple[str, ...]] = ()  # sizes that change their sign where left and right are exchanged
    # True if its forces change so fast with the motion that a step without it in the Jacobian misses them
    abrupt: ClassVar[bool] = False
    internal_state: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        """Standard deviations, by field name, of the sizes that the effect has in every such car."""
        return {}

    @classmethod
    def handed(cls) -> tuple[str, ...]:
        """The sizes that mean something else where left and right are exchanged: they change their sign, or belong to a
        wheel of one side."""
        return tuple(name for name in cls.model_fields if name in cls.changes_sides or name in CORNERS)

    @classmethod
    def acts_on(cls) -> str:
        """Chassis, suspension, steering, wheel, tyre, road or sensor."""
        return next(part for method, part in _ACTS_ON.items() if getattr(cls, method) is not getattr(Effect, method))

    def chassis(self, mass: ca.SX, moment: ca.SX, inertia: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Mass [kg], first moment (3) [kg m] and inertia (3×3) [kg m²] of the sprung mass about `cog`."""
        return mass, moment, inertia

    def wheel(self, wheel: int, axle: Axle) -> Axle:
        """Parameters of one corner: those of its axle."""
        return axle

    def front_angle(self, angle: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        """Mean road-wheel angle of the front axle, positive to the left [rad]."""
        return angle

    def toe(self, angle: ca.SX, corner: Corner, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        """What a wheel is turned about the vertical beyond steering and suspension, positive to the left [rad]."""
        return angle

    def friction(self, friction: ca.SX, corner: Corner, load: ca.SX, internal_state: ca.SX) -> ca.SX:
        """Grip under a wheel with a load [N], relative to the road on which the tyre was measured [-]."""
        return friction

    def lateral_speed(self, speed: ca.SX, corner: Corner, internal_state: ca.SX) -> ca.SX:
        """Lateral velocity of the contact point that the tyre responds to [m/s]."""
        return speed

    def thrust(self, thrust: ca.SX, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
        """Lateral force that a tyre with a load [N] and an inclination [rad] makes without slip [N]; less where slip
        uses its grip."""
        return thrust

    def suspension_force(self, force: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        """Force that resists the compression of one wheel's suspension [N]."""
        return force

    def wheel_torque(self, torque: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        """Torque that drives a wheel [N m]."""
        return torque

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        """On the chassis besides suspensions and weight: moment about `cog` [N m] and force [N], 6×1."""
        return force

    def slope(self, turned: Any) -> tuple[Any, Any]:
        """Slopes of the road along and across the car, positive uphill and with the left side higher [rad], for a car
        that has `turned` to the left by so much since it set out [rad]; arrays over time, or numbers."""
        return 0.0, 0.0

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        """The internal state for a step of `h` [s] that begins now, from that of the last step."""
        return internal_state

    def relaxed(self, internal_state: NDArray[np.float64], duration: float) -> NDArray[np.float64]:
        """What is left of the internal state (as many as `internal_state`) where driving begins anew after a while [s],
        zero for at once: nothing, unless it lasts for longer than a car takes to settle."""
        return np.zeros_like(internal_state)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        """The settings of the sensors by name, with what the effect does to them."""
        return sensors

    @property
    def mean_slope(self) -> tuple[Any, Any]:
        """`slope` of a road that turns as the car does; zero for a plane, as whoever drives on it must know from which
        direction it came to it."""
        return constant if (constant := self.slope(0.0)) == self.slope(1.0) else (0.0, 0.0)

    @property
    def has_size(self) -> bool:
        """True if any of its sizes is not zero."""
        fields = type(self).model_fields.items()
        return any(getattr(self, name) for name, field in fields if role(field) == "size")

    def left_out_of_simulation(self) -> str:
        """What of it a simulation on a road of its own cannot have, in words; empty for nothing."""
        return ""

    def left_out_of_observer(self, sensors: Collection[SensorBase]) -> str:
        """What of it an observer with these sensors cannot have, in words; empty for nothing."""
        if self.on_map and self.has_size and not any(sensor.on_map for sensor in sensors):
            return "its direction on the map, as no sensor knows north"
        return ""


class RoadEffect(Effect):
    """An effect of the road: its one size may be another at every place, and then is a recorded input of the car rather
    than a constant of it."""

    profile: tuple[tuple[float, float, float, float], ...] = Field(
        default=(),
        description="rows of latitude and longitude [deg], direction of the road counter-clockwise from east [rad], "
        "and what the size is there beyond what it is everywhere; between them it is a natural cubic spline",
        json_schema_extra={"unit": "", "role": "profile"},
    )

    def left_out_of_simulation(self) -> str:
        return f"{_PROFILE}, as the simulated road is another" if self.profile else ""

    def left_out_of_observer(self, sensors: Collection[SensorBase]) -> str:
        if self.profile and self._is_plane:
            return self._without([_PROFILE])
        unplaced = self.profile and not any("position" in sensor.measures for sensor in sensors)
        return self._without([f"{_PROFILE}, as no sensor measures where the car is"] if unplaced else [])

    @classmethod
    def size_name(cls) -> str:
        """The field that is its one size."""
        return next(name for name, field in cls.model_fields.items() if role(field) == "size")

    @property
    def _is_plane(self) -> bool:
        """True if it is a slope that does not turn as the car does."""
        steep = self.model_copy(update={self.size_name(): 1.0})
        return type(self).slope is not Effect.slope and not any(steep.mean_slope)

    def _without(self, parts: list[str]) -> str:
        """Parts that are left out, a plane besides, and what there is instead."""
        slopes, plane = type(self).slope is not Effect.slope, self._is_plane and self.has_size
        parts += ["its plane, as it does not know how the car set out on it"] if plane else []
        estimated = ["the slope is estimated on the way"] if slopes and parts else []
        return "; ".join([*parts, *estimated])


def bounds(field: FieldInfo) -> tuple[float, float]:
    """Bounds of what is physical of a size, shape or form."""
    limits = {type(limit).__name__: limit for limit in field.metadata}
    return float(limits["Ge"].ge), float(limits["Le"].le)


def role(field: FieldInfo) -> str:
    """What a field of an effect is: `size`, `shape`, `form` or `profile`."""
    return str(field.json_schema_extra["role"]) if isinstance(field.json_schema_extra, dict) else ""


def of_axle(effect: Effect, corner: Corner) -> Any:
    """The effect's parameter `front` or `rear`."""
    return getattr(effect, AXLES[corner.index // 2])


def of_wheel(effect: Effect, corner: Corner) -> Any:
    """The effect's parameter `fl`, `fr`, `rl` or `rr`."""
    return getattr(effect, WHEELS[corner.index])


def of_kind(
    sensors: dict[str, SensorBase], kind: str, change: Callable[[Any], dict[str, object]]
) -> dict[str, SensorBase]:
    """The sensors, those of a kind with other settings: `change` gives the new ones of a sensor by name."""
    return {
        name: sensor.model_copy(update=change(sensor)) if sensor.kind == kind else sensor
        for name, sensor in sensors.items()
    }


def added(triple: tuple[float, float, float], index: int, value: float) -> tuple[float, float, float]:
    """Three numbers, one of them with `value` added."""
    numbers = list(triple)
    numbers[index] += value
    return (numbers[0], numbers[1], numbers[2])
