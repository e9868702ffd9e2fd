"""Putting a linkage together: coordinates that close its loops, and whether its constraints make sense.

A linkage that cannot be closed, a constraint that says what others say already, and one that contradicts them are named
apart here, and refused with a sentence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.model.multibody.mechanism import Linkage
from vsense_ros.model.multibody.semi_recursive import Motion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AssemblySettings:
    """Numerical settings of the assembly of linkages."""

    most_iterations: int = 60  # [-]
    closed: float = 1e-11  # [m] opening of a linkage that counts as closed
    largest_change: float = 0.3  # [m, rad] of a coordinate in one iteration
    relative_rank: float = 1e-7  # [-] singular values below this share of the largest are zero


ASSEMBLY = AssemblySettings()


@lru_cache(maxsize=16)
def closure_function(linkage: Linkage) -> ca.Function:
    """(z, guides, parameters) → Φ (m), Φ_z (m×n); `guides` are positions (g)."""
    n, g = len(linkage.coordinate_names), len(linkage.guides)
    z, guides = ca.SX.sym("z", n), ca.SX.sym("guides", g)
    motion = Motion(linkage, z, ca.SX(n, 1), ca.SX(n, 1), ca.horzcat(guides, ca.SX(g, 2)))
    return ca.Function(
        f"closure_{linkage.name}",
        [z, guides, linkage.parameters],
        [ca.densify(motion.constraint), ca.densify(motion.constraint_jacobian)],
    )


def assemble(
    linkage: Linkage,
    parameters: Array,
    start: Array | None = None,
    guides: Array | None = None,
    held: dict[int, float] | None = None,
) -> Array:
    """Coordinates (n) that close the linkage, the nearest to `start`; those in `held` keep their values.

    Raises `InputError` where there are none, naming the closures that stay open and by how much.
    """
    function = closure_function(linkage)
    positions = np.zeros(len(linkage.guides)) if guides is None else guides
    z = np.zeros(len(linkage.coordinate_names)) if start is None else np.array(start, dtype=float)
    held = held or {}
    free = [i for i in range(len(z)) if i not in held]
    for index, value in held.items():
        z[index] = value
    for _ in range(ASSEMBLY.most_iterations):
        gap, jacobian = (np.asarray(r) for r in function(z, positions, parameters))
        gap = gap.reshape(-1)
        if gap.size == 0 or np.abs(gap).max() < ASSEMBLY.closed:
            return z
        change = np.linalg.lstsq(jacobian[:, free], -gap, rcond=ASSEMBLY.relative_rank)[0]
        z[free] += change * min(1.0, ASSEMBLY.largest_change / max(np.abs(change).max(), 1e-300))
    open_by: dict[str, float] = {}
    for name, value in zip(linkage.equation_names, gap, strict=True):
        open_by[name] = max(open_by.get(name, 0.0), abs(value))
    worst = ", ".join(f"{name} by {1e3 * value:.3g} mm" for name, value in open_by.items() if value > ASSEMBLY.closed)
    raise InputError(
        f"linkage {linkage.name!r} does not close: the nearest position leaves open {worst}. Check the hard points and "
        "lengths, and whether the travel or the guide asks for more than the linkage can do"
    )


def check(linkage: Linkage, parameters: Array, z: Array, guides: Array | None = None) -> int:
    """Degrees of freedom of an assembled linkage, by the rank of its constraints.

    Raises `InputError` for constraints that others imply already, and for those that contradict them.
    """
    function = closure_function(linkage)
    positions = np.zeros(len(linkage.guides)) if guides is None else guides
    jacobian = np.asarray(function(z, positions, parameters)[1])
    count, n = jacobian.shape
    if not count:
        return n
    values = np.linalg.svd(jacobian, compute_uv=False)
    rank = int(np.sum(values > ASSEMBLY.relative_rank * values[0]))
    if rank < count:
        names: list[str] = []
        independent = np.zeros((0, n))
        for row, name in zip(jacobian, linkage.equation_names, strict=True):
            trial = np.vstack([independent, row])
            singular = np.linalg.svd(trial, compute_uv=False)
            if np.sum(singular > ASSEMBLY.relative_rank * values[0]) > len(independent):
                independent = trial
            elif name not in names:
                names.append(name)
        raise InputError(
            f"linkage {linkage.name!r} has {count} constraints of which only {rank} are independent: "
            f"{', '.join(names)} repeats in part what the closures before it say. Remove it or give it fewer directions"
        )
    return n - rank
