"""Sizes of defects of sensors that are determined before any fit, as no small step of a fit would lead to them.

They are how late sensors are (`ages`), and how far to the left a GNSS antenna sits. In tight bends an antenna beside
the middle of the car is faster than the wheels in bends to one side and slower in bends to the other, by more than tyre
radii could differ; a fit would give each recording a car of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.mismatch.ages import DELAY, Age, ages
from vsense_ros.mismatch.data_quality import SETTINGS as DATA_QUALITY
from vsense_ros.mismatch.data_quality import Drive
from vsense_ros.mismatch.windows import Dataset, Window
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.gnss_lever_arm import GnssLeverArm
from vsense_ros.model.sensors import SensorBase, best_measuring
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class BeforehandSettings:
    """How sure a size is before any fit."""

    memory: float = setting(4.0, "s", "for which errors of the speeds last, as a manoeuvre does", JUDGEMENT)
    least_share: float = setting(0.015, "-", "of the speed, rms, that an antenna beside the middle adds", JUDGEMENT)
    least_bend: float = setting(0.005, "1/m", "curvature of bends to both sides, in a twentieth of the time", JUDGEMENT)
    deviations: float = setting(5.0, "-", "standard deviations that the place of an antenna exceeds", JUDGEMENT)
    place_deviation: float = setting(0.05, "m", "by which a place is wrong at least: sensors of one speed", JUDGEMENT)


SETTINGS = BeforehandSettings()


@dataclass(frozen=True)
class Beforehand:
    """A size of an effect on sensors: its `value` beyond the vehicle file's and its standard `deviation`, in the unit
    of the effect's `field`. If it is not `independent`, held-out recordings were needed to determine it."""

    effect: str
    field: str
    value: float
    deviation: float
    independent: bool = True

    @property
    def parameter(self) -> str:
        """The dotted name of the size."""
        return f"effects.{self.effect}.{self.field}"


def beforehand(fitted: Dataset, unseen: Dataset, vehicle: Vehicle) -> tuple[Beforehand, ...]:
    """All sizes that the windows of recordings determine before any fit: of those that are fitted, or where these turn
    to one side only, of the unseen ones, too. The place of an antenna is geometry, which needs bends to both sides."""
    antenna = _antenna(fitted.by_recording(), fitted.sensors, vehicle)
    if antenna is None:
        every = [*fitted.by_recording(), *unseen.by_recording()]
        antenna = _antenna(every, {**fitted.sensors, **unseen.sensors}, vehicle) if unseen.windows else None
        antenna = [replace(one, independent=False) for one in antenna or ()]
    return (*delays(ages(fitted, vehicle)), *antenna)


def not_proven(sizes: Iterable[Beforehand]) -> list[str]:
    """Remarks on the sizes that held-out recordings do not prove, as these were needed to determine them."""
    return [
        f"{EVERY[size.effect].sentence}: the fitted recordings have bends to one side only, so that those that were "
        "held out were needed to determine it, and do not prove it"
        for size in sizes
        if not size.independent
    ]


def delays(late: Mapping[str, Age]) -> tuple[Beforehand, ...]:
    """How late sensors are, by size of that effect."""
    return tuple(Beforehand(DELAY.id, field, age.value, age.deviation) for field, age in late.items())


def with_sizes(vehicle: Vehicle, sizes: Iterable[Beforehand]) -> Vehicle:
    """The vehicle with effects that are larger by these sizes."""
    effects = vehicle.physics.effects
    for size in sizes:
        known = getattr(effects, size.effect) or EVERY[size.effect]()
        larger = known.model_copy(update={size.field: getattr(known, size.field) + size.value})
        effects = effects.model_copy(update={size.effect: larger})
    return vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": effects})})


def _antenna(
    recordings: Sequence[Sequence[Window]], sensors: Mapping[str, SensorBase], vehicle: Vehicle
) -> Sequence[Beforehand] | None:
    """How far a GNSS antenna sits further to the left than the vehicle file says, where bends to both sides show it;
    None without such bends. `recordings` are the windows of each.

    The speed over ground over that of the wheels is, at a curvature κ, 1 + e − y κ + b κ²: e is the error of the tyre
    radius, y the place of the antenna, and b what slip and steered wheels add in bends to either side.
    """
    name = best_measuring(sensors.items(), "course")
    if name is None or not recordings:
        return None
    ratios, bends = [], []
    for windows in recordings:
        drive = Drive.of(windows, sensors, vehicle)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio, bend = drive.over_ground / drive.rolling, drive.yaw_rate / drive.speed
        steady = np.isfinite(ratio) & np.isfinite(bend) & (np.abs(drive.speed_rate) < 1.0)
        ratios.append(ratio[steady])
        bends.append(bend[steady])
    ratio, bend = np.concatenate(ratios), np.concatenate(bends)
    independent = len(ratio) * DATA_QUALITY.smooth / 2 / SETTINGS.memory
    if independent < 4 or min(-np.percentile(bend, 5), np.percentile(bend, 95)) < SETTINGS.least_bend:
        return None
    terms = np.column_stack([np.ones(len(bend)), -bend, bend**2])
    solution = np.linalg.lstsq(terms, ratio, rcond=None)[0]
    scatter = float(np.std(ratio - terms @ solution))
    covariance = np.linalg.inv(terms.T @ terms) * len(ratio) / independent
    deviation = float(np.hypot(scatter * np.sqrt(covariance[1, 1]), SETTINGS.place_deviation))
    of_file = float(np.asarray(getattr(sensors[name], "position", np.zeros(3)))[1])
    further = float(solution[1]) - of_file
    if abs(further) < SETTINGS.deviations * deviation or abs(further) * np.std(bend) < SETTINGS.least_share:
        return ()
    return (Beforehand(GnssLeverArm.id, "y", round(further, 2), deviation),)
