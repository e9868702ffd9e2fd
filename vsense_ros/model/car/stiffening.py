"""The stiffening of time steps against wheel slip."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from vsense_ros.model.coordinates import COORDINATES, SPEED_X, SPEED_Y, SPIN, YAW_RATE, X, Y, Z
from vsense_ros.model.moving_car import MovingCar
from vsense_ros.model.tyres.slip import transport_speed


@dataclass(frozen=True)
class StiffeningSettings:
    """Settings of `stiffening`; they act on the course of a step, not on what it converges to."""

    # Slope of the force over slip that steps assume, over the steepest of the tyre's curve: without a margin, remnants
    # of slip stay [-].
    slope_margin: float = 1.5
    # Speeds of sliding where the car begins to be stiffened with its wheel, and where it fully is [m/s].
    with_car: tuple[float, float] = (2.0, 1.0)
    # Speeds of sliding where steps begin to foresee how the car goes on, and where they fully do [m/s].
    steady: tuple[float, float] = (0.25, 0.5)


SETTINGS = StiffeningSettings()


def stiffening(car: MovingCar, settings: StiffeningSettings = SETTINGS) -> tuple[ca.SX, ca.SX, ca.SX]:
    """What a time step adds to the Jacobian of the dynamics by u, as a product of 14×4 and 4×14, and which part
    of the latter it applies to the rates at the beginning of the step instead, 4×14.

    Wheels are light and tyres steep: below 10 m/s slip changes faster than any affordable step. Where a tyre
    slides, the tangent to its flat force curve says nothing of the steep slope at zero slip that the step will come
    across, and the wheel would be thrown to and fro between the two for ever. With a slope steeper than the curve
    has anywhere, sliding goes down with each step.

    Of a wheel that sticks, or soon will, the additional force acts on wheel and car alike, here a rigid body in the
    plane, so that it takes no momentum from nowhere. Of one that slides on it acts on the wheel alone: sliding
    changes at the rate at which the car slows down, and a force that grew with this rate, which no tyre has, would
    push a car forward that brakes on locked wheels. Of a wheel in between, slower than both, the rate that the car
    has at the beginning of the step causes no such force, but what the step departs from it does.
    """
    chassis = car.parameters.chassis
    responses, slopes, foreseen = [], [], []
    for corner, wheel in zip(car.corners, car.contacts, strict=True):
        touch, spin = wheel.touch, SPIN.start + corner.index
        transport = transport_speed(wheel.rolling_speed, corner.axle.tyre.standstill_speed)
        steepest = corner.axle.tyre.steepest_slope(touch.load) / transport
        tangent = ca.jacobian(wheel.tyre.longitudinal, car.u[spin]) / touch.effective_radius
        excess = ca.fmax(settings.slope_margin * steepest - tangent, 0)
        sliding = ca.sqrt((wheel.rolling_speed - touch.speed_x) ** 2 + touch.speed_y**2)
        sticks = _ramp(tangent, 0, steepest)
        share = ca.fmax(sticks, _ramp(sliding, *settings.with_car))
        response = ca.SX.zeros(COORDINATES)
        response[SPEED_X : SPEED_Y + 1] = share * touch.ahead[X : Y + 1] / chassis.mass
        response[YAW_RATE] = share * ca.cross(touch.point, touch.ahead)[Z] / chassis.yaw_inertia
        response[spin] = -touch.effective_radius / corner.axle.wheel_spin_inertia
        responses.append(response)
        by_car = -excess * share * ca.jacobian(touch.speed_x, car.u)
        slopes.append(excess * ca.jacobian(wheel.rolling_speed, car.u) + by_car)
        foreseen.append((1 - sticks) * _ramp(sliding, *settings.steady) * by_car)
    return ca.horzcat(*responses), ca.vertcat(*slopes), ca.vertcat(*foreseen)


def _ramp(value: ca.SX, none: ca.SX | float, full: ca.SX | float) -> ca.SX:
    """0 before `none`, 1 beyond `full`, linear in between."""
    return ca.fmin(ca.fmax((value - none) / (full - none), 0), 1)
