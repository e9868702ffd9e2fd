"""The signals in which simulation and recording are compared, made alike from both.

Both sides pass the same steps: what a sensor gives at its own instants, on a common grid of time, through the same
filter. So neither sampling nor filter can look like physics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, detrend, sosfiltfilt

from vsense_ros.mismatch.windows import GRID, RUN_IN, Readings, Window, in_axes_of_car
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.sensors import SensorBase

Array = NDArray[np.float64]

KEPT_EVERY = 4  # of the grid: what is left below the cut-off needs no more
CUT_OFF = 6.0  # [Hz] above it roads and engines shake a car in ways that no model of handling knows
EDGE = 0.4  # [s] at the end of a window, where the filter has not settled

_FILTER = butter(2, CUT_OFF, fs=1 / GRID, output="sos")


@dataclass(frozen=True)
class Signal:
    """What is compared: `name`, its unit, and how it comes from a sensor's components (n, m), given the rolling radius.

    `floor` is the smallest standard deviation that is believed; a `drifting` signal is compared up to a constant and a
    slope in each window, because it depends on a heading that nothing measures; a `shaken` one has in it what an uneven
    road does to the body, of which `SHAKING` says how much it is; from a `turning` one the integral of the yaw rate is
    taken off.
    """

    name: str
    unit: str
    kind: str  # of the sensor
    make: Callable[[Array, float], Array]
    floor: float
    drifting: bool = False
    shaken: bool = False
    turning: bool = False


def _component(index: int) -> Callable[[Array, float], Array]:
    return lambda value, radius: value[:, index]


def _course(value: Array, radius: float) -> Array:
    return np.unwrap(np.arctan2(value[:, 1], value[:, 0]))


SIGNALS = (
    Signal("longitudinal_acceleration", "m/s²", "imu", _component(3), 0.05),
    Signal("lateral_acceleration", "m/s²", "imu", _component(4), 0.05),
    Signal("vertical_acceleration", "m/s²", "imu", _component(5), 0.1, shaken=True),
    Signal("roll_rate", "rad/s", "imu", _component(0), 0.004, shaken=True),
    Signal("pitch_rate", "rad/s", "imu", _component(1), 0.004, shaken=True),
    Signal("yaw_rate", "rad/s", "imu", _component(2), 0.002),
    Signal("speed", "m/s", "wheel_speeds", lambda value, radius: radius * value.mean(axis=1), 0.05),
    Signal("wheel_difference_front", "m/s", "wheel_speeds", lambda v, radius: radius * (v[:, 0] - v[:, 1]), 0.02),
    Signal("wheel_difference_rear", "m/s", "wheel_speeds", lambda v, radius: radius * (v[:, 2] - v[:, 3]), 0.02),
    Signal(
        "wheel_difference_axles", "m/s", "wheel_speeds",
        lambda v, radius: radius * (v[:, 0] + v[:, 1] - v[:, 2] - v[:, 3]) / 2, 0.02,
    ),
    Signal("ground_speed", "m/s", "gnss_velocity", lambda value, radius: np.hypot(value[:, 0], value[:, 1]), 0.03),
    Signal("course", "rad", "gnss_velocity", _course, 0.003, drifting=True),
    # Side slip is lost in the course, which is a hundred times larger and of which a good model misses some percent.
    Signal("side_slip", "rad", "gnss_velocity", _course, 0.002, drifting=True, turning=True),
    *(
        Signal(f"travel_{wheel}", "m", "suspension", _component(i), 0.001, shaken=True)
        for i, wheel in enumerate(WHEELS)
    ),
)  # fmt: skip
SHAKING = "vertical_acceleration"


def grid(window: Window) -> Array:
    """Times at which the signals of a window are kept [s]."""
    t = np.arange(window.begin, window.end, GRID)
    inside = slice(round(RUN_IN / GRID), len(t) - round(EDGE / GRID))
    return t[inside][::KEPT_EVERY]


def signals(
    window: Window, readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], radius: float
) -> dict[str, Array]:
    """Signals of a window by name on its `grid`, from readings by sensor, measured or simulated; `radius` is a rolling
    radius [m], the same for both. Signals with gaps are left out."""
    t = np.arange(window.begin, window.end, GRID)
    inside = slice(round(RUN_IN / GRID), len(t) - round(EDGE / GRID))
    found = {name: np.interp(t, at, value) for name, at, value in _made(window, readings, sensors, radius)}
    if not found:
        return {}
    smooth = sosfiltfilt(_FILTER, np.array(list(found.values())))[:, inside][:, ::KEPT_EVERY]
    return dict(zip(found, smooth, strict=True))


def noise(
    window: Window, readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], radius: float
) -> dict[str, float]:
    """Standard deviation of the white noise that is left in the signals of a window, by name.

    Third differences of white noise have a variance of twenty times its own (1² + 3² + 3² + 1²), those of what a car
    does are small; what the filter leaves of it is its share of the band.
    """
    found = {}
    for name, at, value in _made(window, readings, sensors, radius):
        if len(value) > 50:
            white = float(np.median(np.abs(np.diff(value, 3)))) / (0.6745 * np.sqrt(20))
            found[name] = white * min(1.0, 2 * CUT_OFF * float(np.median(np.diff(at)))) ** 0.5
    return found


def _made(
    window: Window, readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], radius: float
) -> Iterator[tuple[str, Array, Array]]:
    """Name, instants and values of each signal that is there all the time, those of inertial sensors in the axes of the
    car from which the file says that they are turned: what an effect turns them by besides, stays."""
    whole = {
        sensor: in_axes_of_car(found, sensors[sensor]) for sensor, found in readings.items()
        if found.t[0] <= window.begin + 1.0 and found.t[-1] >= window.end - 1.0
    }  # fmt: skip
    heading = next((_heading(found) for sensor, found in whole.items() if sensors[sensor].kind == "imu"), None)
    for sensor, found in whole.items():
        for signal in SIGNALS:
            if signal.kind != sensors[sensor].kind or (signal.turning and heading is None):
                continue
            with np.errstate(invalid="ignore"):
                value = signal.make(found.value, radius)
            if signal.turning and heading is not None:
                value = value - np.interp(found.t, *heading)
            present = np.isfinite(value)
            if present.mean() >= 0.9:
                yield signal.name, found.t[present], value[present]


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
    for signal in SIGNALS:
        if signal.name in measured and signal.name in simulated:
            off = measured[signal.name] - simulated[signal.name]
            if signal.drifting:
                off = detrend((off + np.pi) % (2 * np.pi) - np.pi if abs(off.mean()) > np.pi else off)
            result[signal.name] = off
    return result
