"""Heading error of a reference system that fades after its start.

An inertial reference that is aligned while the car drives has a heading that is off by some tenths of a degree once the
first bends show it, and improves over a minute. A comparison with it charges that error to every estimate of the side
slip. Any estimate whose own errors have nothing to do with the time since the start shows it, a static formula as well
as a filter; the fit to a formula leaves the filter that is examined out of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.signals import Array, Series, read_signals
from vsense_ros.messages.recording import Recording

ODOMETRY, SIDE_SLIP = "reference/odometry", "reference/sideslip"


@dataclass(frozen=True)
class TransientSettings:
    """Which transients are searched for: decisions of this project."""

    latest_share: float = 0.1  # of the drive, within which it begins: later ones are no start
    shortest: float = 5.0  # [s] time constant, below which a bend would pass for one
    longest_share: float = 0.1  # of the drive, beyond which a drift would pass for one
    tried: int = 24  # beginnings, and time constants for each
    rate: float = 10.0  # [Hz] of the rows that are fitted: a transient is slow
    accuracy: float = float(np.radians(0.1))  # [rad] at which it counts as over: heading of an OxTS RT3000, its manual


SETTINGS = TransientSettings()


@dataclass(frozen=True)
class HeadingTransient:
    """Heading error a exp(-t/τ) of a reference, with t from `begin` after `start` on, and none before."""

    start: int  # [ns] of the reference
    begin: float  # [s]
    amplitude: float  # a [rad], positive where the reference points too far to the left
    time_constant: float  # τ [s]
    explained: float  # [-] share of the variance of the side-slip error that it was fitted to

    @property
    def over(self) -> float:
        """Time after the start from which on it is smaller than `TransientSettings.accuracy` [s]."""
        if abs(self.amplitude) <= SETTINGS.accuracy:
            return 0.0
        return self.begin + self.time_constant * float(np.log(abs(self.amplitude) / SETTINGS.accuracy))

    def at(self, stamp: NDArray[np.int64]) -> Array:
        """Heading errors [rad] at `stamp` (n,) [ns]."""
        return self.amplitude * _decay((stamp - self.start) * 1e-9, self.begin, self.time_constant)

    def __str__(self) -> str:
        return (
            f"heading error of the reference: {np.degrees(self.amplitude):+.2f}° {self.begin:.0f} s after its start, "
            f"fading with a time constant of {self.time_constant:.0f} s; below "
            f"{np.degrees(SETTINGS.accuracy):.1f}° after {self.over:.0f} s; "
            f"{self.explained:.0%} of the variance of a formula's side-slip error"
        )


def fit_transient(estimate: Series, truth: Series) -> HeadingTransient:
    """The transient of the heading in a reference's side slip `truth`, by what another `estimate` of it differs.

    A reference that points too far to the left by ε measures a side slip that is too small by ε. The amplitude is found
    by linear least squares beside a constant (the mounting), for each of a number of beginnings and time constants, of
    which the best are taken.
    """
    aligned = align(estimate, truth)
    start = int(truth.stamp[0])
    every = (aligned.stamp - start) * 1e-9
    rows = np.unique(np.searchsorted(every, np.arange(every[0], every[-1], 1 / SETTINGS.rate)))
    t, error = every[rows], aligned.error[rows, 0]
    longest = max(SETTINGS.longest_share * float(t[-1]), 2 * SETTINGS.shortest)
    begins = np.linspace(0.0, SETTINGS.latest_share * float(t[-1]), SETTINGS.tried)
    time_constants = np.geomspace(SETTINGS.shortest, longest, SETTINGS.tried)
    best, least = (0.0, 0.0, SETTINGS.shortest), np.inf
    for begin, time_constant in product(begins.tolist(), time_constants.tolist()):
        regressors = np.column_stack([_decay(t, begin, time_constant), np.ones_like(t)])
        solution = np.linalg.lstsq(regressors, error, rcond=None)[0]
        residual = float(np.mean((error - regressors @ solution) ** 2))
        if residual < least:
            best, least = (begin, float(solution[0]), time_constant), residual
    return HeadingTransient(start, *best, explained=1.0 - least / max(float(error.var()), 1e-30))


def _decay(t: NDArray[np.floating[Any]], begin: float, time_constant: float) -> Array:
    return np.where(t < begin, 0.0, np.exp(-np.maximum(t - begin, 0.0) / time_constant))


def without_transient(recording: Recording, transient: HeadingTransient) -> Recording:
    """The recording with a reference whose heading has no transient: velocity, orientation and side slip are turned."""
    channels = dict(recording.channels)
    odometry = channels[ODOMETRY]
    error = transient.at(odometry.stamp)
    turn = Rotation.from_euler("z", error[:, None])
    linear = odometry.columns["linear"]
    turned = turn.apply(np.nan_to_num(linear))
    orientation = (Rotation.from_quat(odometry.columns["orientation"]) * turn.inv()).as_quat()
    moved = {"linear": np.where(np.isnan(linear), np.nan, turned), "orientation": orientation}
    channels[ODOMETRY] = replace(odometry, columns={**odometry.columns, **moved})
    if SIDE_SLIP in channels:
        slip = channels[SIDE_SLIP]
        vector = slip.columns["vector"].copy()
        vector[:, 0] += transient.at(slip.stamp)
        channels[SIDE_SLIP] = replace(slip, columns={**slip.columns, "vector": vector})
    return replace(recording, channels=channels)


def transient_of(recording: Recording, estimates: list[Series]) -> HeadingTransient | None:
    """The transient that an estimate of the side slip among `estimates` shows in the reference of a recording; None
    where either has no side slip."""
    truth = read_signals(recording, "reference").get("side_slip")
    slips = [one for one in estimates if one.signal.name == "side_slip"]
    return fit_transient(slips[0], truth) if slips and truth is not None else None
