"""How the windows of recordings are simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.windows import Window


@dataclass(frozen=True)
class PredictionSettings:
    """Settings of the simulation of windows: decisions of this project."""

    step: float = 0.005  # [s] of the simulation …
    parts: int = 4  # … in which inputs are what they are in the mean of so many parts
    keep_every: int = 2  # steps
    # steps after which the Jacobian is renewed: signals are the same to 0.003 standard deviations with it in every one
    renew_every: int = 16
    side_by_side: int = 16  # runs that are given to the vectors at once, about: twice what the widest hold (AVX-512)
    remembered: int = 3  # motions of each window, besides those that are foreseen
    spun: float = 0.5  # [rad] of side slip from which cars do not come back
    # [-] force over load per slip that is assumed of tyres to begin with; their own is fitted
    slip_stiffness: float = 20.0
    cornering_stiffness: float = 14.0  # [1/rad] lateral force over load per slip angle, where a window begins
    braked: float = 0.6  # [m/s²] of deceleration that needs brakes: less is drag and engine
    smoothing: float = 0.3  # [s] of the mean that separates driving from braking
    # [m/s²] that the noise of a measured speed may add to the acceleration of the car that follows it, which decides up
    # to which frequency it does
    noise_acceleration: float = 0.1
    lowest_cut_off: float = 0.5  # [Hz]
    highest_cut_off: float = 10.0  # [Hz]
    # [-] rate of a speed over the cut-off of signals, above which it shows its noise, from which on that is known
    least_sampling: float = 3.0
    driving_torque: float = 1.0  # [N m] of torque that a driven wheel exceeds in a twentieth of the time, at least
    driving_percentile: float = 95.0  # [%] of the time below that torque
    not_driven_share: float = 0.15  # [-] of the torque, of all or of the other axle, below which an axle is not driven
    slipping_share: float = 0.5  # [-] of the speed, from where on a wheel that slips locks or spins


PREDICTION = PredictionSettings()


def middle_of_steps(window: Window) -> NDArray[np.float64]:
    """Times in the middle of each step [s]."""
    return np.asarray(
        window.begin + (np.arange(np.ceil((window.end - window.begin) / PREDICTION.step)) + 0.5) * PREDICTION.step,
        dtype=float,
    )
