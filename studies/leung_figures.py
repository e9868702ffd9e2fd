"""Figures of Leung 2010 on the receiver, the CAN bus and the hill, chapter 4: what each shows in numbers and as curves.

The thesis prints no numbers of its curves: `says` is what its text says of them. A figure is made from our plant and
the first seed of the noise. Those of section 4.4 have a perfect gyro, and accelerometers without gravity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.text import Text

from studies.leung import ON_THE_BUS, ROWS, SECTION_4_4, SHORT, write_figures
from studies.leung_models_picture import COLOURS, labelled, page
from studies.leung_study import study
from studies.tasks import DoTasks, in_turn, pool
from vsense_ros.assess.drives import PLANT, SETTLED, STEP, Bus, Case, Error, Errors, Truth, drive_plant, readings
from vsense_ros.assess.filter_run import follow
from vsense_ros.errors import InputError
from vsense_ros.evaluate.picture import TRUTH
from vsense_ros.evaluate.signals import wrap
from vsense_ros.evaluate.terminal import console, plain_table, progress, say
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import drive
from vsense_ros.model.coordinates import BANK, GRADE, PITCH, ROLL, VELOCITY, YAW_RATE
from vsense_ros.navigation.space import MOTION, Definition
from vsense_ros.navigation.thesis.dual_kkf import DUAL_KKF, DUAL_KKF_WITHOUT_HOLD, dual
from vsense_ros.navigation.thesis.velocity_kkf import HELD
from vsense_ros.navigation.yaw_kkf import COURSE

Array = NDArray[np.float64]
Rows = dict[str, dict[str, float]]

RATES = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0, 100.0)  # [Hz] of the receiver
VARIANCES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # of its velocity [m²/s²]
FORWARD, ACROSS = "forward_velocity", "lateral_velocity"
TURNS = np.radians(1.0)  # [rad/s] above it a drive is a bend
DOUBTED = replace(HELD, deviations=(100.0, 100.0))  # a held fix of R = 100²


@dataclass(frozen=True)
class Panel:
    """Curves (x, y) by label on a pair of axes."""

    title: str
    x: str
    y: str
    curves: Mapping[str, tuple[Array, Array]]
    logarithmic: bool = False


@dataclass(frozen=True)
class Content:
    """Numbers by row and column, and panels."""

    rows: Rows
    panels: list[Panel] = field(default_factory=list)


@dataclass(frozen=True)
class Figure:
    """One figure of the thesis; `make` is given the folder of what the plant did, and what does tasks."""

    title: str
    says: str
    make: Callable[[Path, DoTasks], Content]


def sweep(quantity: str, filters: tuple[str, ...], by_variance: bool, store: Path, do_tasks: DoTasks) -> Content:
    """RMSE of a velocity [m/s] by filter and course over the rate of the receiver, or over its variance."""
    values: tuple[float, ...]
    if by_variance:
        values, unit, what = VARIANCES, "m²/s²", "variance of the velocity [m²/s²]"
        every = [replace(SECTION_4_4, fix=variance**0.5) for variance in values]
    else:
        values, unit, what = RATES, "Hz", "fixes a second"
        every = [replace(SECTION_4_4, fix_period=1 / rate) for rate in values]
    cases = {(row, i): Case(name, 0, errors) for row, name in SHORT.items() for i, errors in enumerate(every)}
    found = study([(case, filters) for case in cases.values()], store, do_tasks=do_tasks)
    rows, panels = {}, []
    for one in filters:
        curves = {}
        for row in SHORT:
            errors_of = [float(found[cases[row, i], one][quantity]["rmse"]) for i in range(len(values))]
            rows[f"{row} {one}"] = {f"{v:g} {unit}": error for v, error in zip(values, errors_of, strict=True)}
            curves[row] = (np.array(values), np.array(errors_of))
        panels.append(Panel(one, what, f"{quantity.replace('_', ' ')} [m/s]", curves, logarithmic=True))
    return Content(rows, panels)


def _swept(quantity: str, filters: tuple[str, ...], by_variance: bool) -> Callable[[Path, DoTasks], Content]:
    return lambda store, do_tasks: sweep(quantity, filters, by_variance, store, do_tasks)


def lateral_gain(truth: Truth, errors: Errors, definition: Definition) -> tuple[Array, Array]:
    """K³² of the velocity filter at each reading (n,), where the last fix is held, and where a fix comes.

    After a correction by (v_x, v_y) with covariance diag(R), K = P H' R⁻¹. At a fix, K is 1 less the variance after it
    over that before it; elsewhere this is NaN.
    """
    case = Case(SHORT["SD"], 0, errors)
    read = readings(truth, case)
    motions, at = follow("dual_kkf", truth, case, read, definition=definition, every=1)
    variance = motions.twist_covariance[:, 1, 1]
    held = next(one for one in definition.measurements if one.name == HELD.name)
    of_fix = np.full(len(at), np.nan)
    fixes = np.flatnonzero(np.isfinite(read.fixes[at, 0]))
    fixes = fixes[fixes > 0]
    of_fix[fixes] = 1 - variance[fixes] / variance[fixes - 1]
    return variance / held.variances[1], of_fix


def gains(store: Path, do_tasks: DoTasks) -> Content:
    """Figure 4.20."""
    truth = drive_plant(SHORT["SD"], PLANT, store)
    rows, curves = {}, {}
    t = truth.t[1:]
    shown = (t > 54.0) & (t < 57.0)
    for label, definition in (("R = 1²", DUAL_KKF), ("R = 100²", dual(COURSE, held=DOUBTED))):
        held, of_fix = lateral_gain(truth, SECTION_4_4, definition)
        settled = (t > SETTLED) & np.isnan(of_fix)
        rows[label] = {
            "at a fix": float(np.nanmean(of_fix[t > SETTLED])),
            "between, mean": float(held[settled].mean()),
            "between, largest": float(held[settled].max()),
        }
        gain = np.where(np.isnan(of_fix), held, of_fix)
        curves[label] = (t[shown], gain[shown])
    return Content(rows, [Panel("gain of the lateral velocity, SD", "[s]", "K³²", curves, logarithmic=True)])


def slalom(configurations: Mapping[str, Definition], store: Path) -> Content:
    """Lateral velocity [m/s] of dual filters in the course SD: RMSE in bends and on its straights, the largest
    overshoot in a bend, and RMSE on the straight course."""
    truth, straight = (drive_plant(SHORT[row], PLANT, store) for row in ("SD", "ST"))
    case = Case(SHORT["SD"], 0, SECTION_4_4)
    read = readings(truth, case)
    read_straight = readings(straight, replace(case, manoeuvre=SHORT["ST"]))
    rows: Rows = {}
    values, errors = {"truth": (truth.t, truth.lateral_velocity)}, {}
    for label, definition in configurations.items():
        motions, at = follow("dual_kkf", straight, case, read_straight, definition=definition)
        on_straight = _lateral(motions.value[:, MOTION.index(ACROSS)], straight, at)["all"]
        motions, at = follow("dual_kkf", truth, case, read, definition=definition)
        estimate = motions.value[:, MOTION.index(ACROSS)]
        rows[label] = {**_lateral(estimate, truth, at), "course ST": on_straight}
        values[label] = (truth.t[at], estimate)
        errors[label] = (truth.t[at], np.abs(estimate - truth.lateral_velocity[at]))
    return Content(
        rows,
        [Panel("lateral velocity, SD", "[s]", "[m/s]", values), Panel("absolute error", "[s]", "[m/s]", errors)],
    )


def bus(store: Path, do_tasks: DoTasks) -> Content:
    """Figure 4.6: a gyro without noise or bias, directly and by the CAN bus, and the dual KKF with either."""
    truth = drive_plant(ROWS["DO35"], PLANT, store)
    rows: Rows = {}
    rates, headings, slips = {}, {}, {}
    bends = np.flatnonzero(np.abs(truth.yaw_rate) > TURNS)
    shown = slice(bends[0], bends[0] + round(1.0 / STEP))
    for label, carried in (("direct", None), ("bus", Bus())):
        case = Case(ROWS["DO35"], 0, replace(ON_THE_BUS, gyro=Error(1e-6, 0.0), bus=carried))
        read = readings(truth, case)
        motions, at = follow("dual_kkf", truth, case, read)
        heading = np.degrees(wrap(motions.value[:, MOTION.index("yaw")] - truth.yaw[at]))
        slip = np.degrees(motions.side_slip[:, 0] - truth.side_slip[at])
        settled = truth.t[at] > SETTLED
        fixes = np.flatnonzero(np.isfinite(read.fixes[at, 0]) & settled)
        course = np.arctan2(read.fixes[at[fixes], 1], read.fixes[at[fixes], 0])
        by_fix = wrap(course - motions.value[fixes, MOTION.index("yaw")] - truth.side_slip[at[fixes]])
        rows[label] = {
            "yaw rate, changes a second": float(np.mean(np.abs(np.diff(read.imu[bends, 2])) > 1e-4) / STEP),
            "heading [°]": _rms(heading[settled]),
            "side slip of a fix [°]": _rms(np.degrees(by_fix)),
            "side slip of velocity [°]": _rms(slip[settled]),
        }
        rates[label] = (truth.t[shown], np.degrees(read.imu[shown, 2]))
        headings[label], slips[label] = (truth.t[at], heading), (truth.t[at], slip)
    return Content(
        rows,
        [
            Panel("yaw rate at the beginning of a bend", "", "[°/s]", rates),
            Panel("heading error", "", "[°]", headings),
            Panel("side slip error", "[s]", "[°]", slips),
        ],
    )


def in_road_axes(velocity: Array, roll: Array, pitch: Array) -> Array:
    """Vertical velocity (n,) [m/s] in the axes of the road of a velocity (n, 3) in those of the body, which has these
    tilt angles (n,) [rad] on the road (eq. 4.35)."""
    s, c = np.sin(pitch), np.cos(pitch)
    return np.asarray(
        -s * velocity[:, 0] + np.sin(roll) * c * velocity[:, 1] + np.cos(roll) * c * velocity[:, 2],
    )


def vertical(store: Path, do_tasks: DoTasks) -> Content:
    """Figures 4.43 and 4.44: on the hill of table 4.12, with the true velocity and the true tilt angles."""
    driven = drive("hill", load_vehicle(vehicle_path(PLANT)))
    keep = slice(None, None, round(STEP / (driven.t[1] - driven.t[0])))
    q, velocity, road = driven.q[keep], driven.u[keep, VELOCITY], np.asarray(driven.disturbances)[keep]
    t = driven.t[keep]
    kinds = {
        "b-frame": velocity[:, 2],
        "v-frame without roll": in_road_axes(velocity, np.zeros(len(t)), q[:, PITCH]),
        "v-frame": in_road_axes(velocity, q[:, ROLL], q[:, PITCH]),
    }
    curves = {label: (t, values) for label, values in kinds.items()}
    kinds["what the roll contributes"] = kinds["v-frame"] - kinds["v-frame without roll"]
    turning, banked = np.abs(driven.u[keep, YAW_RATE]) > TURNS, np.abs(road[:, BANK]) > 0.01
    parts = {
        "level straights": ~turning & ~banked & (np.abs(road[:, GRADE]) < 1e-3),
        "climbs, straight": ~turning & ~banked & (np.abs(road[:, GRADE]) > 0.01),
        "banked straights": ~turning & banked,
        "banked turn": turning & banked,
    }
    rows = {label: {part: _rms(values[of]) for part, of in parts.items()} for label, values in kinds.items()}
    close = {label: curve for label, curve in curves.items() if label != "b-frame"}
    return Content(
        rows,
        [Panel("vertical velocity on the hill", "", "[m/s]", curves), Panel("in the v-frame", "[s]", "[m/s]", close)],
    )


def before_correction(truth: Truth, case: Case) -> tuple[Array, NDArray[np.int64]]:
    """Lateral velocity (n,) [m/s] of the dual KKF a fix late, at the indices (n,) of the readings that it is of.

    When a fix has come, speed V and side slip ν - ψ̂ on the way from the last one to it are interpolated along a line,
    and correct the filter at each reading. All of them together tell as much as the one fix: each has its variance
    times their number.
    """
    read = readings(truth, case)
    motions, at = follow("yaw_kkf", truth, case, read, every=1)
    heading = np.interp(np.arange(len(truth.t)), at, np.unwrap(motions.value[:, MOTION.index("yaw")]))
    fixes = np.flatnonzero(np.isfinite(read.fixes[:, 0]))
    east, north = read.fixes[fixes].T
    slip = np.unwrap(np.arctan2(north, east) - heading[fixes])
    until = fixes[-1] + 1
    place = np.arange(until)
    speed, course = np.interp(place, fixes, np.hypot(east, north)), heading[:until] + np.interp(place, fixes, slip)
    between = np.full_like(read.fixes, np.nan)
    between[:until] = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    count = case.errors.fix_period / STEP
    errors = replace(case.errors, fix=case.errors.fix * count**0.5, fix_period=STEP)
    motions, at = follow("dual_kkf_free", truth, replace(case, errors=errors), replace(read, fixes=between))
    known = at < until
    return motions.value[known, MOTION.index(ACROSS)], at[known]


def delayed(store: Path, do_tasks: DoTasks) -> Content:
    """Section 4.4.7: side slip interpolated before the correction, beside what section 4.4.6 does after it."""
    rows: Rows = {}
    curves: dict[str, tuple[Array, Array]] = {}
    for row, manoeuvre in SHORT.items():
        truth, case = drive_plant(manoeuvre, PLANT, store), Case(manoeuvre, 0, SECTION_4_4)
        read = readings(truth, case)
        kinds = {}
        for label, name in (("held", "dual_kkf"), ("extrapolated after", "side_slip_kkf_1")):
            motions, at = follow(name, truth, case, read)
            kinds[label] = motions.value[:, MOTION.index(ACROSS)], at
        kinds["interpolated before, 1 s late"] = late, at = before_correction(truth, case)
        live = np.minimum(at + round(case.errors.fix_period / STEP), len(truth.t) - 1)
        kinds["the same, as if of now"] = late, live
        for label, (estimate, of) in kinds.items():
            found = _lateral(estimate, truth, of)
            rows.setdefault(label, {})[row] = found["all"]
            rows[label][f"{row} overshoot"] = found["overshoot"]
            if row == "SD":
                curves[label] = (truth.t[of], estimate)
        if row == "SD":
            curves["truth"] = (truth.t, truth.lateral_velocity)
    columns = [*SHORT, *(f"{row} overshoot" for row in ("8C", "SD"))]
    return Content(
        {label: {column: values[column] for column in columns} for label, values in rows.items()},
        [Panel("lateral velocity, SD", "[s]", "[m/s]", curves)],
    )


def _lateral(estimate: Array, truth: Truth, at: NDArray[np.int64]) -> dict[str, float]:
    settled = truth.t[at] > SETTLED
    error, true = (estimate - truth.lateral_velocity[at])[settled], truth.lateral_velocity[at][settled]
    bend = np.abs(truth.yaw_rate[at][settled]) > TURNS
    over = float((error * np.sign(true))[bend].max()) if bend.any() else 0.0
    return {"all": _rms(error), "bends": _rms(error[bend]), "straights": _rms(error[~bend]), "overshoot": over}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


_TILTED = "in the b-frame it is not zero even on straights; in the v-frame it is small"

FIGURES: dict[str, Figure] = {
    "4.6": Figure(
        "a gyro without noise, directly and by the CAN bus, and the dual KKF with either, DO35",
        "100 values a second of the yaw rate become about 5; heading and side slip become inaccurate",
        bus,
    ),
    "4.18": Figure(
        "forward velocity over the rate of the receiver, 5e-4 m²/s²",
        "the five courses lie close together; from 0.1 to 5 Hz the error falls more than from 5 to 100 Hz",
        _swept(FORWARD, ("dual_kkf",), False),
    ),
    "4.19": Figure(
        "lateral velocity over the rate of the receiver, 5e-4 m²/s²",
        "ST has the least error and SD the largest; from 5 Hz on the courses join",
        _swept(ACROSS, ("dual_kkf", "inertial"), False),
    ),
    "4.20": Figure(
        "gain K³² of the velocity KKF with a held fix of R = 1² and of 100², SD, 1 Hz",
        "about 1 at a fix; between fixes small with 1², near zero with 100²",
        gains,
    ),
    "4.21": Figure(
        "lateral velocity with a held fix of R = 1² and of 100², SD, 1 Hz",
        "1² errs more in bends, and is more accurate on straights",
        lambda store, do_tasks: slalom({"R = 1²": DUAL_KKF, "R = 100²": dual(COURSE, held=DOUBTED)}, store),
    ),
    "4.22": Figure(
        "forward velocity over the variance of the receiver, 1 Hz",
        "the error grows with the variance; below 1e-2 m²/s² SD is apart from the other courses",
        _swept(FORWARD, ("dual_kkf", "dual_kkf_free"), True),
    ),
    "4.23": Figure(
        "lateral velocity over the variance of the receiver, 1 Hz",
        "the error grows with the variance, and depends much on the course; it saturates towards small variances",
        _swept(ACROSS, ("dual_kkf", "inertial"), True),
    ),
    "4.24": Figure(
        "lateral velocity with fixes held (H = 1) and not (H = 0), SD, 1 Hz",
        "H = 0 follows the truth more closely, with overshoots; H = 1 is better where the lateral velocity is 0",
        lambda store, do_tasks: slalom({"H = 1": DUAL_KKF, "H = 0": DUAL_KKF_WITHOUT_HOLD}, store),
    ),
    "4.25": Figure(
        "lateral velocity over the rate of the receiver, fixes held and not",
        "without hold the courses have one curve; only SD gains by it",
        _swept(ACROSS, ("dual_kkf", "dual_kkf_free"), False),
    ),
    "4.26": Figure(
        "lateral velocity over the variance of the receiver, fixes held and not",
        "without hold the courses have one curve; only SD gains by it",
        _swept(ACROSS, ("dual_kkf", "dual_kkf_free"), True),
    ),
    "4.43": Figure("vertical velocity [m/s] in the axes of the body and of the road, hill", _TILTED, vertical),
    "4.44": Figure(
        "vertical velocity [m/s] in the axes of the road, with and without the roll of the body, hill",
        "the roll matters in the banked turns, and hardly elsewhere",
        vertical,
    ),
    "4.4.7": Figure(
        "lateral velocity with a side slip interpolated before the correction, 1 Hz (a section: no figure is printed)",
        "before the correction the states show a delay, but no overshoots occur",
        delayed,
    ),
}


def draw_all(folder: Path, store: Path, done: Callable[[float], None]) -> list[Path]:
    """Draw every figure of this file; what the plant and the filters did is kept in `store`."""
    paths = []
    for i, (name, figure) in enumerate(FIGURES.items()):
        paths.append(draw(name, figure.make(store, in_turn), folder))
        done((i + 1) / len(FIGURES))
    return paths


def repeat(names: tuple[str, ...], processes: int | None, out: Path) -> None:
    """Make figures, print and draw them, and add their numbers to the JSON file `out`. Raises `InputError` for an
    unknown one."""
    check(names)
    folder, made = out.with_suffix(""), {}
    with progress("driving and estimating") as done, pool(processes) as do_tasks:
        for i, name in enumerate(names):
            made[name] = FIGURES[name].make(folder, do_tasks)
            done((i + 1) / len(names))
    for name, content in made.items():
        show(name, content.rows, console())
        draw(name, content, folder / "figures")
    write_figures({name: content.rows for name, content in made.items()}, out)
    say(f"Written to {out}, drawn in {folder / 'figures'}.")


def check(names: tuple[str, ...]) -> None:
    """Raises `InputError` for an unknown figure."""
    for name in names:
        if name not in FIGURES:
            raise InputError(
                f"no figure {name!r} in numbers; there are: {', '.join(FIGURES)} (--figures draws the rest)"
            )


def show(name: str, rows: Rows, out: Console) -> None:
    """Print what a figure shows, and what the thesis says of it."""
    figure = FIGURES[name]
    columns = list(next(iter(rows.values())))
    out.print(Text.assemble("\n", (f"Figure {name}", "bold"), f": {figure.title}"))
    table = plain_table("", *columns, right=columns)
    for row, values in rows.items():
        table.add_row(row, *(f"{values[column]:.3g}" for column in columns))
    out.print(table)
    out.print(f"Thesis: {figure.says}.", soft_wrap=True)


def draw(name: str, content: Content, folder: Path) -> Path:
    """Draw the panels of a figure."""
    folder.mkdir(parents=True, exist_ok=True)
    count = len(content.panels)
    wide = any(panel.logarithmic for panel in content.panels)
    with page(f"Figure {name}", (5.5 * count, 4.2) if wide else (10, 3.0 * count)) as (one, save):
        shape = (1, count) if wide else (count, 1)
        for axes, panel in zip(one.subplots(*shape, squeeze=False).ravel(), content.panels, strict=True):
            colours = iter(COLOURS)
            for label, (x, y) in panel.curves.items():
                style = "o-" if panel.logarithmic and len(x) < 20 else "-"
                colour = TRUTH if label == "truth" else next(colours)
                axes.plot(x, y, style, color=colour, lw=0.9, ms=3, label=label)
            labelled(axes, panel.title, panel.x, panel.y)
            if panel.logarithmic:
                axes.set_yscale("log")
                if style == "o-":
                    axes.set_xscale("log")
            axes.legend(fontsize=7)
        return save(folder / f"figure_{name.replace('.', '_')}.png")
