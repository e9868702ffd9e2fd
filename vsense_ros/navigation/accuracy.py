"""What sensors allow of course, heading and side slip, in closed forms (Leung 2010, section 4.6, extended).

The side slip of a kinematic filter is course less heading. A receiver measures the course, a gyro or two antennas the
heading; all standard deviations are of one estimate, and those of independent causes add as squares.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def course(velocity_noise: float, speed: Array | float) -> Array:
    """Standard deviation of the course [rad] at `speed` [m/s], where east and north velocity have `velocity_noise`
    [m/s] each: eq. 4.40, whose σ the thesis calls a variance. NaN below twice the noise, where the course is no normal
    variable."""
    speed = np.asarray(speed, dtype=float)
    return np.where(speed > 2 * velocity_noise, velocity_noise / np.maximum(speed, 1e-9), np.nan)


def heading_by_gyro(
    time: Array | float, noise: float, period: float, *, start: float = 0.0, bias: float = 0.0, bias_walk: float = 0.0
) -> Array:
    """Standard deviation of a heading [rad] for which a gyro has been integrated over `time` [s]: eq. 4.41, with what
    the thesis leaves out.

    `noise` [rad/s] is that of a sample, `period` [s] that between samples, `start` [rad] the heading's own at the
    beginning; a constant bias of unknown sign grows with time, one that walks by `bias_walk` [rad/s/√s] with its power
    of 3/2 (IEEE Std 952-1997, annex C).
    """
    time = np.asarray(time, dtype=float)
    return np.sqrt(start**2 + time * period * noise**2 + (bias * time) ** 2 + bias_walk**2 * time**3 / 3)


def heading_by_antennas(position_noise: float, distance: float) -> float:
    """Standard deviation of the heading [rad] between two antennas `distance` [m] apart, each with `position_noise`
    [m]: eq. 4.39."""
    return float(np.sqrt(2) * position_noise / distance)


def held(rate: Array | float, period: float) -> Array:
    """Root mean square [rad] of what an angle that changes by `rate` [rad/s] does while it is held for `period` [s]."""
    return np.asarray(np.abs(rate) * period / np.sqrt(3))


def late(rate: Array | float, latency: float) -> Array:
    """What an angle that changes by `rate` [rad/s] is off after `latency` [s] of which nobody knows."""
    return np.asarray(np.abs(rate) * latency)
