"""The results of a fleet: a table for other programs (Parquet) and one for people (CSV, page, terminal)."""

from __future__ import annotations

import csv
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.evaluate.html_page import write_page
from vsense_ros.files.atomic import atomic_write, in_place_of
from vsense_ros.files.names import cell
from vsense_ros.fleet.fleet import FAILED, TABLE, Result
from vsense_ros.mismatch.answer_schema import EffectEntry
from vsense_ros.mismatch.page import PAGE as REPORT
from vsense_ros.mismatch.words import BADGES, Badge, percent, place_in_words, sizes_in_words

SHEET, PAGE = "fleet.csv", "fleet.html"

_NUMBER, _TEXT = pa.float64(), pa.string()
SCHEMA = pa.schema(
    [
        pa.field("vehicle", _TEXT, nullable=False),
        pa.field("recording", _TEXT),  # none: what is said of all recordings of the vehicle together
        pa.field("role", _TEXT),  # training, held_out
        pa.field("verdict", _TEXT, nullable=False),
        pa.field("reason", _TEXT),  # the verdict in words; why a recording was not used
        pa.field("effect", _TEXT),
        pa.field("place", _TEXT),  # wheel, axle, sensor or axis, and form
        pa.field(
            "parameters",
            pa.list_(
                pa.struct([("name", _TEXT), ("unit", _TEXT), ("value", _NUMBER), ("low", _NUMBER), ("high", _NUMBER)])
            ),
        ),
        pa.field("gain_training", _NUMBER),  # relative fall of the squared error
        pa.field("gain_left_out", _NUMBER),
        pa.field("gain_held_out", _NUMBER),
        pa.field("keep", _NUMBER),
        pa.field("confidence", _NUMBER),
        pa.field("error_share", _NUMBER),  # of the squared error before, that lies in this recording
        pa.field("misfit", _NUMBER),  # residuals before, root mean square in multiples of what a good model leaves
        pa.field("cpu_s", _NUMBER),
    ]
)  # fmt: skip
_BADGES = {**BADGES, FAILED: Badge("Failed", "", "open")}


@dataclass(frozen=True)
class _Line:
    """One vehicle as people read it."""

    vehicle: str
    verdict: str
    effects: list[str]
    proven: str  # largest share of the squared error that an effect explains, where it was not fitted
    recordings: int
    unused: int
    reason: str


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """As `SCHEMA`: of each vehicle one row with its verdict, and of each of its recordings one for each effect in the
    answer, or one without an effect."""
    table: list[dict[str, Any]] = []
    for result in results:
        answer = result.answer
        table.append(
            {
                "vehicle": result.vehicle,
                "verdict": result.outcome.verdict,
                "reason": result.outcome.sentence,
                "misfit": answer.misfit if answer else None,
                "cpu_s": answer.cpu_s if answer else None,
            }
        )
        effects = [_columns(effect) for effect in result.in_answer]
        shares: defaultdict[str, float] = defaultdict(float)
        for segment in answer.located.segments if answer else ():
            shares[segment.recording] += segment.share
        for recording in result.recordings:
            row = {
                "vehicle": result.vehicle,
                "recording": recording.name,
                "role": recording.role,
                "verdict": result.outcome.verdict,
                "reason": recording.reason or None,
                "error_share": shares.get(recording.name),
            }
            table += [row | effect for effect in effects] if effects and not recording.reason else [row]
    return [{name: row.get(name) for name in SCHEMA.names} for row in table]


def _columns(effect: EffectEntry) -> dict[str, Any]:
    parameters = [
        {"name": size.name, "unit": size.unit, "value": size.value}
        | dict(zip(("low", "high"), size.interval_90, strict=True))
        for size in effect.parameters
    ]
    return {
        "effect": effect.id,
        "place": effect.place or None,
        "parameters": parameters,
        "gain_training": effect.gain_training,
        "gain_left_out": effect.gain_left_out,
        "gain_held_out": effect.gain_held_out,
        "keep": effect.keep,
        "confidence": effect.confidence,
    }


