"""Noise that a sensor really has, estimated from its readings before a filter compares them with anything.

It is white, or the vibration of what the sensor is mounted on, in a narrow band above the 2 Hz of a car's body.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.noise import white_noise_of_each
from vsense_ros.estimation.timeline import Event

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorNoiseSettings:
    """From how many readings noise is estimated, and when it is more than was stated: decisions of this project."""

    first: int = 16  # [-] readings of the first estimate; the next ones are of twice as many each, up to
    window: int = 256  # [-] newest readings, after as many of which the noise is estimated anew
    longest: int = 200_000_000  # [ns] from the first reading on, in which readings wait for the first estimate
    gap: int = 1_000_000_000  # [ns] between two readings, from which on the later one is not of the same series
    more: float = 1.3  # [-] times the stated standard deviation, from which on the estimate is significantly larger
    noisier: float = 3.0  # [-] times the stated standard deviation, from which on that is reported
    # [ns] from one of five readings to the next, whose fourth difference shows a vibration of 10 Hz best: half of its
    # period. Halves of that show what is faster. Of a motion of 1 Hz it has 0.06 %, of 6 Hz 43 %.
    lag: int = 50_000_000


SETTINGS = SensorNoiseSettings()


class SensorNoise:
    """White noise of the components of one sensor's readings.

    What a driver or a vehicle file states is the least variance that a reading may have: `raise_variance` takes the
    larger of that and of what the newest readings show among themselves, where that is significantly more. It is
    independent of any model, and does not take an offset, a drift or a jump for noise.
    """

    def __init__(self) -> None:
        self._newest: deque[Array] = deque(maxlen=SETTINGS.window)
        self._stamps: deque[int] = deque(maxlen=SETTINGS.window)  # of these [ns]
        self._first = self._last = 0  # stamps of the first and the last reading of the series [ns]
        self._elsewhere = -SETTINGS.gap  # stamp of a reading after it that is not of the series [ns]
        self._until = SETTINGS.first  # readings to come before the next estimate
        self._variance: Array | None = None  # (m,) where it is larger than what was stated then
        self.noisier: dict[int, tuple[float, float]] = {}  # components, with estimated and stated standard deviations

    def hear(self, event: Event) -> None:
        """Take in a reading, and give it the variance that the newest ones show, where that is larger."""
        if self._goes_on(event.stamp):
            self._newest.append(event.value)
            self._stamps.append(event.stamp)
            self._until -= 1
            if not self._until:
                self._estimate(event.variance)
        if self._variance is not None:
            self.raise_variance(event)

    def _goes_on(self, stamp: int) -> bool:
        """True if a stamp [ns] belongs to the series of readings: a single one from elsewhere in time does not, two in
        a row begin a new series."""
        if 0 < stamp - self._elsewhere < SETTINGS.gap:
            self._newest.clear()
            self._stamps.clear()
            self._until = SETTINGS.first
        elif self._newest and not 0 < stamp - self._last < SETTINGS.gap:
            if abs(stamp - self._last) >= SETTINGS.gap:
                self._elsewhere = stamp
            return False
        if not self._newest:
            self._first = stamp
        self._last, self._elsewhere = stamp, -SETTINGS.gap
        return True

    def awaited(self, stamp: int) -> bool:
        """True if readings have begun to come by a time [ns], and do not yet show how noisy they are."""
        return 0 < len(self._newest) < SETTINGS.first and 0 <= stamp - self._first < SETTINGS.longest

    def raise_variance(self, event: Event) -> None:
        """Give a reading the variance that the newest ones show, where that is larger."""
        if self._variance is not None:
            event.variance = np.maximum(event.variance, self._variance)

    def _estimate(self, stated: Array) -> None:
        """Estimate the noise anew from the newest readings, whose stated variances are (m,)."""
        self._until = len(self._newest)
        newest = np.array(self._newest)
        deviation = white_noise_of_each(newest)
        usual, vibration = np.sqrt(stated), self._vibration(newest)
        deviation = np.where(vibration > SETTINGS.noisier * usual, np.fmax(deviation, vibration), deviation)
        more = deviation > SETTINGS.more * usual
        self._variance = np.where(more, deviation**2, 0.0) if more.any() else None
        self.noisier = {
            i: (float(deviation[i]), float(usual[i]))
            for i in np.flatnonzero(deviation > SETTINGS.noisier * usual).tolist()
        }

    def _vibration(self, newest: Array) -> Array:
        """Root mean square of a vibration of the components (m,) of readings (n, m); 0 where they are too few.

        The fourth difference of a sine has up to sixteen times its amplitude; half of its values exceed its root mean
        square. A jump is in a few of them only, so that it is not taken for a vibration.
        """
        most = np.zeros(newest.shape[1])
        lag = round(SETTINGS.lag * (len(newest) - 1) / (self._stamps[-1] - self._stamps[0]))
        while lag > 1:
            if len(newest) >= 8 * lag:
                a, b, c, d, e = (newest[i * lag : len(newest) - (4 - i) * lag] for i in range(5))
                most = np.fmax(most, np.median(np.abs(a - 4 * (b + d) + 6 * c + e), axis=0) / 16)
            lag //= 2
        return most
