"""The road as a surface over the map: height, slope and grip as functions of place, the same on every pass.

Place is distance along the lane's path and offset to its left. Free of drifts: no grade at the start of a recording
would be absorbed by the first seconds, so profiles have a constant part and a wave.
"""

from __future__ import annotations

import numpy as np

WAVE = 260.0  # [m] of grade and bank
ROUGH = 7.0  # [m] of an undulation
PATCHES = 130.0  # [m] from one wet patch to the next; half of the road is wet


ROUGH_WAVES = np.geomspace(3.0, 40.0, 7)  # [m] of a paved road; a height goes with the root of its length (ISO 8608)


def roughness(surface, along, wheel_side):
    """Height of unevenness that no one intends [m], different under left and right wheels (4, lanes).

    surface: `rms` [m] (lanes,) and `phase` (2, waves, lanes).
    """
    height = np.zeros_like(along)
    scale = np.sqrt(ROUGH_WAVES / (ROUGH_WAVES.sum() / 2))
    for i, (length, share) in enumerate(zip(ROUGH_WAVES, scale, strict=True)):
        phase = np.where(wheel_side > 0, surface.phase[0, i], surface.phase[1, i])
        height += share * np.sin(2 * np.pi * along / length + phase)
    return surface.rms * height


def slopes(knobs, along):
    """Grade along the path and bank across it (positive: left side higher) [rad], at a distance along it [m]."""
    wave = 2 * np.pi * along / WAVE
    grade = knobs.grade * (0.6 + 0.4 * np.sin(wave)) + knobs.undulation * 2 * np.pi / ROUGH * np.cos(
        2 * np.pi * along / ROUGH
    )
    bank = knobs.bank * (0.6 + 0.4 * np.cos(wave))
    return grade, bank


def height(knobs, along, across):
    """Height of the road [m] that belongs to `slopes`."""
    wave = 2 * np.pi * along / WAVE
    profile = knobs.grade * (0.6 * along + 0.4 * WAVE / (2 * np.pi) * (1 - np.cos(wave)))
    profile = profile + knobs.undulation * np.sin(2 * np.pi * along / ROUGH)
    return profile + across * knobs.bank * (0.6 + 0.4 * np.cos(wave))


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
