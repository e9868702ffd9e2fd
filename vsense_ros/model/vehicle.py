"""What a vehicle file says: the one schema behind validation, documentation, symbols and defaults.

Lengths in metres from `cog`, the centre of gravity in the design position; axes ISO 8855; SI units throughout.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, ValidationError, model_validator

from vsense_ros.model.car.linkage import Linkages
from vsense_ros.model.car.suspension import SuspensionTables
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.effects import Effects
from vsense_ros.model.observer_settings import ObserverSettings
from vsense_ros.model.parameter import Part, numbers, parameter, vector, with_values
from vsense_ros.model.sensors import SensorBase, any_sensor
from vsense_ros.model.sensors.base import Triple
from vsense_ros.model.tyres import AnyTyre

SWINGING_SHARE = 0.3  # of the car's mass at most: beyond, what is left is no rigid body with a pendulum on it


class Chassis(Part):
    """The whole car, wheels included."""

    mass: float = parameter("kg", "mass of the whole car", gt=0, lt=1e5)
    roll_inertia: float = parameter("kg m²", "moment of inertia of the whole car about x through cog", gt=0)
    pitch_inertia: float = parameter("kg m²", "about y", gt=0)
    yaw_inertia: float = parameter("kg m²", "about z", gt=0)
    cog_height: float = parameter("m", "height of cog above the road in the design position", gt=0, lt=5)
    cog_to_front_axle: float = parameter("m", "distance from cog to the front axle", gt=0, lt=10)
    cog_to_rear_axle: float = parameter("m", "distance from cog to the rear axle", gt=0, lt=10)


class Axle(Part):
    """One axle with two equal wheels."""

    track: float = parameter("m", "distance between the wheel centres", gt=0, lt=5)
    roll_centre_height: float = parameter(
        "m", "height of the roll centre above the road; suspension tables have their own", ge=-0.5, le=1, default=0.0
    )
    hub_mass: float = parameter("kg", "unsprung mass of one corner without the wheel", gt=0)
    wheel_mass: float = parameter("kg", "mass of one wheel with tyre", gt=0)
    wheel_spin_inertia: float = parameter("kg m²", "moment of inertia of one wheel about its axle", gt=0)
    wheel_diametral_inertia: float = parameter("kg m²", "moment of inertia of one wheel about a diameter", gt=0)
    suspension_stiffness: float = parameter("N/m", "spring rate at the wheel", gt=0)
    suspension_damping: float = parameter("N s/m", "damper rate at the wheel", ge=0)
    antiroll_stiffness: float = parameter(
        "N/m", "force at the wheel per difference in travel of left and right", ge=0, default=0.0
    )
    unloaded_radius: float = parameter("m", "radius of the unloaded tyre", gt=0.05, lt=2)
    tyre_stiffness: float = parameter("N/m", "vertical stiffness of the tyre", gt=1e3)
    tyre_damping: float = parameter("N s/m", "vertical damping of the tyre", ge=0, default=0.0)
    dynamic_radius_factor: float = parameter(
        "-", "effective rolling radius: this share of the unloaded and the rest of the loaded radius", ge=0, le=1,
        default=2 / 3,
    )  # fmt: skip
    rolling_resistance: float = parameter("-", "rolling resistance coefficient", ge=0, lt=0.2, default=0.012)
    tyre: AnyTyre = Field(description="tyre model and its parameters")
    grip_scale: float = parameter("-", "grip of the tyres over that of the tyre's parameters", gt=0, le=5, default=1.0)
    cornering_scale: float = parameter(
        "-", "cornering stiffness of the axle over that of the tyre's parameters", gt=0, le=5, default=1.0
    )
    longitudinal_scale: float = parameter(
        "-", "longitudinal stiffness of the axle's tyres over that of the tyre's parameters", gt=0, le=5, default=1.0
    )


class Steering(Part):
    """From the steering wheel to the front wheels."""

    ratio: float = parameter("-", "steering-wheel angle over road-wheel angle", gt=0, lt=100, default=16.0)
    ackermann: float = parameter(
        "-", "0: parallel wheels, 1: Ackermann geometry; suspension tables have their own", ge=-1, le=2, default=1.0
    )


class Aerodynamics(Part):
    """Air forces on the body."""

    drag_area: float = parameter("m²", "drag coefficient times frontal area", ge=0, lt=20, default=0.0)


class Road(Part):
    """The road, as far as it is taken to be known."""

    friction: float = parameter(
        "-", "grip relative to the road on which the tyre was measured", gt=0, le=2, default=1.0
    )


class Physics(Part):
    """All that enters the equations of motion."""

    chassis: Chassis
    front: Axle
    rear: Axle
    steering: Steering = Steering()
    aerodynamics: Aerodynamics = Aerodynamics()
    road: Road = Road()
    effects: Effects = Field(description="physical effects by id", default_factory=Effects)

    @model_validator(mode="after")
    def _the_chassis_keeps_mass_and_inertia(self) -> Physics:
        unsprung = 2 * sum(a.hub_mass + a.wheel_mass for a in (self.front, self.rear))
        if unsprung >= 0.8 * self.chassis.mass:
            raise ValueError(
                f"hubs and wheels together have {unsprung:g} kg of the car's {self.chassis.mass:g} kg; "
                "chassis.mass is the mass of the whole car"
            )
        chassis = self.chassis
        arms = (chassis.cog_to_front_axle, chassis.cog_to_rear_axle)
        wheelbase = sum(arms)
        roll = pitch = yaw = 0.0
        for axle, arm in zip((self.front, self.rear), arms, strict=True):
            mass = 2 * (axle.hub_mass + axle.wheel_mass)
            below = chassis.cog_height - axle.unloaded_radius
            roll += mass * (axle.track**2 / 4 + below**2) + 2 * axle.wheel_diametral_inertia
            pitch += mass * (arm**2 + below**2) + 2 * axle.wheel_spin_inertia
            yaw += mass * (arm**2 + axle.track**2 / 4) + 2 * axle.wheel_diametral_inertia
        width = max(self.front.track, self.rear.track)
        for name, value, least, length in (
            ("roll_inertia", chassis.roll_inertia, roll, width),
            ("pitch_inertia", chassis.pitch_inertia, pitch, wheelbase),
            ("yaw_inertia", chassis.yaw_inertia, yaw, wheelbase),
        ):
            most = chassis.mass * length**2
            if value <= least:
                raise ValueError(
                    f"chassis.{name} is {value:g} kg m², but hubs and wheels alone have {least:.4g} kg m²; "
                    "the inertia of the whole car is expected"
                )
            if value >= most:
                raise ValueError(
                    f"chassis.{name} is {value:g} kg m², but with all mass {length:g} m away from cog it would be "
                    f"{most:.4g} kg m²; is the unit kg m²?"
                )
        for place, axle, arm in (("front", self.front, arms[1]), ("rear", self.rear, arms[0])):
            load = chassis.mass * GRAVITY * arm / wheelbase / 2
            if axle.suspension_stiffness < load:  # such a spring would be compressed by more than a metre at rest
                raise ValueError(
                    f"{place}.suspension_stiffness is {axle.suspension_stiffness:g} N/m under a wheel load of "
                    f"{load:.0f} N; is the unit N/m?"
                )
        return self


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

    position: Triple = parameter("m", "the point it refers to, in the axes of cog", default=(0.0, 0.0, 0.0))
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
    sensors: dict[SensorName, Sensor] = Field(description="sensors by name", default_factory=dict)
    observer: ObserverSettings = ObserverSettings()
    reference: Reference = Reference()

    @model_validator(mode="after")
    def _estimated_parameters_exist_and_start_within_their_bounds(self) -> Vehicle:
        known = self.values()
        for name, settings in self.observer.parameters.items():
            if name not in known:
                alike = ", ".join(get_close_matches(name, known, 3, 0.0))
                raise ValueError(
                    f"observer.parameters has {name}, which is no number below physics; nearest to it are {alike}"
                )
            lower, upper = settings.bounds(known[name])
            if not lower <= known[name] <= upper:
                raise ValueError(
                    f"observer.parameters bounds {name} by {lower:g} and {upper:g}, but in the file it is "
                    f"{known[name]:g}"
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
        """Of files alone: a search may pass through what no car can be."""
        chassis, front, rear, values = self.physics.chassis, self.physics.front, self.physics.rear, self.values()
        arms = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
        track = (front.track * arms[1] + rear.track * arms[0]) / sum(arms)  # beside cog
        for name, most, expected in (
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
            if abs(value) >= most:
                raise ValueError(f"physics.{name} is {value:g}; expected less than {most:.4g} {expected}")
        return self

    def sensing(self) -> dict[str, SensorBase]:
        """The sensors with what they take over from the car, and with what its effects do to them."""
        sensors = self.sensors_of_car()
        for effect in self.physics.effects.present():
            sensors = effect.sensors(sensors)
        return sensors

    def sensors_of_car(self) -> dict[str, SensorBase]:
        """The sensors with what they take over from the car, as they are without its effects."""
        return {name: sensor.of_car(self) for name, sensor in self.sensors.items()}

    @classmethod
    def admit_kinds(cls) -> None:
        """Let vehicle files have sensors of all kinds in `sensors.KINDS`, where that has changed."""
        cls.model_fields["sensors"].annotation = dict[SensorName, any_sensor()]  # type: ignore[assignment,misc]
        cls.model_rebuild(force=True)

    def values(self) -> dict[str, float]:
        """Physical parameters by dotted name."""
        return dict(numbers(self.physics))

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
    found = [f"of {id} {words}" for id, words in parts.items() if words]
    return f"{who} leaves out {', and '.join(found)} (physics.effects)" if found else ""


def _reason(error: ValueError) -> str:
    """What the schema has against a value."""
    faults = error.errors() if isinstance(error, ValidationError) else []
    return str(faults[0]["msg"]).removeprefix("Value error, ") if faults else str(error)
