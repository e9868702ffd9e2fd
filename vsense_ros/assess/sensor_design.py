"""Which accuracy of heading and side slip a set of sensors gives, and which sensors a wanted accuracy needs.

The saloon drives a manoeuvre with all its degrees of freedom. Each filter follows it once without any noise, which
leaves what its own model lacks, and then with the noise of some seeds. Beside that stand the closed forms of Leung 2010
(section 4.6), which need no filter, and the deviation that the filter states of itself.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.text import Text

from vsense_ros.assess.drives import STEP, Case, Error, Errors, Truth, drive_plant, readings
from vsense_ros.assess.filter_run import follow
from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import wrap
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.manoeuvre.receivers import RECEIVERS
from vsense_ros.navigation import accuracy
from vsense_ros.navigation.car_numbers import STRAIGHT
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.space import MOTION

Array = NDArray[np.float64]
Progress = Callable[[float], None]

SETTLED = 20.0  # [s] from where on errors count, of a drive that is at least three times as long
ANTENNAS = 0.0025  # [m] of each of two antennas, by carrier phase: 0.2° over a metre
BY_PRICE = ("dg_100", "dg_100_antenna", "consumer", "mapping", "survey")
RATES = (1.0, 10.0)  # [Hz] of fixes that are compared
_DEGREE = np.pi / 180


@dataclass(frozen=True)
class Grade:
    """Grade of inertial sensors: noise of a sample of 10 ms and bias, of a rate [rad/s] and of a specific force
    [m/s²]."""

    title: str
    gyro: Error
    force: Error


# By price. Noise densities that are common in each class, times √50 Hz; what a car shakes comes on top.
GRADES = {
    "cheap": Grade("Leung 2010, appendix B", Errors().gyro, Errors().force),
    "industrial": Grade(
        "0.008 °/s/√Hz, 100 µg/√Hz", Error(0.057 * _DEGREE, 0.2 * _DEGREE), Error(0.007, 0.05)
    ),
    "tactical": Grade("0.002 °/s/√Hz, 20 µg/√Hz", Error(0.014 * _DEGREE, 0.02 * _DEGREE), Error(0.0014, 0.01)),
}  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """A manoeuvre by name, the sensors' errors, unreported latency of fixes [s], and an outage [s, s]."""

    manoeuvre: str
    errors: Errors
    latency: float = 0.0
    outage: tuple[float, float] | None = None

    def case(self, seed: int, noise: float = 1.0) -> Case:
        return Case(self.manoeuvre, seed, self.errors, self.outage, noise=noise)


