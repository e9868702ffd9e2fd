"""The effects that one car has, applied together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

from vsense_ros.model.effects.base import Effect
from vsense_ros.model.moving_car import Corner, MovingCar
from vsense_ros.model.schema.physics import Axle


class PresentEffects:
    """The effects of a car, which change each term of its equations one after the other.

    `internal_state` is a vector of symbols for the effects that depend on the past: the parts of all effects one below
    the other. The methods are those of `Effect`; each effect is given its own part of the internal state.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = effects
        self.internal_state = ca.SX.sym("internal_state", sum(len(effect.internal_state) for effect in effects))
        self._states = tuple(self.internal_state[part] for part in self._parts())

    def _parts(self) -> Iterator[slice]:
        """The place of each effect in the internal state."""
        end = 0
        for effect in self._effects:
            yield slice(end, end := end + len(effect.internal_state))

    def _with_states(self) -> Iterator[tuple[Effect, ca.SX]]:
        return zip(self._effects, self._states, strict=True)

    @property
    def slices(self) -> dict[str, slice]:
        """The places in the internal state of the effects that have one, by id."""
        parts = zip(self._effects, self._parts(), strict=True)
        return {effect.id: part for effect, part in parts if effect.internal_state}

    def chassis(self, mass: ca.SX, moment: ca.SX, inertia: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        for effect in self._effects:
            mass, moment, inertia = effect.chassis(mass, moment, inertia)
        return mass, moment, inertia

    def wheel(self, wheel: int, axle: Axle) -> Axle:
        for effect in self._effects:
            axle = effect.wheel(wheel, axle)
        return axle

    def front_angle(self, angle: ca.SX, car: MovingCar) -> ca.SX:
        for effect, state in self._with_states():
            angle = effect.front_angle(angle, car, state)
        return angle

    def toe(self, angle: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        for effect, state in self._with_states():
            angle = effect.toe(angle, corner, car, state)
        return angle

    def friction(self, friction: ca.SX, corner: Corner, load: ca.SX) -> ca.SX:
        for effect, state in self._with_states():
            friction = effect.friction(friction, corner, load, state)
        return friction

    def lateral_speed(self, speed: ca.SX, corner: Corner) -> ca.SX:
        for effect, state in self._with_states():
            speed = effect.lateral_speed(speed, corner, state)
        return speed

    def thrust(self, thrust: ca.SX, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
        for effect in self._effects:
            thrust = effect.thrust(thrust, corner, load, inclination)
        return thrust

    def suspension_force(self, force: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        for effect in self._effects:
            force = effect.suspension_force(force, corner, car)
        return force

    def wheel_torque(self, torque: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        for effect in self._effects:
            torque = effect.wheel_torque(torque, corner, car)
        return torque

    def chassis_force(self, force: ca.SX, car: MovingCar) -> ca.SX:
        for effect, state in self._with_states():
            force = effect.chassis_force(force, car, state)
        return force

    def update(self, car: MovingCar, h: ca.SX) -> ca.SX:
        updated = (effect.update(state, car, h) for effect, state in self._with_states() if effect.internal_state)
        return ca.vertcat(*updated)
