"""A trailer with one axle that a car tows by a drawbar: a caravan, a boat, a horse box.

Two bodies in a plane with a hinge at the hitch, which lies `d` behind the car's cog (Pacejka 2012, section 1.6, there
for small angles). γ is the articulation angle, from the car's heading to the trailer's, positive to the left. With the
trailer's yaw rate w = ψ̇ + γ̇, its cog e behind the hitch, its axle l behind the hitch, the specific force f of the hitch
in the trailer's axes, the force S of its tyres and the force D of the air and of rolling,

    (J + m e²) ẇ = m e f_y - l S - c γ̇,      H = m (f_x + e w², f_y - e ẇ) + (D, -S)

is its motion and the force of the car on it. f is what is left of the car's own after H has acted on the car at the
hitch: both are solved together, exactly, however large γ is. As both stand on one road, specific forces take the place
of accelerations, and grade and bank need no terms. The trailer's own roll and its overrun brake are left out.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import casadi as ca
from pydantic import Field, model_validator

from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import SPEED_X, SPEED_Y, YAW_RATE
from vsense_ros.model.effects.base import Effect
from vsense_ros.model.moving_car import MovingCar
from vsense_ros.model.parameter import Scalar, parameter
from vsense_ros.model.tyres.slip import transport_speed

STANDSTILL = 0.3  # [m/s] keeps the slip of the trailer's tyres finite at rest


def _by_mass(unit: str, words: str, rule: str, **limits: Any) -> Any:
    """A quantity that follows from the others by a rule where a file does not give it."""
    return Field(description=words, json_schema_extra={"unit": unit, "rule": rule}, default=0.0, **limits)


class Hitch(NamedTuple):
    """What happens at the hitch: the force of the car on the trailer in the axes of the car (2×1) [N], the derivative
    of the trailer's yaw rate [rad/s²], the slip angle at its axle [rad], and the rate at which the slip to which its
    tyres respond follows that [1/s]."""

    force: ca.SX
    spin_up: ca.SX
    slip: ca.SX
    following: Scalar

    def after(self, state: ca.SX, yaw_rate: ca.SX, h: ca.SX) -> ca.SX:
        """The trailer's state after `h` [s] behind a car with a yaw rate [rad/s]."""
        spin = state[1] + h * self.spin_up
        angle = state[0] + h * (spin - yaw_rate)
        return ca.vertcat(angle, spin, state[2] + (1 - ca.exp(-h * self.following)) * (self.slip - state[2]))


