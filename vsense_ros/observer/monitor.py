"""Monitoring the fit of the model during the drive, by an observer's innovations and force errors over a while.

If model and settings are right, an observer's innovations are white, of unit deviation, and the generalized forces that
it finds missing, its estimates of the road and of the sensors' errors stay near zero (Kailath 1968; Mehra & Peschon
1971). How near on a vehicle of which nothing is wrong, no theory says, since a model is always a little off. So the
limits come from recordings with nothing hidden, and a quantity that leaves them is named, with the time since when.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from ruamel.yaml import YAML

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.messages import yaml_text
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.model.coordinates import ROLL, SPIN, WHEELS, YAW, X, Y
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.state import DISTURB, FORCE, FORWARD

Array = NDArray[np.float64]

WINDOW = (
    10.0  # [s] that statistics look back; shorter, and manoeuvres count as faults; longer, and faults are found late
)
PARTS = 20  # of a window, by which it moves on
MOVING = 3.0  # [m/s] below it slip angles say little
_ROOM = 512  # measurements that are kept before they are added up
_NAMED = 3  # quantities in a message; all are among its values


@dataclass(frozen=True)
class Quantity:
    """A quantity that is monitored: its name and unit."""

    name: str
    unit: str


class Range(BaseModel):
    """How far the mean of a quantity over a window may go, and its root mean square."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: str
    low: float = Field(allow_inf_nan=False)
    high: float = Field(allow_inf_nan=False)
    rms: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    margin: float = Field(gt=0, description="limits over what the recordings have, from the middle")


class Limits(BaseModel):
    """What is normal for a vehicle with its sensors, and what this is known from."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vehicle: str = Field(description="name in the vehicle file")
    recordings: list[str] = Field(description="with nothing hidden, from which the limits come")
    seconds: float = Field(gt=0, description="how long they are together")
    window: float = Field(gt=0, le=600, description="length of the sliding window [s]")
    quantities: dict[str, Range]


def load_limits(path: str | Path) -> Limits:
    """Limits as `vsense monitor --calibrate` writes them. Raises `InputError`."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; vsense monitor --calibrate {path} makes one")
    try:
        return Limits.model_validate(yaml_text.load_file(path))
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"])) or "file"
        raise InputError(
            f"{path}: {place}: {fault['msg']}; vsense monitor --calibrate {path} makes a new one"
        ) from None


def save_limits(path: str | Path, limits: Limits) -> None:
    """Write limits to a file."""
    yaml = YAML()
    yaml.width = 120
    yaml.default_flow_style = None
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        yaml.dump(limits.model_dump(), file)


class _Rows:
    """Room for what comes with each measurement, until it is added up."""

    def __init__(self, width: int) -> None:
        self.values = np.empty((_ROOM, width))
        self.count = 0


class _Watched(_Rows):
    """One sensor: its whitened innovations and their normalized squares, and where its quantities stand."""

    def __init__(self, axes: slice, ratio: int, components: int, limit: float) -> None:
        super().__init__(axes.stop - axes.start)
        self.axes, self.ratio, self.components, self.limit = axes, ratio, components, limit
        self.nis = np.empty(_ROOM)


