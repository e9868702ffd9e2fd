"""The most informative part of more driving than can be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.windows import Dataset, Readings, Window

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SelectionSettings:
    """Settings of the selection of recordings."""

    many: int = 4  # recordings, from which on a remark counts them instead of naming them
    sampling: float = 0.1  # [s] between samples of speed and steering


SELECTION = SelectionSettings()


def most_telling(dataset: Dataset, duration: float) -> Dataset:
    """All windows, or if they last longer than `duration` [s] as many of them as that holds.

    They are chosen one after the other: those first that bring in a recording or a sensor that is still missing, then
    those over which time, speed, steering and what follows from these vary most together (a D-optimal design of
    experiments, Wald 1943, greedily).
    """
    lengths = [w.end - w.begin - w.run_in for w in dataset.windows]
    if sum(lengths) <= duration:
        return dataset
    steering = {name for name, sensor in dataset.sensors.items() if "steering" in sensor.measures}
    described = _standardised(
        [_description(w, next(w.readings[name] for name in steering & w.readings.keys())) for w in dataset.windows]
    )
    parts: list[set[int | str]] = [{w.recording, *w.readings} for w in dataset.windows]
    known, left = np.eye(described[0].shape[1]), duration
    chosen: list[int] = []
    missing = set[int | str]().union(*parts)
    while fitting := [i for i, length in enumerate(lengths) if i not in chosen and length <= left]:
        worth = {
            i: (len(missing & parts[i]), float(np.linalg.slogdet(known + described[i].T @ described[i])[1]))
            for i in fitting
        }
        best = max(fitting, key=worth.__getitem__)
        known = known + described[best].T @ described[best]
        left -= lengths[best]
        missing -= parts[best]
        chosen.append(best)
    windows = tuple(dataset.windows[i] for i in sorted(chosen))
    names = list(dict.fromkeys(w.name for w in dataset.windows))
    lost = [name for name in names if name not in {w.name for w in windows}]
    of = ", ".join(names) if len(names) < SELECTION.many else f"{len(names)} recordings"
    remark = (
        f"{of}: of {sum(lengths) / 60:.0f} min {(duration - left) / 60:.0f} min are looked at, in which speed and "
        f"steering vary most"
    )
    if lost:
        remark += f"; nothing of {', '.join(lost)}"
    return replace(dataset, windows=windows, remarks=(*dataset.remarks, remark))


def _description(window: Window, steering: Readings) -> Array:
    """How a window differs, without a model, from others, (instants, 7): the time since the recording began,
    speed, its square and its rate, steering angle, its rate, and angle times squared speed (lateral acceleration)."""
    t = np.arange(window.begin + window.run_in, window.end, SELECTION.sampling)
    known = np.isfinite(steering.value[:, 0])
    speed = np.interp(t, window.speed.t, window.speed.value[:, 0])
    angle = np.interp(t, steering.t[known], steering.value[known, 0])
    return np.column_stack(
        [
            t,
            speed,
            speed**2,
            np.gradient(speed, SELECTION.sampling),
            angle,
            np.gradient(angle, SELECTION.sampling),
            angle * speed**2,
        ]
    )


def _standardised(described: Sequence[Array]) -> list[Array]:
    """Values with mean 0 and standard deviation 1 over all windows."""
    every = np.concatenate(described)
    mean, deviation = every.mean(axis=0), np.maximum(every.std(axis=0), 1e-9)
    return [(one - mean) / deviation for one in described]
