"""A system at one state, as an extended Kalman filter works with it: what is symbolic in `StateSpace` is numbers here.

Two make one: `Dense` of any `StateSpace`; `observer.car_blocks.CarBlocks` of the multibody car, whose Jacobians are too
large to be written out and whose transition has a structure worth using.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.operations import Operations


class Linearised(Protocol):
    """A system at numbers.

    `memory` (s,) holds all that changes, of which `mean` (n,), `covariance` (e, e), `inputs` (k,) and `extra` are
    parts; `extra` belongs to a filter that keeps further numbers. `components` are the numbers of components of the
    sensors that correct, by name.
    """

    names: tuple[str, ...]
    sensors: tuple[str, ...]
    components: Mapping[str, int]
    memory: Array
    mean: Array
    covariance: Array
    inputs: Array
    extra: Array

    def start(self, belief: Gaussian) -> None:
        """Begin anew at a mean and a covariance."""

    def linearize(self) -> None:
        """At the present mean."""

    def step(self, h: float) -> None:
        """mean ← f(mean, h), covariance ← F P Fᵀ + Q(h), from the last linearisation, which is made anew after it.

        Raises `FloatingPointError` where that is impossible.
        """

    def sense(self, sensor: str, value: Array) -> tuple[Array, Array]:
        """Innovation (m,), value less expectation, angles wrapped, and H (m, e), its derivative by the error."""

    def retract(self, error: Array) -> None:
        """mean ← mean ⊞ error (e,); what `linearize` found is carried on to first order."""

    def is_valid(self) -> bool:
        """True if the mean is finite and within its bounds, and the variances are positive."""

    @property
    def operations(self) -> Operations | None:
        """These operations in C; None where they are not compiled."""
