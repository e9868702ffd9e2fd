"""Motions of a car near one that is known, by how far they are apart: what secants of a simulation are made of.

The distance of two motions of nearly the same car changes more slowly than the motions. So a row of the known motion is
one step of ROS2 (Verwer, Spee, Blom & Hundsdorfer 1999), with the Jacobian of the known motion: the method is of second
order with any matrix. A motion costs about half of a simulation.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen.columns import Doubles, Integers, beside, in_lanes, integers, pointer
from vsense_ros.model.coordinates import COORDINATES, DYNAMIC_COORDINATES, SPIN, TORQUES
from vsense_ros.model.simulation.open_loop import OpenLoop, Run, StateHistory, varying_of

Array = NDArray[np.float64]

RENEW = 2  # rows from one Jacobian of a known motion to the next
_JACOBIAN = COORDINATES * (COORDINATES + len(DYNAMIC_COORDINATES))


_STEPS = (("rows", ctypes.c_longlong), ("every", ctypes.c_longlong), ("h", ctypes.c_double))  # of both structures


class _Along(ctypes.Structure):
    """`struct along` of differences.c."""

    _fields_ = (
        *_STEPS,
        *((name, Doubles) for name in ("q", "u", "inputs", "gain", "disturbances", "varying", "parameters")),
        ("varied", ctypes.c_longlong),
        ("places", Integers),
        ("jacobians", Doubles),
    )


class _Difference(ctypes.Structure):
    """`struct difference` of differences.c."""

    _fields_ = (
        *_STEPS,
        *((name, Doubles) for name in ("known_q", "known_u", "known_udot", "known_disturbances", "jacobians")),
        *((name, Doubles) for name in ("q", "u", "inputs", "disturbances", "target", "gain", "varying", "parameters")),
        ("varied", ctypes.c_longlong),
        ("places", Integers),
        *((name, Doubles) for name in ("kept_q", "kept_u", "kept_udot")),
        ("kept", Integers),
    )


@dataclass(frozen=True)
class Known:
    """A run, its motion, which is finite throughout, and the Jacobians along it."""

    run: Run
    motion: StateHistory
    jacobians: Array  # (rows, 14·14 + 14·7), one for every `RENEW` rows of the motion


class Differences:
    """Motions near known ones, of a car whose effects with an internal state have no size in any of them: what these
    remember changes too fast for such steps."""

    def __init__(self, loop: OpenLoop) -> None:
        """Needs a compiler: `loop.library` must not be None."""
        assert loop.library is not None
        self._loop, self._library = loop, loop.library
        self._library.jacobians_along.restype = self._library.differences.restype = None

    def known(self, runs: Sequence[Run], motions: Sequence[StateHistory]) -> list[Known]:
        """Runs with their motions, and the Jacobians along these, several side by side."""
        linearized: list[Known] = []
        for begin in range(0, len(runs), self._loop.lanes):
            lanes = slice(begin, begin + self._loop.lanes)
            linearized += self._known(runs[lanes], motions[lanes])
        return linearized

    def _known(self, runs: Sequence[Run], motions: Sequence[StateHistory]) -> list[Known]:
        lanes, rows = self._loop.lanes, max(len(motion.t) for motion in motions)
        names, places = self._varying(runs)
        columns = [
            beside(lanes, rows, *(motion.q for motion in motions)),
            beside(lanes, rows, *(motion.u for motion in motions)),
            beside(lanes, rows, *(self._driven(run, motion) for run, motion in zip(runs, motions, strict=True))),
            beside(lanes, rows, *(run.inputs.held[1][:: self._loop.keep] for run in runs)),
            beside(lanes, rows, *(run.inputs.disturbances[:: self._loop.keep] for run in runs)),
            beside(lanes, rows, *(varying_of(run, names, places)[:: self._loop.keep] for run in runs)),
            in_lanes(lanes, *(run.parameters for run in runs)),
        ]
        jacobians = np.empty((lanes, -(-rows // RENEW), _JACOBIAN))
        h = runs[0].inputs.step * self._loop.keep
        arguments = _Along(rows, RENEW, h, *map(pointer, columns), len(places), integers(places), pointer(jacobians))
        self._library.jacobians_along(ctypes.byref(arguments))
        return [Known(run, motion, jacobian) for run, motion, jacobian in zip(runs, motions, jacobians, strict=False)]

    def _driven(self, run: Run, motion: StateHistory) -> Array:
        """Inputs (rows, 6) of a run where its states were kept, with what holds the speed of its wheels."""
        inputs = run.inputs.inputs[:: self._loop.keep].copy()
        target, gain = (values[:: self._loop.keep] for values in run.inputs.held)
        inputs[:, TORQUES] += gain * (target - motion.u[:, SPIN].mean(axis=1))[:, None]
        return inputs

    def _varying(self, runs: Sequence[Run]) -> tuple[list[str], NDArray[np.int64]]:
        names = sorted({name for run in runs for name in run.inputs.varying})
        return names, np.array([self._loop.place[name] for name in names], dtype=np.int64)

    def motions(self, known: Known, runs: Sequence[Run]) -> list[StateHistory]:
        """Motions of runs near a known one, of the same steps; rows that a run does not reach are NaN."""
        moved: list[StateHistory] = []
        for begin in range(0, len(runs), self._loop.lanes):
            moved += self._motions(known, runs[begin : begin + self._loop.lanes])
        return moved

    def _motions(self, known: Known, runs: Sequence[Run]) -> list[StateHistory]:
        lanes, keep, rows = self._loop.lanes, self._loop.keep, len(known.motion.t)
        names, places = self._varying([known.run, *runs])

        drives = [run.inputs for run in runs]
        of_known = [
            np.ascontiguousarray(values)
            for values in (
                known.motion.q, known.motion.u, known.motion.udot, known.run.inputs.disturbances[::keep],
                known.jacobians,
            )
        ]  # fmt: skip
        columns = [
            in_lanes(lanes, *(run.q for run in runs)),
            in_lanes(lanes, *(run.u for run in runs)),
            *(
                beside(lanes, rows, *(values[::keep] for values in several))
                for several in (
                    [drive.inputs for drive in drives],
                    [drive.disturbances for drive in drives],
                    *zip(*(drive.held for drive in drives), strict=True),
                    [varying_of(run, names, places) for run in runs],
                )
            ),
            in_lanes(lanes, *(run.parameters for run in runs)),
        ]
        results = [np.full((lanes, rows, COORDINATES), np.nan) for _ in range(3)]
        reached = np.zeros(lanes, dtype=np.int64)
        arguments = _Difference(
            rows, RENEW, known.run.inputs.step * keep, *map(pointer, (*of_known, *columns)), len(places),
            integers(places), *map(pointer, results), integers(reached),
        )  # fmt: skip
        self._library.differences(ctypes.byref(arguments))
        unknown = np.full(len(known.motion.internal_state), np.nan)
        q, u, udot = results
        return [StateHistory(known.motion.t, q[i], u[i], udot[i], unknown) for i in range(len(runs))]