@dataclass(frozen=True)
class Budget:
    """Standard deviations [°] of the side slip as course less heading, by cause, and the quantities that they follow
    from."""

    parts: Mapping[str, float]
    speed: float  # [m/s]
    turning: float  # [s] for which the car turns without a straight, at most
    slip_rate: float  # [rad/s] root mean square of the side slip's

    @property
    def total(self) -> float:
        """[°]"""
        return float(np.sqrt(sum(part**2 for part in self.parts.values())))


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of one angle by one filter [°]: the standard deviation that it states, the root mean square error over
    all seeds, and of that the part caused by noise and the part that remains without any noise."""

    stated: float
    rmse: float
    noise: float
    model: float


@dataclass(frozen=True)
class Follow:
    """Results of one filter: the accuracy of both angles, None where it does not estimate one; and over time t (n,) [s]
    the true and the estimated side slip of the first seed with its stated deviation [°]."""

    heading: Accuracy | None
    side_slip: Accuracy | None
    t: Array
    true: Array
    estimated: Array
    deviation: Array


def with_receiver(errors: Errors, name: str, rate: float) -> Errors:
    """The errors with the velocity of a receiver and so many fixes a second. Raises `InputError`, unknown name."""
    if name not in RECEIVERS:
        raise InputError(f"no receiver {name!r}; known are {', '.join(RECEIVERS)}")
    return replace(errors, fix=RECEIVERS[name].velocity, fix_period=1 / rate)


def with_grade(errors: Errors, name: str) -> Errors:
    """The errors with the inertial sensors of a grade. Raises `InputError` for an unknown name."""
    if name not in GRADES:
        raise InputError(f"no grade {name!r} of inertial sensors; known are {', '.join(GRADES)}")
    return replace(errors, gyro=GRADES[name].gyro, force=GRADES[name].force)


def with_antennas(errors: Errors, distance: float) -> Errors:
    """The errors with two antennas so far apart [m]."""
    return replace(errors, heading=accuracy.heading_by_antennas(ANTENNAS, distance))


def budget(plan: Plan, truth: Truth) -> Budget:
    """Error budget of the side slip by closed forms."""
    errors, slip = plan.errors, truth.side_slip
    settled = truth.t > _settled(truth)
    speed = float(np.mean(truth.forward_velocity[settled]))
    rate = float(np.sqrt(np.mean(np.gradient(slip, truth.t)[settled] ** 2)))
    turning = _longest(np.abs(truth.yaw_rate) > STRAIGHT) * STEP
    if plan.outage is not None:
        turning = max(turning, plan.outage[1] - plan.outage[0])
    course = float(accuracy.course(errors.fix, speed))
    if errors.heading is not None:
        heading = errors.heading
    else:  # a straight aligns the heading with the course, as well as one fix does
        heading = float(accuracy.heading_by_gyro(turning, errors.gyro.noise, STEP, start=course))
    period = errors.fix_period if plan.outage is None else plan.outage[1] - plan.outage[0]
    parts = {
        "course of a fix": course,
        "heading": heading,
        "held between fixes": float(accuracy.held(rate, period)),
        "fixes late": float(accuracy.late(rate, plan.latency)),
    }
    return Budget({name: float(np.degrees(part)) for name, part in parts.items()}, speed, turning, rate)


def _longest(true: NDArray[np.bool_]) -> int:
    """The longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _settled(truth: Truth) -> float:
    return min(SETTLED, float(truth.t[-1]) / 3)


def expect(name: str, plan: Plan, truth: Truth, seeds: int) -> Follow:
    """Expected accuracy of a filter with the sensors of the plan."""
    bare = plan.case(0, noise=0.0)
    without, at = follow(name, truth, bare, readings(truth, bare))
    runs = []
    for seed in range(seeds):
        case = plan.case(seed)
        runs.append(follow(name, truth, case, readings(truth, case))[0])
    rows = truth.t[at] > _settled(truth)
    if plan.outage is not None:
        rows &= (truth.t[at] >= plan.outage[0]) & (truth.t[at] < plan.outage[1])
    heading = slip = None
    first = runs[0]
    if "yaw" in first.estimated:
        place = MOTION.index("yaw")
        heading = _accuracy(
            [one.value[:, place] for one in runs], without.value[:, place], truth.yaw[at],
            np.sqrt([one.pose_covariance[:, 5, 5] for one in runs]), rows,
        )  # fmt: skip
    if first.has_side_slip:
        slip = _accuracy(
            [one.side_slip[:, 0] for one in runs], without.side_slip[:, 0], truth.side_slip[at],
            np.array([one.side_slip[:, 1] for one in runs]), rows,
        )  # fmt: skip
    estimated, deviation = (np.degrees(first.side_slip[:, i]) for i in (0, 1))
    return Follow(heading, slip, truth.t[at], np.degrees(truth.side_slip[at]), estimated, deviation)


def _accuracy(
    estimates: Sequence[Array], without_noise: Array, true: Array, stated: Array, rows: NDArray[np.bool_]
) -> Accuracy:
    def size(errors: Array) -> float:
        return float(np.degrees(np.sqrt(np.mean(wrap(errors[..., rows]) ** 2))))

    values = np.array(estimates)
    finite = np.where(np.isfinite(stated), stated, np.nan)[..., rows]
    return Accuracy(
        stated=float(np.degrees(np.sqrt(np.nanmean(finite**2)))) if np.isfinite(finite).any() else float("nan"),
        rmse=size(values - true),
        noise=size(values - without_noise),
        model=size(without_noise - true),
    )