def write(results: Sequence[Result], out: Path) -> None:
    """`fleet.parquet`, `fleet.csv` and `fleet.html` into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    with in_place_of(out / TABLE) as fresh:
        pq.write_table(pa.Table.from_pylist(rows(results), schema=SCHEMA), fresh)
    lines = [_line(result) for result in results]
    with atomic_write(out / SHEET) as file:
        sheet = csv.DictWriter(file, [field.name for field in fields(_Line)])
        sheet.writeheader()
        for line in lines:
            texts = {
                "vehicle": cell(line.vehicle),
                "effects": cell("; ".join(line.effects)),
                "reason": cell(line.reason),
            }
            sheet.writerow(asdict(line) | texts)
    effects = _frequency(results)
    write_page(
        out / PAGE,
        "vsense_ros.fleet",
        "fleet.html.j2",
        headline=_headline(results),
        effects=effects,
        vehicles=[
            {
                "line": line,
                "badge": _BADGES[result.outcome.verdict],
                "marks": [_mark(result, id) for id in effects],
                "report": _report(result, out),
                "left": [recording for recording in result.recordings if recording.reason],
            }
            for line, result in zip(lines, results, strict=True)
        ],
    )


def _report(result: Result, out: Path) -> str:
    """Where the report of a vehicle is, below `out`; empty where it has none: what was not explained has no key, and a
    report in its folder is of an earlier run."""
    place = f"{result.vehicle}/{REPORT}"
    return place if result.key and (out / place).is_file() else ""


def printed(results: Sequence[Result], console: Console) -> None:
    """Print one line for each vehicle, and how often each effect was found."""
    console.print()
    console.print(Text(_headline(results), style="bold"))
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for name in ("vehicle", "verdict", "what its model leaves out", "proven", "recordings"):
        table.add_column(name, justify="right" if name in ("proven", "recordings") else "left", overflow="fold")
    for line in map(_line, results):
        used = f"{line.recordings - line.unused} of {line.recordings}" if line.unused else "all"
        said = "\n".join(line.effects) or (line.reason if line.verdict in (FAILED, "not_assessable") else "–")
        cells = (line.vehicle, line.verdict.replace("_", " "), said, line.proven, used)
        table.add_row(*(Text(cell) for cell in cells))
    console.print(table)
    for id, names in _frequency(results).items():
        console.print(
            f"{id}: {len(names)} of {len(results)} vehicles ({', '.join(names)})", soft_wrap=True, markup=False
        )
    for result in results:
        for recording in result.recordings:
            if recording.reason:
                text = f"Not used: {result.vehicle}/{recording.name}: {recording.reason}"
                console.print(Text(text, style="yellow"), soft_wrap=True)


def _line(result: Result) -> _Line:
    effects = result.in_answer
    proof = [e.gain_left_out if e.gain_held_out is None else e.gain_held_out for e in effects]
    return _Line(
        vehicle=result.vehicle,
        verdict=result.outcome.verdict,
        effects=[_shown(effect) for effect in effects],
        proven=percent(max(proof, default=None)),
        recordings=len(result.recordings),
        unused=sum(bool(recording.reason) for recording in result.recordings),
        reason=result.outcome.sentence,
    )


def _shown(effect: EffectEntry) -> str:
    """An effect with its place, its form and its size."""
    return " ".join(filter(None, (effect.id, place_in_words(effect), f"({sizes_in_words(effect)})")))


def _headline(results: Sequence[Result]) -> str:
    verdicts = Counter[str](result.outcome.verdict for result in results)
    said = ", ".join(f"{n} {verdict.replace('_', ' ')}" for verdict in _BADGES if (n := verdicts[verdict]))
    return f"{len(results)} vehicle{'' if len(results) == 1 else 's'}: {said}"


def _frequency(results: Sequence[Result]) -> dict[str, list[str]]:
    """Vehicles in whose answer an effect is, by effect, the most frequent first."""
    vehicles_of: dict[str, list[str]] = {}
    for result in results:
        for effect in result.in_answer:
            vehicles_of.setdefault(effect.id, []).append(result.vehicle)
    return dict(sorted(vehicles_of.items(), key=lambda item: (-len(item[1]), item[0])))


def _mark(result: Result, id: str) -> str:
    """The verdict on an effect for a vehicle if its answer names it, else empty."""
    return result.outcome.verdict if id in {effect.id for effect in result.in_answer} else ""
