"""What becomes of the observer in the rows of the systematic table of faults.

Where the recording is generated the error is that against the truth; on a real drive, whose reference has errors
of its own, it is what the fault changes of the estimate.

A row holds if

- the lateral velocity is never off by more than `LATERAL` *and* by more than `SIGMAS` of its standard deviations,
- the headline is never OK for longer than `LONGEST_OK` while it is off by more than these standard deviations,
- the sensor that fails is named, where the fault changes what it reports by more than the part's `noticeable`, and
- no other sensor is taken out for longer than `LONGEST_OUT`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from numpy.typing import NDArray
from rich.table import Table

from studies.fault_rows import GENESIS, PARTS, Phase, Row, Signal, car_of, stretch
from studies.tasks import Task, kept, pool
from vsense_ros.assess.faults import LATERAL, RAV4, SIGMAS, USUAL, Run, observe
from vsense_ros.checks.aligned import stretches
from vsense_ros.errors import InputError
from vsense_ros.evaluate.faults import (
    FIX,
    PLACE,
    STEERING,
)
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording

Array = NDArray[np.float64]
Progress = Callable[[float], None]

LONGEST_OK = 0.5  # [s] of a headline that is OK while the estimate is outside of its standard deviations
LONGEST_OUT = 2.0  # [s] for which a sensor that is right may be out
NAMED_WITHIN = 1.0  # [s] after the end of a fault
WORST = 10  # rows that a summary shows
# Share of the rows [%] for which each requirement is to hold.
REQUIRED: Mapping[str, float] = {
    "lateral_percent": 99.0, "never_ok_outside_percent": 100.0, "named_percent": 95.0,
    "no_right_sensor_out_percent": 100.0,
}  # fmt: skip


@dataclass(frozen=True)
class RowOutcome:
    """What became of a row."""

    row: str
    v_lat: float  # largest error of the lateral velocity from the fault on [m/s]
    sigmas: float  # largest error of it over its standard deviation
    in_sigma: bool  # whether it was always small, or within its standard deviations
    ok_outside: float  # longest time of an OK headline outside of them [s]
    named: bool | None  # None: the fault is not noticeable
    said: str  # of the sensor, or all others that are out
    right_out: float  # longest time for which a sensor that is right was out [s]
    position_sigmas: float  # largest error of the position over its standard deviation

    @property
    def harm(self) -> float:
        """Largest error over what it may be: `LATERAL`, or `SIGMAS` of its standard deviations if that is more."""
        return min(self.v_lat / LATERAL, self.sigmas / SIGMAS)

    @property
    def holds(self) -> bool:
        """True if all that is required of a row holds."""
        return (
            self.in_sigma
            and self.ok_outside <= LONGEST_OK
            and self.named is not False
            and self.right_out <= LONGEST_OUT
        )


def examine(row: Row) -> RowOutcome:
    """Run a row with the vehicle's observer. Raises `InputError` where its recording is not here."""
    recording = stretch(row.phase)
    broken = row.of(recording)
    vehicle = load_vehicle(car_of(row.phase.drive))
    return judge(row, observe(broken, vehicle), _undisturbed(row.phase), noticeable=_noticed(row, recording, broken))


def examine_rows(
    some: Sequence[Row], path: Path, progress: Progress, *, processes: int | None = None
) -> list[RowOutcome]:
    """Run rows, without those whose recordings are not here, and write the outcomes among what the file `path` has of
    other examinations. Each is kept beside the file, so that what was stopped goes on where it was."""
    path.parent.mkdir(parents=True, exist_ok=True)
    tasks = {row.name: Task(4.0, if_here, (row,)) for row in some}
    with pool(processes) as do_tasks:
        found = do_tasks(kept(tasks, path.parent / "fault_rows"), progress)
    outcomes = [one for one in found if isinstance(one, RowOutcome)]
    file = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    with atomic_write(path) as stream:
        json.dump({**file, "faults": as_json(outcomes)}, stream, indent=2)
        stream.write("\n")
    return outcomes


def if_here(row: Row) -> RowOutcome | None:
    """What became of a row; None where its recording is not here."""
    try:
        return examine(row)
    except InputError:
        return None


