"""Effects for which a base parameter stands in.

A base parameter that is fitted far from what the vehicle file says may have taken the place of an effect: what the two
do to the signals of these drives is alike. Such a pair is found by the linear model of the fit: beside the effect the
parameter may stay at the value of the file, and costs little there, which without the effect costs much. Where all
bends go to one side, the same bends to the other side separate the two if one of them is symmetric about the middle of
the car and the other is not: exchange left and right, and the one changes its sign.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.identification.normal_equations import NormalEquations
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.tables import base_name
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.verdict import Judged
from vsense_ros.mismatch.words import label, shown_value
from vsense_ros.model.effects import EVERY

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StandInSettings:
    """When a base parameter may stand in for an effect, and when bends go to one side."""

    far: float = setting(2.0, "deviations", "of a base parameter from the vehicle file", JUDGEMENT)
    most: int = setting(3, "-", "effects that are listed for a base parameter", JUDGEMENT)
    other_side: float = setting(0.02, "-", "share of the squared yaw rate, below which a side is missing", JUDGEMENT)
    least_yaw_rate: float = setting(0.03, "rad/s", "root mean square of the yaw rate of a drive with bends", JUDGEMENT)
    turning_over: float = setting(2.0, "s", "over which a gyro and the course are compared", JUDGEMENT)
    banked: float = setting(0.02, "-", "by which a gyro reads less than the course turns on a banked road", JUDGEMENT)


SETTINGS = StandInSettings()


@dataclass(frozen=True)
class StandIn:
    """A base `parameter` at an `offset` in its `unit`, so many `deviations` from the file, and the effects that would
    explain as much in its place, each with its size, the best first."""

    parameter: str
    offset: float
    unit: str
    deviations: float
    effects: tuple[tuple[Candidate, float], ...]


def stand_ins(search: Search) -> list[StandIn]:
    """The base parameters that may stand in for effects, those furthest from the file first."""
    base = search.base
    known = {parameter.name for parameter in base.free_parameters}
    single = [
        c for c in search.offered
        if not c.along_road and len(c.free_parameters) == 1 and c.free_parameters[0].name not in known
    ]  # fmt: skip
    far = [i for i, offset in enumerate(base.scaled_offsets) if abs(offset) >= SETTINGS.far]
    if not far or not single:
        return []
    search.screening.simulate_new()
    equations = search.secants.joined_equations(base, [c.free_parameters[0] for c in single])
    count, result = len(base.free_parameters), []
    for i in sorted(far, key=lambda place: -abs(base.scaled_offsets[place])):
        free, _ = least_with(range(count), equations)
        others = [j for j in range(count) if j != i]
        held, _ = least_with(others, equations, i)
        needed = held - free
        if needed <= THRESHOLDS.least_gain * search.whole:
            continue
        ranked = []
        for j, candidate in enumerate(single, start=count):
            value, changed = least_with([*others, j], equations, i)
            parameter, size = candidate.free_parameters[0], changed[-1] * equations.free_parameters[j].deviation
            needed_besides = value - least_with([*range(count), j], equations)[0]
            in_place = needed_besides <= (1 - THRESHOLDS.rival_share) * needed
            if in_place and parameter.low <= size <= parameter.high:
                ranked.append((needed_besides, candidate, float(size)))
        best: dict[str, tuple[Candidate, float]] = {}  # by effect, at its best place
        for _, candidate, size in sorted(ranked, key=itemgetter(0)):
            best.setdefault(candidate.effect, (candidate, size))
        if best:
            parameter = base.free_parameters[i]
            result.append(
                StandIn(
                    parameter.name, float(base.offsets[i]), parameter.unit, float(base.scaled_offsets[i]),
                    tuple(best.values())[: SETTINGS.most],
                )
            )  # fmt: skip
    return result


def least_with(free: Iterable[int], equations: NormalEquations, held: int | None = None) -> tuple[float, Array]:
    """The least change of what is minimised with these parameters free and one `held` at the value of the vehicle
    file, and their changes [deviations]; all others stay where they are."""
    stay = list(free)
    normal = equations.normal.sum(axis=0) + equations.weight * np.eye(len(equations.free_parameters))
    gradient, value = equations.gradient, 0.0
    if held is not None:
        by = -float(equations.scaled_offsets[held])
        value = 2 * by * float(gradient[held]) + by**2 * float(normal[held, held])
        gradient = gradient + by * normal[:, held]
    change = np.linalg.solve(normal[np.ix_(stay, stay)], -gradient[stay])
    return value + float(gradient[stay] @ change), np.asarray(change, dtype=float)


def side_of_bends(residuals: Residuals) -> str:
    """The side to which all bends of the windows go, left or right; empty where they go to both, or nothing turns."""
    rates = [measured["yaw_rate"] for measured in residuals.predictor.measured if "yaw_rate" in measured]
    if not rates:
        return ""
    rate = np.concatenate(rates)
    rate = rate[np.isfinite(rate)]
    whole = float(rate @ rate)
    if whole <= SETTINGS.least_yaw_rate**2 * len(rate):
        return ""
    left = float(np.square(rate[rate > 0]).sum()) / whole
    if left < SETTINGS.other_side:
        return "right"
    return "left" if left > 1 - SETTINGS.other_side else ""


def seen_of_banks(residuals: Residuals) -> str:
    """A remark on how far the bends may be banked where no lateral acceleration is measured; empty for nothing.

    A gyro that leans with the road reads the cosine of the bank times the rate at which the course turns. That is of
    second order in the bank, so that no secant at a likely size shows it, and a gyro of another scale does the same.
    """
    turns: dict[str, list[Array]] = {}
    predictor = residuals.predictor
    for window, measured in zip(predictor.dataset.windows, predictor.measured, strict=True):
        if "lateral_acceleration" in measured:
            return ""
        if {"yaw_rate", "course"} <= measured.keys():
            step = float(np.diff(grid(window)[:2])[0])
            over = round(SETTINGS.turning_over / step)
            angle = cumulative_trapezoid(measured["yaw_rate"], dx=step, initial=0)
            if len(angle) > over:
                both = [np.unwrap(measured["course"]), angle]
                turns.setdefault(window.name, []).append(np.array([of[over:] - of[:-over] for of in both]))
    ratios = {}
    for name, parts in turns.items():
        course, gyro = np.concatenate(parts, axis=1)
        bends = np.sqrt(np.mean(course**2)) > SETTINGS.least_yaw_rate * SETTINGS.turning_over
        ratio = float(course @ gyro) / max(float(course @ course), 1e-12)
        if bends and 0.5 < ratio < 1 - SETTINGS.banked:
            ratios[name] = ratio
    if not ratios:
        return ""
    listed = (
        f"{ratio:.3f} in {name} (a bank of {np.degrees(np.arccos(ratio)):.0f}°)" for name, ratio in ratios.items()
    )
    if max(ratios.values()) - min(ratios.values()) > SETTINGS.banked / 2:
        cause = "in bends that are banked; a gyro of another scale would read as much too little in each of them"
    else:
        cause = "in bends that are banked, or with a gyro of another scale"
    return f"the gyro reads less than the course turns, by a factor of {', '.join(listed)}, as it does {cause}"


def is_symmetric(name: str) -> bool:
    """True if a number of the car, by its dotted name, means the same where left and right are exchanged."""
    parts = name.split(".")
    if parts[0] != "effects" or len(parts) < 3:
        return True
    return parts[2] not in EVERY[parts[1]].handed()


def separated_by_other_side(names: Sequence[str]) -> bool:
    """True if bends to the other side as well separate numbers of the car, by their dotted names."""
    return len({is_symmetric(name) for name in names}) > 1


def what_looks_alike(search: Search, judged: Judged) -> tuple[list[str], str]:
    """Remarks on what an answer cannot distinguish, and what to drive to distinguish it, in words; empty for nothing.

    Always these are bends that may be banked, as far as a gyro and the course show it. Where nothing is named these are
    effects for which base parameters may stand in, where several explanations remain it is these that bends to the
    other side would help to distinguish.
    """
    side, asymmetric = side_of_bends(search.residuals), False
    said = [remark for remark in [seen_of_banks(search.residuals)] if remark]
    if judged.verdict in ("unknown", "no_mismatch"):
        for one in stand_ins(search):
            said.append(_remark(one))
            asymmetric |= any(
                separated_by_other_side((one.parameter, c.free_parameters[0].name)) for c, _ in one.effects
            )
    elif judged.verdict == "ambiguous":
        own = [c for one in judged.rivals for c in one.candidates if c.effect not in judged.sure]
        asymmetric = separated_by_other_side([parameter.name for c in own for parameter in c.free_parameters])
    return said, f"the same bends to the other side, as all of these go to the {side}" if side and asymmetric else ""


def _remark(one: StandIn) -> str:
    alike = [
        f"{candidate.sentence} ({label(candidate.free_parameters[0].name.rsplit('.', 1)[-1])} "
        f"{shown_value(size, candidate.free_parameters[0].unit)})"
        for candidate, size in one.effects
    ]
    return (
        f"{base_name(one.parameter)} is fitted {shown_value(one.offset, one.unit, change=True)} off the vehicle file, "
        f"{abs(one.deviations):.1f} standard deviations; with it at the file's value these drives would be explained "
        f"about as well by {', or by '.join(alike)}"
    )
