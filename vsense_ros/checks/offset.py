"""The difference of the clocks of two recordings of one drive, by the motion that both measure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import spread
from vsense_ros.checks.lags import lag_curve, refined
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OffsetSettings:
    """By which two recordings show the same motion."""

    least_overlap: float = setting(5.0, "s", "that both signals are present in", JUDGEMENT)
    least_share: float = setting(0.3, "-", "of the shorter signal, likewise", JUDGEMENT)
    correlation: float = setting(0.7, "-", "from where on two signals show the same motion")


SETTINGS = OffsetSettings()


def clock_offset(reference: Recording, other: Recording) -> tuple[float, float] | None:
    """What has to be added to the times of a recording to have those of another of the same drive [s], and the
    correlation of the motions then; None where they have none to compare.

    Whatever both measure is compared: the turning rate, or the change of speed, by whichever sensor.
    """
    motions = [Subject(recording).measured_motion for recording in (reference, other)]
    if motions[0] is None or motions[1] is None:
        return None
    step = motions[0].signals.step
    pairs = (
        (one, two)
        for first, second in ((motions[0].turns, motions[1].turns), (motions[0].pushes, motions[1].pushes))
        for one in first.values()
        for two in second.values()
    )
    best = max((offset for one, two in pairs for offset in _offsets(one, two, step)), key=lambda f: f[1], default=None)
    if best is None or best[1] < SETTINGS.correlation:
        return None
    return best[0] + (motions[0].signals.start - motions[1].signals.start) * 1e-9, best[1]


def _offsets(one: Array, other: Array, step: float) -> Iterator[tuple[float, float]]:
    """By how much `other` has to be put later to go along with `one` [s], and their correlation then."""
    if not spread(one) or not spread(other):
        return
    present = min(np.isfinite(one).sum(), np.isfinite(other).sum())
    least = max(SETTINGS.least_overlap / step, SETTINGS.least_share * present)
    curve = lag_curve(one, other, max(len(one), len(other)) - 1, least)
    correlation = np.nan_to_num(curve.correlation, nan=-1.0)
    at = int(np.argmax(correlation))
    if correlation[at] > 0:
        yield float(refined(curve.correlation, at) + curve.shifts[0]) * step, float(correlation[at])