class Monitor:
    """Statistics of one observer's filter over a sliding window, and what of them leaves its limits.

    `measured` is called for every measurement and does no more than keep its figures. When a part of the window is
    over, statistics are made and judged; `on_statistics` then gets the stamp [ns], means and root mean squares (2, n)
    of `quantities`, NaN where there was nothing; `independent` (n,) then says how many values of such a window are
    independent of each other if the model is right, NaN where that is not known. `gates` are the largest normalized
    innovations squared that are believed, of each sensor; `ready` says whether the filter has converged.
    Raises `InputError` for limits of another vehicle or of other sensors.
    """

    def __init__(
        self,
        car: CarBlocks,
        sensors: Mapping[str, SensorBase],
        gates: Sequence[float],
        ready: Callable[[], bool],
        limits: Limits | None = None,
        on_statistics: Callable[[int, Array], None] | None = None,
    ) -> None:
        self.limits, self._on_statistics, self._ready = limits, on_statistics, ready
        self._speed = car.mean[FORWARD : FORWARD + 1]
        self._slow_states = car.mean[FORCE.start :]
        self._slow = _Rows(len(self._slow_states))
        self.quantities: list[Quantity] = []
        self._sensors: list[_Watched | None] = []
        for (name, sensor), gate in zip(sensors.items(), gates, strict=True):
            if sensor.is_input:
                self._sensors.append(None)
                continue
            shown, first = sensor.components, len(self.quantities)
            last = first + len(shown)
            self.quantities += [Quantity(f"{name} {component.name} innovation", "deviations") for component in shown]
            self.quantities.append(Quantity(f"{name} innovation squared", "expectations"))
            self._sensors.append(_Watched(slice(first, last), last, len(sensor.deviations()), gate))
        torques_measured = any("torques" in sensor.measures for sensor in sensors.values())
        slow = [*_FORCES, *(_TORQUES if torques_measured else ())]
        biases = {f"{name}.{bias.name}": bias.unit for name, sensor in sensors.items() for bias in sensor.biases()}
        for index in range(DISTURB.start, car.layout.size):
            name = car.layout.names[index]
            if name in _OF_THE_PLACE:
                continue
            unit = biases.get(name, _unit(name))
            slow.append((index - FORCE.start, Quantity(f"estimated {name.replace('_', ' ')}", unit)))
        self._places = np.array([place for place, _ in slow])
        self._of_slow = slice(len(self.quantities), len(self.quantities) + len(slow))
        self.quantities += [quantity for _, quantity in slow]
        n = len(self.quantities)
        # An estimate that is not known yet says nothing of the model: of each, its standard deviation as parts ended.
        self._diagonal = car.covariance.reshape(-1)[:: len(car.mean) + 1]
        self._estimated = np.array(
            [place + FORCE.start for place in self._places if place >= DISTURB.start - FORCE.start]
        )
        self._unsure = np.zeros((PARTS, n))
        self._part = round((limits.window if limits else WINDOW) * 1e9 / PARTS)
        self._sums = np.zeros((PARTS, 3, n))  # of values, of squares, numbers of values
        self._low, self._high, self._most = self._bounds(limits, n)
        self._excess = np.zeros(n)
        # A force's error is known again after its time constant: its estimates in between are one and the same.
        self.independent = np.full(n, np.nan)
        rates = car.prior.rate[self._places[: len(self._places) - len(self._estimated)] + FORCE.start]
        self.independent[self._of_slow.start : self._of_slow.start + len(rates)] = self._part * PARTS * 1e-9 * rates / 2
        self._since: dict[int, int] = {}  # of what is beyond its limits [ns]
        self._last = np.full((2, n), np.nan)
        self._filled = self._row = 0
        self._over = 0  # when the present part is [ns]
        self._on = False

    def _bounds(self, limits: Limits | None, n: int) -> tuple[Array, Array, Array]:
        low, high, largest_rms = np.full(n, -np.inf), np.full(n, np.inf), np.full(n, np.inf)
        if limits is None:
            return low, high, largest_rms
        places = {quantity.name: i for i, quantity in enumerate(self.quantities)}
        if unknown := [name for name in limits.quantities if name not in places]:
            raise InputError(
                f"the limits of the monitor are those of other sensors: {', '.join(unknown)} does not exist here; "
                "make new ones with vsense monitor --calibrate"
            )
        for name, bounds in limits.quantities.items():
            i = places[name]
            low[i], high[i] = bounds.low, bounds.high
            largest_rms[i] = np.inf if bounds.rms is None else bounds.rms
        return low, high, largest_rms

    def forget(self) -> None:
        """Begin anew, as the filter does."""
        for rows in (self._slow, *self._sensors):
            if rows is not None:
                rows.count = 0
        self._since.clear()
        self._filled, self._over, self._on = 0, 0, False

    def measured(self, index: int, nis: float, stamp: int, whitened: Array | None) -> None:
        """Take in a measurement of sensor `index` that has just been used or refused.

        `nis` is its normalized innovation squared, `whitened` (m,) its innovation by component, None where the filter
        has gone on since.
        """
        if stamp >= self._over:
            self._turn(stamp)
        watched = self._sensors[index]
        if not self._on or watched is None or not nis >= 0:
            return
        row = watched.count
        watched.values[row] = np.nan if whitened is None else whitened[: watched.values.shape[1]]
        watched.nis[row] = nis
        watched.count += 1
        slow = self._slow
        slow.values[slow.count] = self._slow_states
        slow.count += 1
        if slow.count == _ROOM:
            self._add_up()

    def _turn(self, stamp: int) -> None:
        """End a part of the window and begin the next."""
        if self._on and stamp < self._over + self._part:
            self._add_up()
            self._filled += 1
            if self._filled >= PARTS:
                self._judge(stamp)
        else:
            self._filled = 0  # a pause, or a clock that went on
        self._over = stamp + self._part
        self._on = bool(self._speed[0] > MOVING) and self._ready()
        if not self._on:
            self._filled = 0
        self._row = (self._row + 1) % PARTS
        self._sums[self._row] = 0.0
        deviation = np.sqrt(np.maximum(self._diagonal[self._estimated], 0.0))
        self._unsure[self._row, self._of_slow.stop - len(deviation) : self._of_slow.stop] = deviation

    def _add_up(self) -> None:
        """Make sums of what was kept, and room. What was refused counts as much as what is just believed."""
        part = self._sums[self._row]
        for watched in self._sensors:
            if watched is None or not watched.count:
                continue
            nis, values = watched.nis[: watched.count], watched.values[: watched.count]
            trusted = np.minimum(nis, watched.limit)
            part[:, watched.ratio] += (trusted.sum() / watched.components, np.nan, len(nis))
            present = np.isfinite(values)
            scale = np.sqrt(trusted / np.maximum(nis, 1e-300))[:, None]
            values = np.where(present, values, 0.0) * scale
            part[:, watched.axes] += (values.sum(axis=0), (values**2).sum(axis=0), present.sum(axis=0))
            watched.count = 0
        slow = self._slow.values[: self._slow.count, self._places]
        part[:, self._of_slow] += _sums(slow)
        self._slow.count = 0

    def _judge(self, stamp: int) -> None:
        sums, squares, counts = self._sums.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            self._last[0], self._last[1] = sums / counts, np.sqrt(squares / counts)
            mean, rms = self._last
            middle, half = (self._low + self._high) / 2, (self._high - self._low) / 2
            unsure = self._unsure.max(axis=0)
            self._excess = np.fmax((np.abs(mean - middle) - unsure) / half, (rms - unsure) / self._most)
        if self._on_statistics is not None:
            for watched in self._sensors:
                if watched is not None:
                    self.independent[watched.axes] = counts[watched.axes]
                    self.independent[watched.ratio] = counts[watched.ratio] * watched.components / 2  # of a square
            self._on_statistics(stamp, self._last)
        exceeding = {int(i) for i in np.flatnonzero(self._excess > 1.0)}
        self._since = {i: self._since.get(i, stamp) for i in exceeding}

    @property
    def beyond(self) -> dict[str, int]:
        """What has left its limits and since when [ns]: what left them first, as one fault draws others after it."""
        return {self.quantities[i].name: self._since[i] for i in self._in_order()}

    def _in_order(self) -> list[int]:
        return sorted(self._since, key=lambda i: (self._since[i], -self._excess[i]))

    def diagnostic(self) -> Diagnostic:
        """One line about the model as a whole."""
        values = {}
        for i in self._in_order():
            quantity, (mean, rms) = self.quantities[i], self._last[:, i]
            limits = f"{self._low[i]:.4g} to {self._high[i]:.4g}, root mean square up to {self._most[i]:.4g}"
            values[quantity.name] = (
                f"mean {mean:.4g}, root mean square {rms:.4g} {quantity.unit}; limits {limits}; since "
                f"{_clock(self._since[i])}"
            )
        if self._filled < PARTS and not values:
            return Diagnostic("model", Level.OK, "not judged yet: too short a drive above 3 m/s", values)
        if not values:
            return Diagnostic("model", Level.OK, "fits", values)
        names = list(values)
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        sentence = f"no longer fits since {_clock(min(self._since.values()))}: {', '.join(names[:_NAMED])}{more}"
        return Diagnostic("model", Level.WARN, sentence, values)


def _sums(values: Array) -> Array:
    """Sums of values and of squares of each column, and how many there are, (3, m)."""
    return np.array([values.sum(axis=0), (values**2).sum(axis=0), np.full(values.shape[1], len(values))])


def _clock(stamp: int) -> str:
    return f"{datetime.fromtimestamp(stamp * 1e-9, UTC):%H:%M:%S} UTC"


def _unit(name: str) -> str:
    """Unit of a disturbance that the model has among its states."""
    return "-" if name == "radius_error" else "rad"


# What a road is from place to place, and a car's model is neither right nor wrong about.
_OF_THE_PLACE = frozenset({"grade_change", "bank_change", "road_height"})
_FORCES = (
    (X, Quantity("longitudinal force", "N")),
    (Y, Quantity("lateral force", "N")),
    (ROLL, Quantity("roll moment", "N m")),
    (YAW, Quantity("yaw moment", "N m")),
)
_TORQUES = tuple((SPIN.start + i, Quantity(f"torque of wheel {wheel}", "N m")) for i, wheel in enumerate(WHEELS))