@dataclass(frozen=True)
class Choice:
    """A receiver, fixes a second and a grade of inertial sensors: side slip [°] to be expected."""

    receiver: str
    rate: float
    grade: str
    side_slip: float


def choices(name: str, plan: Plan, truth: Truth, seeds: int, progress: Progress = lambda share: None) -> list[Choice]:
    """All receivers, rates and grades by one filter, by price. Raises `InputError` if it estimates no side slip."""
    compared = []
    every = [(receiver, rate, grade) for receiver in BY_PRICE for rate in RATES for grade in GRADES]
    for i, (receiver, rate, grade) in enumerate(every):
        errors = with_grade(with_receiver(plan.errors, receiver, rate), grade)
        slip = expect(name, replace(plan, errors=errors), truth, seeds).side_slip
        if slip is None:
            raise InputError(f"the filter {name!r} estimates no side slip: nothing can be chosen by it")
        compared.append(Choice(receiver, rate, grade, slip.rmse))
        progress((i + 1) / len(every))
    return compared


def cheapest(compared: Sequence[Choice], wanted: float) -> list[Choice]:
    """Choices that reach the wanted side slip [°] and of which no part can be had cheaper or slower."""
    receivers, grades = list(BY_PRICE), list(GRADES)

    def cost(one: Choice) -> tuple[float, ...]:
        return receivers.index(one.receiver), one.rate, grades.index(one.grade)

    reach = [one for one in compared if one.side_slip <= wanted]
    return [
        one
        for one in reach
        if not any(
            other is not one and all(a <= b for a, b in zip(cost(other), cost(one), strict=True)) for other in reach
        )
    ]


@dataclass(frozen=True)
class Design:
    """Results for a plan: the budget, the accuracy of filters, and what could be bought, where that was asked."""

    plan: Plan
    budget: Budget
    filters: Mapping[str, Follow]
    wanted: float | None  # [°]
    choices: Sequence[Choice]
    best: str


