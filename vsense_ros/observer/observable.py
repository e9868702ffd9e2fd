"""Quantities that the sensors of a car cannot determine, which are absent from what is published.

A filter has a number for everything, and a standard deviation that is right only if the model's assumptions about that
quantity are. Where no sensor has reduced what was assumed beforehand, the number is the assumption, and it is left out:

- *How wheels share the longitudinal force.* The inertial sensor and GNSS measure its sum alone. The difference between
  axles keeps all of its prior variance, unless wheel speeds or wheel torques are measured, or the vehicle file says
  which wheels are driven.
- *The height of the road on the map*, on a map that GNSS gives, while its variance is nearly what it was at start: a
  receiver without height leaves it to the integral of the grade, which drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.coordinates import ROAD_HEIGHT
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.state import DISTURB

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ObservabilitySettings:
    """When a quantity counts as determined: decisions of this project."""

    removed: float = 0.5  # [-] share of the prior variance that measurements have to have removed
    open_height: float = 1.0  # [m] prior standard deviation below which the map was laid at the height of the start


SETTINGS = ObservabilitySettings()

_HEIGHT = DISTURB.start + ROAD_HEIGHT
FORCES_NEED = (
    "longitudinal forces, slips and torques of wheels are absent: they need wheel speeds, wheel torques, or "
    "drivetrain.driven in the vehicle file"
)
HEIGHT_NEEDS = "the height of the road is absent: it needs a GNSS height (gnss_height)"


def undetermined(car: CarBlocks, covariance: Array) -> Array:
    """Flags (…, 2): True where the longitudinal forces of single wheels, and the height of the road, are not determined
    by what was measured, at this covariance (…, n, n) of the errors of the state."""
    prior = float(car.prior.deviation[_HEIGHT])
    flags = np.empty((*covariance.shape[:-2], 2), dtype=bool)
    flags[..., 0] = not car.prior.torques.determine_forces
    flags[..., 1] = covariance[..., _HEIGHT, _HEIGHT] > (1 - SETTINGS.removed) * prior**2
    flags[..., 1] &= prior > SETTINGS.open_height
    return flags


def needs(flags: Array) -> str:
    """A sentence about what is absent by `undetermined`, and what would make it observable; empty for nothing."""
    return "; ".join(words for words, absent in zip((FORCES_NEED, HEIGHT_NEEDS), flags, strict=True) if absent)
