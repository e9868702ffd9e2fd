"""Forces on the body itself: air, liquids, loose cargo, a trailer; and moments about cog, in body axes (3, lanes)."""

from __future__ import annotations

import numpy as np

from blind.cars import GRAVITY

GAS_CONSTANT = 287.05  # [J/(kg K)] of dry air
AIR_DENSITY = 101_325 / (GAS_CONSTANT * 293.15)
SIDE_AREA = 3.6  # [m²] times the slope of the side force, per sine of the flow angle
YAW_LEVER = 0.35  # [m] the side force acts ahead of cog
TRAILER_LENGTH = 3.2  # [m] hitch to axle
HITCH = 0.95  # [m] behind the rear axle
TRAILER_STIFFNESS = 9.0  # [1/rad] cornering stiffness over weight
CARGO_FRICTION = 0.33


def forces(car, knobs, motion, extra, rate, acceleration):
    """`acceleration`: specific force of cog along the body's axes (3, lanes), of the step before."""
    force = np.zeros_like(motion.velocity)
    moment = np.zeros_like(motion.velocity)
    _air(car, knobs, motion, force, moment)
    if knobs.any("slosh_mass"):
        _slosh(knobs, motion, extra, rate, acceleration, force, moment)
    if knobs.any("cargo_mass"):
        _cargo(knobs, extra, rate, acceleration, force, moment)
    if knobs.any("trailer_mass"):
        _trailer(car, knobs, motion, extra, rate, force, moment)
    return force, moment


def _air(car, knobs, motion, force, moment):
    wind = np.einsum("jin,jn->in", motion.rotation, knobs.wind)
    flow = motion.velocity - wind
    square = flow[0] * np.hypot(flow[0], flow[1])
    pressure = 0.5 * AIR_DENSITY
    drag = pressure * (car.drag_area + knobs.drag_area) * square
    force[0] -= drag
    if knobs.any("wind"):
        side = -pressure * SIDE_AREA * flow[1] * np.hypot(flow[0], flow[1])
        still = -pressure * SIDE_AREA * motion.velocity[1] * np.abs(motion.velocity[0])
        windy = (np.abs(knobs.wind).sum(axis=0) > 0) * (side - still)  # a car in still air is as the others
        force[1] += windy
        moment[2] += windy * YAW_LEVER
    if knobs.any("lift_area"):
        lift = pressure * knobs.lift_area * square
        force[2] += lift[0] + lift[1]
        moment[1] += -car.front_arm * lift[0] + car.rear_arm * lift[1]


def _slosh(knobs, motion, extra, rate, acceleration, force, moment):
    """The first mode of a liquid across the car, 0.05 m above cog and 0.15 m behind; its mass is the car's.

    A surface that tilts: what brings the mass back is its weight, so the length of a pendulum gives the frequency.
    """
    shift, speed = extra.slosh
    mass, length = knobs.slosh_mass, np.maximum(knobs.slosh_length, 0.05)
    damping = 2 * knobs.slosh_damping * np.sqrt(GRAVITY / length) * speed
    swing = np.where(mass > 0, -acceleration[1] - acceleration[2] * shift / length - damping, 0.0)
    rate.slosh[0], rate.slosh[1] = speed, swing
    push = -mass * swing
    force[1] += push
    moment[0] -= mass * acceleration[2] * shift + 0.05 * push
    moment[2] -= 0.15 * push


def _cargo(knobs, extra, rate, acceleration, force, moment):
    """A crate, 0.8 m behind cog, that slides across the floor when friction no longer holds it, up to the walls."""
    place, speed = extra.cargo
    mass, limit = knobs.cargo_mass, knobs.cargo_travel
    beyond = np.maximum(place - limit, 0.0) - np.maximum(-place - limit, 0.0)
    wall = 4e3 * beyond + 80.0 * speed * (beyond != 0)
    sliding = -acceleration[1] - CARGO_FRICTION * GRAVITY * np.tanh(speed / 0.02) - wall
    sliding = np.where(mass > 0, sliding, 0.0)
    rate.cargo[0], rate.cargo[1] = speed, sliding
    force[1] -= mass * sliding
    moment[0] -= mass * acceleration[2] * place
    moment[2] += 0.8 * mass * sliding


def _trailer(car, knobs, motion, extra, rate, force, moment):
    """A trailer with one axle: its yaw relative to the car, and what the hitch feels."""
    mass = knobs.trailer_mass
    angle, speed = extra.hitch
    forward = np.maximum(motion.velocity[0], 3.0)
    behind = car.rear_arm + HITCH
    hitch_lateral = motion.velocity[1] - behind * motion.rates[2]
    yaw = motion.rates[2] + speed
    slip = -(hitch_lateral * np.cos(angle) - forward * np.sin(angle) - TRAILER_LENGTH * yaw) / forward
    per_mass = TRAILER_STIFFNESS * GRAVITY * np.tanh(slip)
    side = mass * per_mass
    # Turned by its tyres about the hitch; the hitch's own acceleration enters through the slip alone.
    turning = -per_mass * TRAILER_LENGTH / (TRAILER_LENGTH**2 + 1.1)
    active = mass > 0
    rate.hitch[0], rate.hitch[1] = speed, np.where(active, turning - 2.0 * speed, 0.0)
    pull = -0.02 * mass * GRAVITY - 0.3 * side * np.sin(angle) - 0.6 * motion.velocity[0] * np.abs(motion.velocity[0])
    push = 0.25 * side * np.cos(angle)
    force[0] += np.where(active, pull, 0.0)
    force[1] += np.where(active, push, 0.0)
    force[2] -= np.where(active, 0.06 * mass * GRAVITY, 0.0)
    moment[2] -= np.where(active, behind * push, 0.0)
    moment[1] -= np.where(active, behind * 0.06 * mass * GRAVITY, 0.0)