class Trailer(Effect):
    """A trailer with one axle. Only the mass has to be given; the rest follows from it as with a usual caravan.

    As part of a car it is an effect that depends on the past: articulation angle [rad], yaw rate of the trailer
    [rad/s], and slip angle to which its tyres respond [rad].
    """

    id: ClassVar[str] = "trailer"
    sentence: ClassVar[str] = "a trailer"
    internal_state: ClassVar[tuple[str, ...]] = ("articulation", "yaw_rate", "slip")

    mass: float = parameter("kg", "mass of the trailer with its load", gt=0, lt=4e4)
    length: float = _by_mass(
        "m", "from the hitch to the axle", "4.2 (mass / 1400 kg)^(1/3): trailers are alike in form", ge=0, lt=15
    )
    nose_load: float = _by_mass("kg", "mass that rests on the hitch, negative where it lifts", "0.05 mass", gt=-2e3)
    yaw_inertia: float = _by_mass("kg m²", "moment of inertia about z through its cog", "mass (0.35 length)²", ge=0)
    cornering_stiffness: float = _by_mass(
        "N/rad", "of its axle, all tyres together", "9 per rad times the weight on the axle", ge=0
    )
    drag_area: float = _by_mass("m²", "drag coefficient times frontal area behind the car", "0.08 length²", ge=0, lt=20)
    grip: float = parameter("-", "largest lateral force of its axle over the weight on it", gt=0, le=2, default=0.9)
    relaxation_length: float = parameter("m", "of its tyres", gt=0.01, lt=5, default=0.4)
    rolling_resistance: float = parameter("-", "of its tyres", ge=0, lt=0.2, default=0.012)
    overhang: float = parameter("m", "from the car's rear axle back to the hitch", gt=-5, lt=5, default=1.1)
    hitch_height: float = parameter("m", "of the hitch above the road", gt=0, lt=3, default=0.42)
    hitch_damping: float = parameter("N m s/rad", "of a stabiliser at the hitch, linear", ge=0, default=0.0)

    @model_validator(mode="before")
    @classmethod
    def _the_rest_follows_from_the_mass(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not isinstance(data.get("mass"), int | float) or not data["mass"] > 0:
            return data
        data = dict(data)
        mass = data["mass"]
        data.setdefault("length", 4.2 * (mass / 1400) ** (1 / 3))
        data.setdefault("nose_load", 0.05 * mass)
        if all(isinstance(data[name], int | float) for name in ("length", "nose_load")):
            data.setdefault("yaw_inertia", mass * (0.35 * data["length"]) ** 2)
            data.setdefault("cornering_stiffness", 9 * GRAVITY * (mass - data["nose_load"]))
            data.setdefault("drag_area", 0.08 * data["length"] ** 2)
        return data

    @model_validator(mode="after")
    def _it_can_be_a_trailer(self) -> Trailer:
        for name in ("length", "yaw_inertia", "cornering_stiffness"):
            if not getattr(self, name) > 0:
                raise ValueError(f"trailer.{name} is {getattr(self, name):g}, expected more than 0; leave it out "
                                 "if you do not know it")  # fmt: skip
        if not abs(self.nose_load) < 0.5 * self.mass:
            raise ValueError(
                f"trailer.nose_load is {self.nose_load:g} kg of {self.mass:g} kg, expected less than half: a trailer "
                "with one axle rests on it, and on the hitch by a few percent"
            )
        if self.yaw_inertia > self.mass * self.length**2:
            raise ValueError(
                f"trailer.yaw_inertia is {self.yaw_inertia:g} kg m², but with all mass {self.length:g} m away from its "
                f"cog it would be {self.mass * self.length**2:.4g} kg m²; is it about its cog, in kg m²?"
            )
        return self

    @property
    def cog(self) -> Scalar:
        """Distance of its centre of gravity behind the hitch [m]."""
        return self.length * (1 - self.nose_load / self.mass)

    def behind(self, cog_to_rear_axle: Scalar) -> Scalar:
        """Distance of the hitch behind the cog of the car [m]."""
        return cog_to_rear_axle + self.overhang

    def hitch(self, state: ca.SX, velocity: ca.SX, yaw_rate: Scalar, specific_force: ca.SX, compliance: ca.SX) -> Hitch:
        """What happens at the hitch. `state` as `internal_state`; `velocity` (2×1) [m/s] and `specific_force` (2×1)
        [m/s²] are those of the hitch in the axes of the car, the latter as it were without a force at the hitch, which
        takes `compliance` (2×1) [1/kg] times its components off."""
        angle, spin, slip = state[0], state[1], state[2]
        m, e = self.mass, self.cog
        about_hitch = self.yaw_inertia + m * e**2
        turn = ca.vertcat(ca.horzcat(ca.cos(angle), -ca.sin(angle)), ca.horzcat(ca.sin(angle), ca.cos(angle)))
        own = turn.T @ velocity
        ahead, aside = own[0], own[1] - self.length * spin
        speed = transport_speed(ahead, STANDSTILL)
        weight = (m - self.nose_load) * GRAVITY
        side = -self.grip * weight * ca.tanh(self.cornering_stiffness * slip / (self.grip * weight))
        drag = 0.5 * AIR_DENSITY * self.drag_area * ahead * ca.fabs(ahead)
        drag += self.rolling_resistance * weight * ahead / speed
        turning = -self.length * side - self.hitch_damping * (spin - yaw_rate)
        # In the trailer's axes H = diag(along, across) f + constant.
        across = m * self.yaw_inertia / about_hitch
        constant = turn @ ca.vertcat(m * e * spin**2 + drag, -m * e * turning / about_hitch - side)
        inertia = turn @ ca.diag(ca.vertcat(m, across)) @ turn.T
        force = ca.solve(ca.SX.eye(2) + inertia @ ca.diag(compliance), inertia @ specific_force + constant)
        felt = turn.T @ (specific_force - compliance * force)
        spin_up = (m * e * felt[1] + turning) / about_hitch
        return Hitch(force, spin_up, ca.atan(aside / speed), speed / self.relaxation_length)

    def _behind(self, car: MovingCar, state: ca.SX) -> Hitch:
        """What happens at the hitch of a car on whose wheels and body forces act."""
        chassis = car.parameters.chassis
        mass, inertia, d = chassis.mass, chassis.yaw_inertia, self.behind(chassis.cog_to_rear_axle)
        force, moment = ca.SX.zeros(3), self.hitch_damping * (state[1] - car.u[YAW_RATE])
        for contact in car.contacts:
            touch, tyre = contact.touch, contact.tyre
            on_wheel = tyre.longitudinal * touch.ahead + tyre.lateral * touch.sideways + touch.load * touch.normal
            force += on_wheel
            moment += ca.cross(touch.point, on_wheel)[2] + tyre.aligning_moment
        rate, speed = car.u[YAW_RATE], car.u[SPEED_X]
        force[0] -= 0.5 * AIR_DENSITY * car.parameters.aerodynamics.drag_area * speed * ca.fabs(speed)
        free = ca.vertcat(force[0] / mass + d * rate**2, force[1] / mass - d * moment / inertia)
        compliance = ca.vertcat(1 / mass, 1 / mass + d**2 / inertia)
        return self.hitch(state, ca.vertcat(speed, car.u[SPEED_Y] - d * rate), rate, free, compliance)

    def chassis_force(self, force: ca.SX, car: MovingCar, internal_state: ca.SX) -> ca.SX:
        chassis = car.parameters.chassis
        pull = self._behind(car, internal_state).force
        on_car = ca.vertcat(-pull, -self.nose_load * GRAVITY)
        at = ca.vertcat(-self.behind(chassis.cog_to_rear_axle), 0, self.hitch_height - chassis.cog_height)
        moment = ca.cross(at, on_car) + ca.vertcat(0, 0, self.hitch_damping * (internal_state[1] - car.u[YAW_RATE]))
        return force + ca.vertcat(moment, on_car)

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        return self._behind(car, internal_state).after(internal_state, car.u[YAW_RATE], h)