def judge(row: Row, run: Run, clean: Run, *, noticeable: bool) -> RowOutcome:
    """What became of a row, whose drive without the fault gave `clean`."""
    begin, end = row.span
    part = run.after(begin)
    lateral, position = run.lateral, run.position
    usual = 0.0
    if row.phase.drive in (RAV4, GENESIS):
        # The estimate without the fault in place of the reference, of which both have the same error.
        lateral = lateral - np.interp(run.t, clean.t, clean.lateral)
        position = position - np.column_stack([np.interp(run.t, clean.t, axis) for axis in clean.position.T])
    else:
        settled = clean.after(begin)
        usual = float((np.abs(clean.lateral) / clean.lateral_deviation)[settled].max(initial=0.0))
    t, error, sigma = run.t[part], np.abs(lateral[part]), run.lateral_deviation[part]
    sigmas = error / sigma
    most = max(SIGMAS, USUAL * usual)
    outside = sigmas > most
    ok = _is_ok(run, "observer", t)
    usual_words = {_words(line.message) for _, line in clean.said.get(row.part.line, ())}
    complaints = [
        line.message
        for when, line in run.said.get(row.part.line, ())
        if begin <= when <= end + NAMED_WITHIN
        and line.level is not Level.OK
        and _words(line.message) not in usual_words
    ]
    headline = [line.message for when, line in run.said.get("observer", ()) if begin <= when <= end + NAMED_WITHIN]
    named = bool(complaints) or any(row.part.line in text for text in headline)
    topics = {name: sensor.topic for name, sensor in load_vehicle(car_of(row.phase.drive)).sensing().items()}
    out = {name: _longest_out(run, name, begin) for name, topic in topics.items() if topic != row.part.topic}
    worst = max(out, key=lambda name: out[name], default="")
    said = "; ".join([*complaints[:1], *([f"{worst} out"] if worst and out[worst] > LONGEST_OUT else [])])
    places = np.abs(position[part]) / run.position_deviation[part]
    return RowOutcome(
        row.name,
        v_lat=float(error.max(initial=0.0)),
        sigmas=float(sigmas.max(initial=0.0)),
        in_sigma=not bool((outside & (error > LATERAL)).any()),
        ok_outside=max((float(t[end - 1] - t[first]) for first, end in stretches(outside & ok)), default=0.0),
        named=named if noticeable else None,
        said=said,
        right_out=out.get(worst, 0.0),
        position_sigmas=float(np.nan_to_num(places, nan=0.0).max(initial=0.0)),
    )


@cache
def _undisturbed(phase: Phase) -> Run:
    return observe(stretch(phase), load_vehicle(car_of(phase.drive)))


def _noticed(row: Row, recording: Recording, broken: Recording) -> bool:
    """True if the fault changes what the part reports by more than is noticeable, as a root mean square over its
    time; a value that is gone is."""
    topic = row.part.topic
    original, changed = recording[topic], broken[topic]
    times = (original.stamp - recording.start) * 1e-9
    hit = (times >= row.span[0]) & (times < row.span[1])
    weight = np.ones(len(original))
    if topic == STEERING:
        truth = recording["reference/odometry"]
        weight = np.interp(original.stamp, truth.stamp, truth.columns["linear"][:, 0])
    for signal in row.part.signals:
        change = _values(changed, signal, original) - _values(original, signal, original)
        if not np.isfinite(change[hit]).all() and row.kind == "NaN":
            return True
        if np.sqrt(np.nanmean((weight[:, None] * change)[hit] ** 2)) > signal.times(row.size).noticeable:
            return True
    return False


def _values(channel: Channel, signal: Signal, at: Channel) -> Array:
    """What a signal of a channel (m, k) is at the stamps of another one; places in metres."""
    order = np.argsort(channel.stamp, kind="stable")
    if signal.field == PLACE and channel.topic == FIX:
        places, origin = ([one.columns[name][:, 0] for name in ("latitude", "longitude")] for one in (channel, at))
        there = [float(np.nanmedian(axis)) for axis in origin]
        columns = np.column_stack(pymap3d.geodetic2enu(*places, 0.0, *there, 0.0)[:2])
    else:
        columns = channel.columns[signal.field][:, list(signal.axes)]
    return np.column_stack([np.interp(at.stamp, channel.stamp[order], axis[order]) for axis in columns.T])


