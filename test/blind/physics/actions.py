"""Everything that acts on the car at one instant, for a plant to turn into accelerations."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from blind.physics import body, driveline, state, strut, wheel

HANDS_TIME = 0.10  # [s] of the driver's arms


def actions(car, knobs, motion, extra_array, command, acceleration, formula):
    """Forces and torques, and the rates of the states in `state`.

    motion: rotation (body → map), position, velocity and rates (body axes), travel, travel_rate, spin, spin_angle, and
    the nearest point of the path; command: handwheel angle asked for and acceleration asked for; acceleration: specific
    force of cog of the step before, in body axes.
    """
    extra = state.split(extra_array)
    rate_array = np.zeros_like(extra_array)
    rate = state.split(rate_array)
    rate.hands[...] = (command.handwheel - extra.hands) / HANDS_TIME
    handwheel = extra.hands
    if knobs.any("free_play"):
        # A shaft that follows where the play has been taken up; stiff, but not infinitely.
        gap = extra.hands - extra.slack
        over = np.maximum(gap - knobs.free_play, 0.0) - np.maximum(-gap - knobs.free_play, 0.0)
        rate.slack[...] = over / 0.01
        handwheel = np.where(knobs.free_play > 0, extra.slack, handwheel)
    told = driveline.told(car, command.acceleration, motion)
    torque = driveline.at_wheels(car, knobs, motion, extra, rate, told, handwheel, acceleration[1])
    angle = wheel.steer_angles(car, knobs, extra, handwheel, motion.travel, torque)
    contact = wheel.contacts(car, knobs, motion, angle)
    force, moment, spin_torque, force_x, force_y = wheel.tyres(car, knobs, motion, extra, contact, formula, rate)
    body_force, body_moment = body.forces(car, knobs, motion, extra, rate, acceleration)
    return SimpleNamespace(
        point=contact.point, centre=contact.centre, force=force, moment=moment, spin_torque=spin_torque,
        axle_torque=torque, strut=strut.forces(car, knobs, motion, acceleration[1]), body_force=body_force,
        body_moment=body_moment, rate=rate_array, told=told, contact=contact, force_x=force_x, force_y=force_y,
    )  # fmt: skip