def design(
    plan: Plan,
    names: Sequence[str],
    store: Path,
    *,
    wanted: float | None = None,
    seeds: int = 5,
    progress: Progress = lambda share: None,
) -> Design:
    """Raises `InputError` for a manoeuvre or a filter that is not known, or that these sensors do not drive."""
    if plan.manoeuvre not in MANOEUVRES:
        raise InputError(f"no manoeuvre {plan.manoeuvre!r}; known are {', '.join(MANOEUVRES)}")
    for name in names:
        FILTERS[name]
        if FILTERS[name].name not in DEFINITIONS:
            raise InputError(f"the filter {name!r} is none of those by GNSS and INS (vsense filters)")
    duration = MANOEUVRES[plan.manoeuvre].duration
    if plan.outage is not None and not 0 < plan.outage[0] < plan.outage[1] <= duration:
        raise InputError(
            f"an outage from {plan.outage[0]:g} to {plan.outage[1]:g} s is not within {plan.manoeuvre}, which takes "
            f"{duration:.0f} s"
        )
    truth = drive_plant(plan.manoeuvre, plan.case(0).plant, store)
    progress(0.1)
    share = 0.3 if wanted is not None else 0.9
    results = {}
    for i, name in enumerate(names):
        results[name] = expect(name, plan, truth, seeds)
        progress(0.1 + share * (i + 1) / len(names))
    estimating = {name: one.side_slip.rmse for name, one in results.items() if one.side_slip is not None}
    best = min(estimating, key=lambda name: estimating[name], default="")
    every: list[Choice] = []
    if wanted is not None:
        if not best:
            raise InputError(f"none of the filters {', '.join(names)} estimates the side slip")
        every = choices(best, plan, truth, max(1, seeds // 2), lambda part: progress(0.4 + 0.6 * part))
    progress(1.0)
    return Design(plan, budget(plan, truth), results, wanted, every, best)


def show(design: Design, console: Console) -> None:
    """Print what is to be expected, and what to buy."""
    plan, parts = design.plan, design.budget
    errors = plan.errors
    rest = (
        f" at {parts.speed:.1f} m/s: turns for up to {parts.turning:.1f} s, side slip changes by "
        f"{np.degrees(parts.slip_rate):.2f} °/s (RMS)."
    )
    console.print(Text.assemble((plan.manoeuvre, "bold"), rest))
    console.print(
        f"Fixes at {1 / errors.fix_period:g} Hz of {errors.fix:g} m/s; gyro {np.degrees(errors.gyro.noise):.2g} °/s a "
        f"sample, bias {np.degrees(errors.gyro.bias):.2g} °/s; accelerometers {errors.force.noise:.2g} m/s², bias "
        f"{errors.force.bias:.2g} m/s²"
        + (f"; heading of two antennas {np.degrees(errors.heading):.2g} °" if errors.heading is not None else "")
        + ".",
        soft_wrap=True,
    )
    table = plain_table("Side slip as course less heading, closed forms", "[°]", right=("[°]",))
    for name, part in parts.parts.items():
        table.add_row(name, f"{part:.2g}")
    table.add_row("together", f"{parts.total:.2g}", style="bold")
    console.print(table)
    headings = ("side slip", "by noise", "by its model", "stated", "heading", "stated of it")
    table = plain_table("Filter, RMSE [°]", *headings, right=headings)
    for name, one in design.filters.items():
        slip, heading = one.side_slip, one.heading
        cells = ["–"] * 4 if slip is None else [f"{v:.3f}" for v in (slip.rmse, slip.noise, slip.model, slip.stated)]
        cells += ["–"] * 2 if heading is None else [f"{v:.3f}" for v in (heading.rmse, heading.stated)]
        table.add_row(name, *cells)
    console.print(table)
    if design.wanted is not None:
        _show_choices(design, design.wanted, console)


def _show_choices(design: Design, wanted: float, console: Console) -> None:
    table = plain_table(f"Side slip by {design.best} [°]", *GRADES, right=tuple(GRADES))
    for receiver in BY_PRICE:
        for rate in RATES:
            row = [one for one in design.choices if (one.receiver, one.rate) == (receiver, rate)]
            cells = [
                Text(f"{c.side_slip:.3f} ✓", style="bold") if c.side_slip <= wanted else Text(f"{c.side_slip:.3f}  ")
                for c in row
            ]
            table.add_row(f"{receiver}, {rate:g} Hz", *cells)
    console.print(table)
    reach = cheapest(design.choices, wanted)
    if reach:
        words = "; ".join(f"{one.receiver} at {one.rate:g} Hz with {one.grade} inertial sensors" for one in reach)
        enough = Text.assemble((f"Enough for {wanted:g}°", "bold"), f", and nothing cheaper is: {words}.")
        console.print(enough, soft_wrap=True)
        return
    best = min(design.choices, key=lambda one: one.side_slip)
    own = design.filters[design.best].side_slip
    model = f" Without any noise the filter's own model leaves {own.model:.3f}°." if own is not None else ""
    rest = (
        f"; the best is {best.side_slip:.3f}° of {best.receiver} at {best.rate:g} Hz with {best.grade} inertial "
        f"sensors.{model} Two antennas (--antennas) or another filter may help."
    )
    console.print(Text.assemble((f"None reaches {wanted:g}°", "bold"), rest), soft_wrap=True)


def write(design: Design, path: Path) -> None:
    """Write the design as JSON, angles in degrees."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "plan": asdict(design.plan),
        "budget_deg": {**design.budget.parts, "together": design.budget.total},
        "filters_deg": {
            name: {
                "side_slip": None if one.side_slip is None else asdict(one.side_slip),
                "heading": None if one.heading is None else asdict(one.heading),
            }
            for name, one in design.filters.items()
        },
        "wanted_deg": design.wanted,
        "choices": [asdict(one) for one in design.choices],
        "enough": [] if design.wanted is None else [asdict(one) for one in cheapest(design.choices, design.wanted)],
    }
    with atomic_write(path) as file:
        json.dump(content, file, indent=2)
        file.write("\n")
