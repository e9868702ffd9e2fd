"""Torques that reach the wheels, and those that the car's network tells of them (4, lanes) [N m]."""

from __future__ import annotations

import numpy as np

FADE_FLOOR = 0.5
SLIP_CONTROL = 0.07  # [-] and none is left at twice that


def told(car, demand, motion):
    """What engine and brakes give for a longitudinal acceleration that is asked for [m/s²], and what they tell of it.

    Anti-lock brakes and traction control take torque back from a wheel that slips by more than `SLIP_CONTROL`.
    """
    torque = demand * car.mass * car.radius.mean(axis=0)
    front = np.where(torque > 0, car.front_drive, car.front_brake)
    wheels = np.stack([front, front, 1 - front, 1 - front]) * torque / 2
    forward = np.maximum(motion.velocity[0] - car.side * car.track / 2 * motion.rates[2], 2.0)
    slip = (0.97 * car.radius * motion.spin - forward) / forward * np.sign(torque)
    return wheels * np.clip(2 - slip / SLIP_CONTROL, 0, 1)


def at_wheels(car, knobs, motion, extra, rate, told_torque, handwheel, lateral_acceleration):
    """With all that is not told."""
    torque = car.torque_gain * told_torque
    if knobs.any("shaft_frequency"):
        torque = _through_shafts(knobs, extra, rate, torque)
    if knobs.any("brake_fade"):
        power = np.maximum(-torque, 0.0) * np.maximum(motion.spin, 0.0)
        rate.brake_heat[...] = power.sum(axis=0) * 1e-6 - extra.brake_heat / 60
        left = np.maximum(1 - knobs.brake_fade * extra.brake_heat, FADE_FLOOR)
        torque = np.where(torque < 0, torque * left, torque)
    if knobs.any("brake_pull"):
        torque = np.where(torque < 0, torque * (1 + knobs.brake_pull * car.side), torque)
    if knobs.any("engine_drag"):
        share = np.stack([car.front_drive, car.front_drive, 1 - car.front_drive, 1 - car.front_drive]) / 2
        lifted = 1 / (1 + np.exp(np.clip(told_torque.sum(axis=0) / 15, -40, 40)))
        torque = torque - share * knobs.engine_drag * lifted
    rolling = np.tanh(motion.spin)
    torque = torque - knobs.brake_drag * rolling
    if knobs.any("esc_torque"):
        excess = np.maximum(np.abs(lateral_acceleration) - 4.0, 0.0)
        outer = np.maximum(-car.side * np.sign(lateral_acceleration), 0.0) * np.array([1, 1, 0, 0])[:, None]
        torque = torque - outer * knobs.esc_torque * excess
    if knobs.any("vectoring"):
        rear = np.array([0, 0, 1, 1])[:, None]
        torque = torque - car.side * rear * knobs.vectoring * handwheel
    if knobs.any("lock"):
        difference = np.stack([motion.spin[0] - motion.spin[1], motion.spin[2] - motion.spin[3]])
        clutch = knobs.lock * difference / np.sqrt(1 + (difference / 4) ** 2)
        torque = torque - car.side * np.repeat(clutch, 2, axis=0)
    return torque


def _through_shafts(knobs, extra, rate, torque):
    """Shafts ring at their frequency with a damping of 0.12."""
    drive = np.maximum(torque, 0.0).sum(axis=0)
    omega = 2 * np.pi * np.maximum(knobs.shaft_frequency, 1.0)
    value, slope = extra.shaft
    rate.shaft[0], rate.shaft[1] = slope, omega**2 * (drive - value) - 2 * 0.12 * omega * slope
    share = np.maximum(torque, 0.0) / np.maximum(drive, 1.0)
    ringing = np.where(knobs.shaft_frequency > 0, value - drive, 0.0)
    return torque + share * ringing
