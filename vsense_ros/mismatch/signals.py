"""The signals in which simulation and recording are compared, made alike from both.

Which they are, the kinds of sensors say (`SensorBase.signals`). Both sides pass the same steps: what a sensor gives at
its own instants, on a common grid of time, through the same filter. So neither sampling nor filter can look like
physics.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from vsense_ros.checks.held import period_of_updates
from vsense_ros.checks.noise import white_noise
from vsense_ros.mismatch.windows import WINDOWS, Readings, Window
from vsense_ros.model.sensors import SensorBase, best_measuring, compared_signals

Array = NDArray[np.float64]
Sensed = tuple[Window, Mapping[str, Readings], Mapping[str, SensorBase], float]  # the arguments of `signals`


@dataclass(frozen=True)
class SignalSettings:
    """How signals are filtered before they are compared: decisions of this project."""

    kept_every: int = 4  # instants of the grid: below the cut-off no more are needed
    cut_off: float = 6.0  # [Hz] above it roads and engines shake a car in ways that no model of handling describes
    least_values: int = 50  # of a signal, of fewer of which its noise is not known: of one window, or of all together
    edge: float = 0.4  # [s] at the end of a window, where the filter has not settled


SIGNALS = SignalSettings()


_FILTER = butter(2, SIGNALS.cut_off, fs=1 / WINDOWS.grid, output="sos")


SHAKING = "vertical_acceleration"  # which says how much an uneven road shakes the body


def grid(window: Window) -> Array:
    """Times at which the signals of a window are kept [s]."""
    t = np.arange(window.begin, window.end, WINDOWS.grid)
    inside = slice(round(window.run_in / WINDOWS.grid), len(t) - round(SIGNALS.edge / WINDOWS.grid))
    return t[inside][:: SIGNALS.kept_every]


def signals(
    window: Window, readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], radius: float
) -> dict[str, Array]:
    """Signals of a window by name on its `grid`, from readings by sensor, measured or simulated; `radius` is a rolling
    radius [m], the same for both. Signals with gaps are left out."""
    t = np.arange(window.begin, window.end, WINDOWS.grid)
    inside = slice(round(window.run_in / WINDOWS.grid), len(t) - round(SIGNALS.edge / WINDOWS.grid))
    interpolated = {name: np.interp(t, at, value) for name, at, value in _made(window, readings, sensors, radius)}
    if not interpolated:
        return {}
    smooth = sosfiltfilt(_FILTER, np.array(list(interpolated.values())))[:, inside][:, :: SIGNALS.kept_every]
    return dict(zip(interpolated, smooth, strict=True))


def noise(
    windows: Iterable[tuple[Window, Mapping[str, Readings], Mapping[str, SensorBase], float]],
) -> dict[str, float]:
    """Standard deviation of the white noise that is left in the signals of windows, by name, from the arguments of
    `signals` for each: the median of the windows that have enough values, or else of all windows together.

    What the filter leaves of the noise of samples is its share of their band; values that are held until new ones come
    are one sample.
    """
    samples: dict[str, list[tuple[Array, float]]] = {}  # by name, values of each window, and their period [s]
    for window in windows:
        for name, at, value in _made(*window):
            held = period_of_updates(value[:, None]) or 1
            if len(value) > held:
                samples.setdefault(name, []).append((value[::held], float(np.median(np.diff(at[::held])))))
    return {name: of for name, of_windows in samples.items() if (of := _noise(of_windows)) is not None}


def _noise(samples: Sequence[tuple[Array, float]]) -> float | None:
    """Standard deviation of the noise in values with their periods [s], by window; None of too few values."""
    known = [one for one in samples if len(one[0]) > SIGNALS.least_values]
    if not known:
        if sum(len(values) for values, _ in samples) <= SIGNALS.least_values:
            return None
        together = np.concatenate([part for values, _ in samples for part in (values, [np.nan])])
        known = [(together, float(np.median([period for _, period in samples])))]
    return float(np.median([white_noise(v) * min(1.0, 2 * SIGNALS.cut_off * period) ** 0.5 for v, period in known]))


def _made(
    window: Window, readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], radius: float
) -> Iterator[tuple[str, Array, Array]]:
    """Name, instants and values of each signal that is there all the time."""
    whole = {
        sensor: rows for sensor, rows in readings.items()
        if rows.t[0] <= window.begin + 1.0 and rows.t[-1] >= window.end - 1.0
    }  # fmt: skip
    inertial = best_measuring(((name, sensors[name]) for name in whole), "rates and forces")
    heading = None if inertial is None else _heading(whole[inertial])
    for sensor, rows in whole.items():
        for signal in sensors[sensor].signals:
            if signal.turning and heading is None:
                continue
            with np.errstate(invalid="ignore"):
                value = signal.make(rows.value, radius)
            if signal.turning and heading is not None:
                value = value - np.interp(rows.t, *heading)
            present = np.isfinite(value)
            if present.mean() >= 0.9:
                yield signal.name, rows.t[present], value[present]


def _heading(imu: Readings) -> tuple[Array, Array]:
    """Instants, and the integral of the yaw rate up to them [rad]."""
    rate = imu.value[:, 2]
    t, rate = imu.t[np.isfinite(rate)], rate[np.isfinite(rate)]
    if not len(t):
        return imu.t, np.full(len(imu.t), np.nan)
    return t, cumulative_trapezoid(rate, t, initial=0)


def difference(measured: Mapping[str, Array], simulated: Mapping[str, Array]) -> dict[str, Array]:
    """Measured minus simulated, by signal; drifting ones without constant and slope."""
    result = {}
    for signal in compared_signals().values():
        if signal.name in measured and signal.name in simulated:
            off = measured[signal.name] - simulated[signal.name]
            if signal.drifting:
                off = _detrended((off + np.pi) % (2 * np.pi) - np.pi if abs(off.mean()) > np.pi else off)
            result[signal.name] = off
    return result


def _detrended(values: Array) -> Array:
    """Values (n,) without the straight line that fits them best."""
    place = np.arange(len(values)) - (len(values) - 1) / 2
    return values - values.mean() - place * (place @ values) / max(float(place @ place), 1.0)
