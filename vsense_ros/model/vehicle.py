"""What a vehicle file says: the one schema behind validation, documentation, symbols and defaults.

Lengths in metres from `cog`, the centre of gravity in the design position; axes ISO 8855; SI units throughout.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from vsense_ros.model.effects import Effect, Effects
from vsense_ros.model.parameter import Part, Triple, numbers, parameter, vector, with_values
from vsense_ros.model.schema.drivetrain import Drivetrain
from vsense_ros.model.schema.linkage import Linkages
from vsense_ros.model.schema.observer_settings import ObserverSettings
from vsense_ros.model.schema.physics import NominalPhysics
from vsense_ros.model.schema.suspension_tables import SuspensionTables
from vsense_ros.model.schema.uncertainty import Uncertainty
from vsense_ros.model.sensors import SensorBase, any_sensor
from vsense_ros.model.trailer import Trailer

SWINGING_SHARE = 0.3  # of the car's mass at most: beyond, what is left is no rigid body with a pendulum on it


class Physics(NominalPhysics):
    """All parameters of the equations of motion: those of the nominal car, its trailer and its effects."""

    trailer: Trailer | None = Field(description="a trailer that the car tows", default=None)
    effects: Effects = Field(description="physical effects by id", default_factory=Effects)

    def acting(self) -> tuple[Effect, ...]:
        """What acts on the nominal car: the effects that the file lists, and a trailer."""
        return (*self.effects.present(), *(() if self.trailer is None else (self.trailer,)))


def _without_dots(name: str) -> str:
    if "." in name:
        raise ValueError(
            "expected a name without dots, which part keys in paths like sensors.imu.topic; write "
            f"{name.replace('.', '_')}"
        )
    return name


SensorName = Annotated[str, AfterValidator(_without_dots)]
if TYPE_CHECKING:
    Sensor = SensorBase
else:
    Sensor = any_sensor()


class Reference(Part):
    """Where the reference system of a recording sits, if it does not measure at cog; only comparisons use it."""

    position: Triple = parameter("m", "position of the reference point, in the axes of cog", default=(0.0, 0.0, 0.0))
    yaw: float = parameter("rad", "direction of its forward axis in the axes of cog", default=0.0)


class Vehicle(Part):
    """A vehicle file."""

    name: str = Field(description="name of the vehicle", min_length=1)
    source: str = Field(description="where the parameters come from", default="")
    physics: Physics
    linkage: Linkages | None = Field(description="suspension linkages, for the car with all its bodies", default=None)
    suspension: SuspensionTables | None = Field(
        description="kinematics of the suspensions; without, wheels travel on straight guides", default=None
    )
    drivetrain: Drivetrain = Drivetrain()
    sensors: dict[SensorName, Sensor] = Field(description="sensors by name", default_factory=dict)
    observer: ObserverSettings = ObserverSettings()
    reference: Reference = Reference()
    uncertainty: dict[str, Uncertainty] = Field(
        description="standard deviations of numbers of this file, by their dotted keys: where identification begins",
        default_factory=dict,
    )

    def __repr__(self) -> str:
        return f"<Vehicle: {self.name}>"

    __str__ = __repr__

    @model_validator(mode="after")
    def _uncertain_numbers_exist(self) -> Vehicle:
        for path in self.uncertainty:
            if self.number(path) is None:
                raise ValueError(
                    f"uncertainty has {path}, which is no number of this file; keys are dotted, such as "
                    "physics.chassis.mass or sensors.imu.position"
                )
        return self

    @model_validator(mode="after")
    def _what_is_measured_at_the_rear_wheels_steers_them(self) -> Vehicle:
        if not self.physics.steering.rear and any("rear steering" in s.measures for s in self.sensors.values()):
            raise ValueError(
                "a sensor measures the angle of the rear wheels, but physics.steering.rear says that they are not "
                "steered: set it to true"
            )
        return self

    @model_validator(mode="after")
    def _what_is_measured_of_a_trailer_is_towed(self) -> Vehicle:
        if self.physics.trailer is None and any(sensor.of_trailer for sensor in self.sensors.values()):
            raise ValueError(
                "a sensor measures the articulation of a trailer, but there is no physics.trailer: give it, of which "
                "mass is enough"
            )
        return self

    @model_validator(mode="after")
    def _estimated_parameters_exist_and_start_within_their_bounds(self) -> Vehicle:
        values = self.values()
        for name, settings in self.observer.parameters.items():
            if name not in values:
                nearest_names = ", ".join(get_close_matches(name, values, 3, 0.0))
                raise ValueError(
                    f"observer.parameters has {name}, which is no number below physics; nearest to it are "
                    f"{nearest_names}"
                )
            lower, upper = settings.bounds(values[name])
            if not lower <= values[name] <= upper:
                raise ValueError(
                    f"observer.parameters bounds {name} by {lower:g} and {upper:g}, but in the file it is "
                    f"{values[name]:g}"
                )
            for bound in (lower, upper):
                try:
                    with_values(self.physics, {name: bound})
                except ValueError as error:
                    raise ValueError(
                        f"observer.parameters bounds {name} by {bound:g}, which cannot be: {_reason(error)}; "
                        "give it other bounds, or a smaller deviation"
                    ) from None
        return self

    @model_validator(mode="after")
    def _the_car_stands_up_with_its_loads(self) -> Vehicle:
        """Refuses a file whose loads would tip the car over. A search may pass through such values: it is not
        checked."""
        chassis, front, rear, values = self.physics.chassis, self.physics.front, self.physics.rear, self.values()
        arms = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
        track = (front.track * arms[1] + rear.track * arms[0]) / sum(arms)  # beside cog
        for name, largest, expected in (
            (
                "effects.payload_offset.moment", chassis.mass * track / 2,
                "kg m, at which this car tips over; is it mass times offset?",
            ),
            (
                "effects.sloshing_load.mass", SWINGING_SHARE * chassis.mass,
                f"kg, {SWINGING_SHARE:g} of the car's mass; is it only what swings?",
            ),
        ):  # fmt: skip
            value = values.get(name, 0.0)
            if abs(value) >= largest:
                raise ValueError(f"physics.{name} is {value:g}; expected less than {largest:.4g} {expected}")
        return self

    def sensing(self) -> dict[str, SensorBase]:
        """The sensors of the car without a trailer's, with what they take over from the car, and with what its effects
        do to them."""
        sensors = {name: one for name, one in self.sensors_of_car().items() if not one.of_trailer}
        for effect in self.physics.effects.present():
            sensors = effect.sensors(sensors)
        return sensors

    def sensors_of_car(self) -> dict[str, SensorBase]:
        """The sensors with what they take over from the car, as they are without its effects."""
        around = self.observer.surroundings
        return {name: s.of_car(self.physics).of_surroundings(around) for name, s in self.sensors.items()}

    @classmethod
    def admit_kinds(cls) -> None:
        """Let vehicle files have sensors of all kinds in `sensors.KINDS`, where that has changed."""
        cls.model_fields["sensors"].annotation = dict[SensorName, any_sensor()]  # type: ignore[assignment,misc]
        cls.model_rebuild(force=True)

    def values(self) -> dict[str, float]:
        """Physical parameters by dotted name."""
        return dict(numbers(self.physics))

    def number(self, path: str) -> float | tuple[float, ...] | None:
        """The number, or the list of numbers, at a dotted path of the file such as `physics.chassis.mass` or
        `sensors.imu.position.0`; None where there is none."""
        node = self._at(path)[0]
        return node if isinstance(node, float | tuple) else None

    def unit(self, path: str) -> str:
        """The unit of the number at a dotted path; empty where there is none."""
        field = self._at(path)[1]
        extra = field.json_schema_extra if field is not None else None
        return str(extra.get("unit", "")) if isinstance(extra, dict) else ""

    def _at(self, path: str) -> tuple[Any, FieldInfo | None]:
        """What stands at a dotted path, and the field that it is, or is an element of; None for nothing."""
        node: Any = self
        field: FieldInfo | None = None
        for key in path.split("."):
            if isinstance(node, BaseModel) and key in type(node).model_fields:
                node, field = getattr(node, key), type(node).model_fields[key]
            elif isinstance(node, dict) and key in node:
                node = node[key]
            elif isinstance(node, tuple) and key.isdigit() and int(key) < len(node):
                node = node[int(key)]
            else:
                return None, None
        return node, field

    def deviations(self) -> dict[str, float]:
        """Standard deviations of physical parameters by the names of `values`, of those that the file has any for."""
        prefix = "physics."
        return {
            path.removeprefix(prefix): stated.deviation
            for path, stated in self.uncertainty.items()
            if path.startswith(prefix)
        }

    def with_deviations(self, changes: dict[str, float], source: str) -> Vehicle:
        """A copy in which physical parameters, by the names of `values`, have these standard deviations."""
        new = {f"physics.{name}": Uncertainty(deviation=value, source=source) for name, value in changes.items()}
        return self.model_copy(update={"uncertainty": {**self.uncertainty, **new}})

    def parameter_vector(self) -> NDArray[np.float64]:
        """Physical parameters in the order of `values`, (n,)."""
        return vector(self.physics)

    def with_parameters(self, changes: dict[str, float]) -> Vehicle:
        """A copy with other physical parameters, by dotted name (as in `values`)."""
        return self.model_copy(update={"physics": with_values(self.physics, changes)})


def left_out_of_observer(vehicle: Vehicle) -> str:
    """What of its effects the observer of a vehicle and its sensors leaves out, in words; empty for nothing."""
    sensors = vehicle.sensors.values()
    parts = {effect.id: effect.left_out_of_observer(sensors) for effect in vehicle.physics.effects.present()}
    return _left_out("the observer", parts)


def left_out_of_simulation(vehicle: Vehicle) -> str:
    """What of its effects a simulation of a vehicle leaves out, in words; empty for nothing."""
    parts = {effect.id: effect.left_out_of_simulation() for effect in vehicle.physics.effects.present()}
    return _left_out("the simulation", parts)


def _left_out(who: str, parts: dict[str, str]) -> str:
    parts_left_out = [f"of {id} {words}" for id, words in parts.items() if words]
    return f"{who} leaves out {', and '.join(parts_left_out)} (physics.effects)" if parts_left_out else ""


def _reason(error: ValueError) -> str:
    """The reason why the schema refuses a value."""
    faults = error.errors() if isinstance(error, ValidationError) else []
    return str(faults[0]["msg"]).removeprefix("Value error, ") if faults else str(error)