def _words(sentence: str) -> str:
    """A sentence without its numbers."""
    return re.sub(r"[\d.]+", "", sentence)


def _is_ok(run: Run, name: str, t: Array | float) -> NDArray[np.bool_]:
    """True at those of the times (n,) [s] at which a line of the diagnostics is OK."""
    changes = run.said.get(name, ())
    when = np.array([-np.inf, *(at for at, _ in changes)])
    ok = np.array([False, *(line.level is Level.OK for _, line in changes)])
    return np.asarray(ok[np.searchsorted(when, t, side="right") - 1])


def _longest_out(run: Run, name: str, begin: float) -> float:
    """Longest time from `begin` [s] on for which a sensor is not believed [s]."""
    longest, since = 0.0, None
    last = float(run.t[-1]) if len(run.t) else 0.0
    for when, line in (*run.said.get(name, ()), (last, None)):
        if since is not None:
            longest = max(longest, min(when, last) - max(since, begin))
        out = line is not None and (line.level is Level.ERROR or "not believed" in line.message)
        since = (when if since is None else since) if out else None
    return longest


def summary(outcomes: Sequence[RowOutcome]) -> dict[str, float]:
    """Shares of the rows [%] for which each requirement holds, and how many there are."""
    noticed = [one for one in outcomes if one.named is not None]

    def percent(of: Sequence[RowOutcome], holds: Callable[[RowOutcome], bool]) -> float:
        return 100.0 * sum(map(holds, of)) / len(of) if of else 100.0

    return {
        "rows": len(outcomes),
        "holds_percent": percent(outcomes, lambda one: one.holds),
        "lateral_percent": percent(outcomes, lambda one: one.in_sigma),
        "never_ok_outside_percent": percent(outcomes, lambda one: one.ok_outside <= LONGEST_OK),
        "named_percent": percent(noticed, lambda one: one.named is True),
        "no_right_sensor_out_percent": percent(outcomes, lambda one: one.right_out <= LONGEST_OUT),
    }


def missed(outcomes: Sequence[RowOutcome]) -> list[str]:
    """What the rows do not reach of what is required of all of them, in words."""
    found = summary(outcomes)
    return [
        f"{name.replace('_', ' ').replace(' percent', '')} {found[name]:.4g} % in place of {least:g}"
        for name, least in REQUIRED.items()
        if found[name] < least
    ]


def as_json(outcomes: Sequence[RowOutcome]) -> dict[str, dict[str, Any]]:
    """The outcomes by row, ready for JSON."""
    return {one.row: {**{k: v for k, v in asdict(one).items() if k != "row"}, "holds": one.holds} for one in outcomes}


def table(outcomes: Sequence[RowOutcome]) -> Table:
    """Table of the worst rows, of what the rows of each part hold, and of the shares of all, for the terminal."""
    lines = plain_table(
        "row", "v_lat [m/s]", "error/σ", "OK outside [s]", "right one out [s]", "named",
        right=("v_lat [m/s]", "error/σ", "OK outside [s]", "right one out [s]"),
    )  # fmt: skip
    worst = sorted(outcomes, key=lambda one: (one.holds, -one.harm))[:WORST]
    for one in worst:
        named = {None: "–", True: "yes", False: "no"}[one.named]
        figures = (f"{one.v_lat:.2f}", f"{one.sigmas:.1f}", f"{one.ok_outside:.1f}", f"{one.right_out:.1f}")
        lines.add_row(one.row, *figures, named)
    lines.add_section()
    for part in PARTS:
        of_part = [one for one in outcomes if one.row.startswith(f"{part.name} ")]
        if of_part:
            lines.add_row(f"{part.name}: {sum(one.holds for one in of_part)} of {len(of_part)} rows hold")
    lines.add_section()
    for name, value in summary(outcomes).items():
        lines.add_row(name.replace("_", " ").replace("percent", "[%]"), f"{value:.4g}")
    return lines
