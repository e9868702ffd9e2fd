"""What figures of the tables of Leung 2010 depend on: plant or sensors with one thing changed, one drive each.

The plant is not the thesis's. Some of its properties were fitted to figures of the thesis; these experiments take them
back one by one, and show which figures they move.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.table import Table

from studies import leung, leung_models
from studies.leung_study import estimate
from vsense_ros.assess.drives import PLANT, Bus, Case, Errors, digest, drive_plant, trajectory
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle, save_vehicle
from vsense_ros.model.coordinates import SPEED_X, SPEED_Y, STEERING
from vsense_ros.navigation.space import Definition
from vsense_ros.navigation.thesis.side_slip_kkf import side_slip_kkf
from vsense_ros.navigation.thesis.velocity_kkf import HELD
from vsense_ros.navigation.thesis.wheel_speed_ekf import PASSED_YAW, WHEEL_SPEED_C


@dataclass(frozen=True)
class Change:
    """What is changed, in words: physical numbers of the plant by their dotted names, errors of the sensors in place of
    those of the table, or the filter."""

    words: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    errors: Errors | None = None
    noise: float = 1.0  # factor on that of all sensors
    definition: Definition | None = None


@dataclass(frozen=True)
class Outcome:
    """A figure of a table: printed (NaN if it is not), ours, and with a change."""

    change: str
    table: str
    row: str
    column: str
    printed: float
    ours: float
    changed: float


def _both(numbers: Mapping[str, float]) -> dict[str, float]:
    return {f"{axle}.{name}": value for axle in ("front", "rear") for name, value in numbers.items()}


def _curves(front: Sequence[float], rear: Sequence[float]) -> dict[str, float]:
    """Lateral curves of both axles: maximum [N], slip there and sliding force [N] at the nominal load, the same at
    twice that, and the initial slope there [N]."""
    names = [f"{load}.{one}" for load in ("nominal", "double") for one in ("maximum", "slip_at_maximum", "sliding")]
    names.append("double.initial_slope")
    return {
        f"{axle}.tyre.lateral.{name}": value
        for axle, values in (("front", front), ("rear", rear))
        for name, value in zip(names, values, strict=True)
    }


# Slips at the maxima are 1.3 times the least that the initial slope allows: a linear share bends the curves at once.
_BENT = _curves((4950, 0.17, 4500, 9300, 0.2, 8500, 131e3), (4350, 0.16, 3960, 8180, 0.19, 7480, 125e3))
# Maxima are 1.6 times the loads.
_STRAIGHT = _curves(
    (7760, 0.2066, 7060, 14590, 0.1992, 13280, 150.9e3), (6820, 0.1905, 6210, 12830, 0.1838, 11670, 143.85e3)
)

# As the thesis uses the heading of the gyro, a hundred times a second.
_HEADING_AS_NEW = replace(WHEEL_SPEED_C, passed_measurements=(replace(PASSED_YAW, repeats=1.0),))
_DOUBTED = 0.02  # [rad], four times the noise of the course of a fix
_AS_A_FIX = replace(HELD, deviations=(leung.SECTION_4_4.fix, leung.SECTION_4_4.fix))

# By the change, which figures are looked at: table, row, title of the column.
EXPERIMENTS: Sequence[tuple[Change, tuple[tuple[str, str, str], ...]]] = (
    (
        Change("the rolling radius depends on the load", _both({"dynamic_radius_factor": 2 / 3})),
        (("4.4", "DO35", "psi of wheels b2 N"), ("4.5", "DO35", "v_x of wheels R")),
    ),
    (
        Change("axles as stiff as their tyres", _both({"cornering_scale": 1.0})),
        (("4.2", "DO45", "beta of fix N"), ("4.2", "LC35", "beta of fix N"), ("4.2", "DO45", "v_y N")),
    ),
    (
        Change("tyres that bend from the start", _BENT),
        (("5.3", "DO35", "beta clean"), ("5.3", "DO45", "beta clean"), ("5.4", "DO45", "beta 2c N")),
    ),
    (
        Change("tyres that hardly bend", _STRAIGHT),
        (
            ("5.3", "DO45", "beta clean"),
            ("5.3", "DO55", "beta clean"),
            ("4.2", "DO55", "beta of fix N"),
            ("5.4", "DO45", "beta 2c N"),
            ("5.4", "DO55", "beta 2c N"),
        ),
    ),
    (
        Change("a body that hardly rolls", _both({"antiroll_stiffness": 5e5})),
        (("4.2", "DO45", "v_y N"), ("4.2", "DO35", "v_y N")),
    ),
    (
        Change("no CAN bus", errors=replace(leung.ON_THE_BUS, bus=None)),
        (("4.2", "DO45", "psi N"), ("4.2", "LC35", "psi N")),
    ),
    (
        Change("a CAN bus without delay", errors=replace(leung.ON_THE_BUS, bus=Bus(delay=0.0))),
        (("5.5", "DO55", "beta SPI N"),),
    ),
    (
        Change("sensors without noise", noise=0.0),
        (
            ("4.2", "LC35", "v_y N"),
            ("4.4", "DO15", "psi of wheels b2 N"),
            ("5.4", "DO45", "beta 2c N"),
            ("5.4", "LC35", "beta 2c N"),
        ),
    ),
    (
        Change("twice the noise of all sensors", noise=2.0),
        (("4.4", "DO15", "psi of wheels b2 N"),),
    ),
    (
        Change("each heading in a bend counts as new", definition=_HEADING_AS_NEW),
        (("4.6", "DO35", "psi of wheels c N"), ("4.6", "DO55", "psi of wheels c N")),
    ),
    (
        Change("a line less sure than its fixes", definition=side_slip_kkf(1, noise=_DOUBTED)),
        (("4.9", "SD", "line V"), ("4.9", "RT", "line V")),
    ),
    (
        Change("a parabola less sure than its fixes", definition=side_slip_kkf(2, noise=_DOUBTED)),
        (("4.9", "SD", "parabola V"),),
    ),
    (
        Change("a line that weighs as a fix", definition=side_slip_kkf(1, held=_AS_A_FIX)),
        (("4.9", "ST", "line V"), ("4.9", "LC", "line V"), ("4.9", "SD", "line V")),
    ),
)


def outcomes(store: Path, progress: Callable[[float], None] = lambda share: None) -> list[Outcome]:
    """Each figure with and without its change, of the first seed. Plants are kept in `store`."""
    unchanged = Change("")
    found = []
    wanted = [(change, *figure) for change, figures in EXPERIMENTS for figure in figures]
    for i, (change, table, row, column) in enumerate(wanted):
        pair = [_figure(one, table, row, column, store) for one in (unchanged, change)]
        found.append(Outcome(change.words, table, row, column, _printed(table, row, column), *pair))
        progress((i + 1) / len(wanted))
    return found


def plant_with(numbers: Mapping[str, float], store: Path) -> str:
    """Name of the plant with other physical numbers: the path of its file."""
    if not numbers:
        return PLANT
    original = vehicle_path(PLANT)
    content = digest(original.read_text(encoding="utf-8"), repr(sorted(numbers.items())))
    file = store / f"{PLANT}_{content}.yaml"
    if not file.exists():
        store.mkdir(parents=True, exist_ok=True)
        save_vehicle(file, load_vehicle(original).with_parameters(dict(numbers)))
    return str(file)


def _figure(change: Change, table: str, row: str, column: str, store: Path) -> float:
    name = plant_with(change.numbers, store)
    if table == "5.3":
        return _clean(name, leung.ROWS[row], store)
    of = leung.TABLES[table]
    manoeuvre, one = of.manoeuvres[row], next(c for c in of.columns if c.title == column)
    case = Case(manoeuvre, 0, change.errors or of.errors, plant=name, noise=change.noise)
    result = estimate(one.filter, drive_plant(manoeuvre, name, store), case, change.definition)
    return leung.figure(result, one)


def _clean(plant: str, manoeuvre: str, store: Path) -> float:
    """NRMSD of the side slip of the 2DoF model with perfect inputs [%]."""
    drive = trajectory(manoeuvre, plant, store)
    speed = np.hypot(drive.u[:, SPEED_X], drive.u[:, SPEED_Y])
    numbers = leung_models.numbers_of(load_vehicle(vehicle_path(plant)))
    errors = leung_models.bicycle_errors(numbers, drive.inputs[:, STEERING], speed, leung_models.truth_of(drive))
    return float(errors["side_slip"][0])


def _printed(table: str, row: str, column: str) -> float:
    if table == "5.3":
        return leung_models.PRINTED_5_3[row][leung_models.COLUMNS_5_3.index(column)]
    columns = [one.title for one in leung.TABLES[table].columns]
    return float(leung.TABLES[table].printed[row][columns.index(column)] or np.nan)


def table(found: Sequence[Outcome]) -> Table:
    """For the terminal."""
    heads = ("table", "row", "figure", "thesis", "ours", "changed")
    made = plain_table("change", *heads, right=heads[3:])
    for one in found:
        figures = ("–" if np.isnan(value) else f"{value:.3g}" for value in (one.printed, one.ours, one.changed))
        made.add_row(one.change, one.table, one.row, one.column, *figures)
    return made
