"""Surfaces that cars are driven on in simulations: a height for each place on the map."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Surface(ABC):
    """A smooth surface over the map."""

    @abstractmethod
    def shape(self, x: float, y: float) -> tuple[float, Array, Array]:
        """At a place [m]: height [m], its gradient (2,) [-] and its second derivatives (2, 2) [1/m]."""

    def under(self, x: float, y: float, heading: float) -> tuple[float, float, float, float, float]:
        """Grade and bank [rad], what both change by along the way [rad/m], and height [m] for a car that is here.

        The changes are the curvature and the twist of the surface: its second fundamental form along the car, and
        along and across it (do Carmo 1976, section 3-3).
        """
        height, gradient, second = self.shape(x, y)
        direction = np.array([np.cos(heading), np.sin(heading)])
        slope = float(gradient @ direction)
        ahead = np.array([*direction, slope]) / np.sqrt(1 + slope**2)
        steepness = float(np.sqrt(1 + gradient @ gradient))
        sideways = np.cross(np.array([*-gradient, 1.0]) / steepness, ahead)
        bent = second @ ahead[:2] / steepness
        return (
            float(np.arcsin(ahead[2])),
            float(np.arcsin(sideways[2])),
            float(bent @ ahead[:2]),
            float(bent @ sideways[:2]),
            height,
        )


@dataclass(frozen=True)
class Waves(Surface):
    """Hills and a bank that changes: sums of waves, each of an amplitude [m], along a direction on the map [rad], with
    a length [m], from the origin on, where each has its middle height and goes up."""

    waves: tuple[tuple[float, float, float], ...]

    def shape(self, x: float, y: float) -> tuple[float, Array, Array]:
        height, gradient, second = 0.0, np.zeros(2), np.zeros((2, 2))
        for amplitude, direction, length in self.waves:
            wave = 2 * np.pi / length * np.array([np.cos(direction), np.sin(direction)])
            phase = float(wave @ [x, y])
            height += amplitude * np.sin(phase)
            gradient += amplitude * np.cos(phase) * wave
            second -= amplitude * np.sin(phase) * np.outer(wave, wave)
        return height, gradient, second
