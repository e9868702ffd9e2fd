"""The nominal car: parameters of its equations of motion, without effects.

Lengths in metres from `cog`, the centre of gravity in the design position; axes ISO 8855; SI units throughout.
"""

from __future__ import annotations

from pydantic import Field, model_validator

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.parameter import Part, parameter
from vsense_ros.model.tyres import AnyTyre


class Chassis(Part):
    """The whole car, wheels included."""

    mass: float = parameter("kg", "mass of the whole car", gt=0, lt=1e5)
    roll_inertia: float = parameter("kg m²", "moment of inertia of the whole car about x through cog", gt=0)
    pitch_inertia: float = parameter("kg m²", "moment of inertia of the whole car about y through cog", gt=0)
    yaw_inertia: float = parameter("kg m²", "moment of inertia of the whole car about z through cog", gt=0)
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


class SteeringSystem(Part):
    """Transmission from the steering wheel to the front wheels, and whether the rear wheels are steered, too."""

    ratio: float = parameter("-", "steering-wheel angle over road-wheel angle", gt=0, lt=100, default=16.0)
    ackermann: float = parameter(
        "-", "0: parallel wheels, 1: Ackermann geometry; suspension tables have their own", ge=-1, le=2, default=1.0
    )
    rear: bool = Field(
        description="whether the rear wheels are steered, by an angle that a sensor rear_steering measures",
        default=False,
    )


class Aerodynamics(Part):
    """Air forces on the body."""

    drag_area: float = parameter("m²", "drag coefficient times frontal area", ge=0, lt=20, default=0.0)


class RoadFriction(Part):
    """Grip of the road where no effect changes it."""

    friction: float = parameter(
        "-", "grip relative to the road on which the tyre was measured", gt=0, le=2, default=1.0
    )


class NominalPhysics(Part):
    """Parameters of the equations of motion of a car to which no effect is added."""

    chassis: Chassis
    front: Axle
    rear: Axle
    steering: SteeringSystem = SteeringSystem()
    aerodynamics: Aerodynamics = Aerodynamics()
    road: RoadFriction = RoadFriction()

    @model_validator(mode="after")
    def _the_chassis_keeps_mass_and_inertia(self) -> NominalPhysics:
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
            largest = chassis.mass * length**2
            if value <= least:
                raise ValueError(
                    f"chassis.{name} is {value:g} kg m², but hubs and wheels alone have {least:.4g} kg m²; "
                    "the inertia of the whole car is expected"
                )
            if value >= largest:
                raise ValueError(
                    f"chassis.{name} is {value:g} kg m², but with all mass {length:g} m away from cog it would be "
                    f"{largest:.4g} kg m²; is the unit kg m²?"
                )
        for place, axle, arm in (("front", self.front, arms[1]), ("rear", self.rear, arms[0])):
            load = chassis.mass * GRAVITY * arm / wheelbase / 2
            if axle.suspension_stiffness < load:  # such a spring would be compressed by more than a metre at rest
                raise ValueError(
                    f"{place}.suspension_stiffness is {axle.suspension_stiffness:g} N/m under a wheel load of "
                    f"{load:.0f} N; is the unit N/m?"
                )
        return self
