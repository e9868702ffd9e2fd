"""The road as a surface over the map: height, slope and grip as functions of place, the same on every pass.

Place is distance along the lane's path and offset to its left. Grade and bank have a constant part and a wave.
"""

from __future__ import annotations

import numpy as np

WAVE = 260.0  # [m] of grade and bank
UNDULATION = 7.0  # [m]
PATCHES = 130.0  # [m] from one wet patch to the next; half of the road is wet
ROUGH_WAVES = np.array([3.1, 6.9, 15.7, 37.0])  # [m] of a paved road; a height goes with the root of its length
ACROSS = 10.0  # [m]
_ROUGH_SHARES = np.sqrt(ROUGH_WAVES / (ROUGH_WAVES.sum() / 2))


def rough_phases(rng):
    """Phases of the unevenness of one road (waves, 4): long waves go across all of it, short ones do not."""
    phases = rng.uniform(0, 2 * np.pi, (len(ROUGH_WAVES), 2))
    phases[ROUGH_WAVES > ACROSS, 1] = phases[ROUGH_WAVES > ACROSS, 0]
    return np.tile(phases, 2)


def roughness(surface, along):
    """Height of the unevenness of every road [m] (4, lanes).

    surface: `rms` [m] (lanes,) and `phase` (waves, 4, lanes) as from `rough_phases`.
    """
    height = np.zeros_like(along)
    for length, share, phase in zip(ROUGH_WAVES, _ROUGH_SHARES, surface.phase, strict=True):
        height += share * np.sin(2 * np.pi / length * along + phase)
    return surface.rms * height


def slopes(knobs, along, across):
    """Grade along the path and bank across it (positive: left side higher) [rad]."""
    wave, short = 2 * np.pi * along / WAVE, 2 * np.pi * along / UNDULATION
    grade = knobs.grade * (0.6 + 0.4 * np.sin(wave)) + knobs.undulation * 2 * np.pi / UNDULATION * np.cos(short)
    bank = knobs.bank * (0.6 + 0.4 * np.cos(wave))
    twist = -knobs.bank * 0.4 * 2 * np.pi / WAVE * np.sin(wave)  # [rad/m]
    return grade + across * twist, bank


def height(knobs, along, across):
    """Height of the road [m] that belongs to `slopes`."""
    wave, short = 2 * np.pi * along / WAVE, 2 * np.pi * along / UNDULATION
    profile = knobs.grade * (0.6 * along + 0.4 * WAVE / (2 * np.pi) * (1 - np.cos(wave)))
    return profile + knobs.undulation * np.sin(short) + across * knobs.bank * (0.6 + 0.4 * np.cos(wave))


def grip(knobs, along, speed, wheel_side):
    """Friction relative to the dry road at four wheels (4, lanes)."""
    share = np.ones((4, 1))
    if knobs.any("friction_drop"):
        wave = np.sin(2 * np.pi * (along - knobs.friction_place) / PATCHES)
        share = share * (1 - knobs.friction_drop / (1 + np.exp(np.clip(-wave / 0.05, -40, 40))))
    if knobs.any("friction_drop_left"):
        share = share * np.where(wheel_side > 0, 1 - knobs.friction_drop_left, 1.0)
    if knobs.any("friction_fall_with_speed"):
        share = share * np.maximum(1 - knobs.friction_fall_with_speed * np.maximum(speed - 10, 0), 0.4)
    if knobs.any("front_grip_lost_beyond_speed"):
        limit = knobs.front_grip_lost_beyond_speed
        lost = np.where(limit > 0, 0.45 * np.clip((speed - limit) / 4, 0, 1), 0.0)
        front = np.array([1.0, 1.0, 0.0, 0.0])[:, None]
        share = share * (1 - lost * front)
    return share
