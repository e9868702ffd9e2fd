"""What a fleet came to: a table for other programs (Parquet), one for people (CSV, page, terminal)."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.evaluate.report import page_environment
from vsense_ros.files.atomic import atomic_write, in_place_of
from vsense_ros.mismatch.fleet import FAILED, TABLE
from vsense_ros.mismatch.page import PAGE as REPORT
from vsense_ros.mismatch.page import VERDICTS, Verdict, percent, place_in_words, place_of, sizes_in_words

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
_VERDICTS = {**VERDICTS, FAILED: Verdict("Failed", "", "open")}


def in_answer(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Effects that are named, or that cannot be told apart."""
    if found["verdict"] not in ("named", "ambiguous"):
        return []
    answer = set(found["answer_set"]) if found["verdict"] == "ambiguous" else set()
    return [e for e in found["effects"] if e.get("accepted") or {e["id"], f"{e['id']} {place_of(e)}"} & answer]


def rows(results: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """As `SCHEMA`: of each vehicle one row with its verdict, and of each of its recordings one for each effect in the
    answer, or one without an effect."""
    table = []
    for result in results:
        found = result["found"]
        of_vehicle = {
            "vehicle": result["vehicle"],
            "verdict": found["verdict"],
            "reason": found["sentence"],
            "misfit": found.get("misfit"),
            "cpu_s": found.get("cpu_s"),
        }
        table.append(of_vehicle)
        effects = [_columns(effect) for effect in in_answer(found)]
        shares: Counter[str] = Counter()
        for segment in found.get("located", {}).get("segments", ()):
            shares[segment["recording"]] += segment["share"]
        for recording in result["recordings"]:
            name, reason = recording["name"], recording["reason"]
            row = {
                "vehicle": result["vehicle"],
                "recording": name,
                "role": recording["role"],
                "verdict": found["verdict"],
                "reason": reason or None,
                "error_share": shares.get(name),
            }
            table += [row | effect for effect in effects] if effects and not reason else [row]
    return [{name: row.get(name) for name in SCHEMA.names} for row in table]


def _columns(effect: Mapping[str, Any]) -> dict[str, Any]:
    parameters = [
        {key: entry[key] for key in ("name", "unit", "value")}
        | dict(zip(("low", "high"), entry["interval_90"], strict=True))
        for entry in effect["parameters"]
    ]
    figures = {key: effect[key] for key in ("gain_training", "gain_left_out", "gain_held_out", "keep", "confidence")}
    return {"effect": effect["id"], "place": place_of(effect) or None, "parameters": parameters, **figures}


def write(results: Sequence[Mapping[str, Any]], out: Path) -> None:
    """`fleet.parquet`, `fleet.csv` and `fleet.html` into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    with in_place_of(out / TABLE) as fresh:
        pq.write_table(pa.Table.from_pylist(rows(results), schema=SCHEMA), fresh)
    lines = [_line(result) for result in results]
    with atomic_write(out / SHEET) as file:
        sheet = csv.DictWriter(file, ("vehicle", "verdict", "effects", "proven", "recordings", "unused", "reason"))
        sheet.writeheader()
        sheet.writerows({**line, "effects": "; ".join(line["effects"])} for line in lines)
    effects = _frequency(results)
    page = page_environment("vsense_ros.mismatch").get_template("fleet.html.j2")
    text = page.render(
        headline=_headline(results),
        effects=effects,
        lines=[
            line
            | {
                "badge": _VERDICTS[result["found"]["verdict"]],
                "marks": [_mark(result["found"], id) for id in effects],
                "report": _report(result, out),
                "left": [r for r in result["recordings"] if r["reason"]],
            }
            for line, result in zip(lines, results, strict=True)
        ],
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )  # fmt: skip
    with atomic_write(out / PAGE) as file:
        file.write(text)


def _report(result: Mapping[str, Any], out: Path) -> str:
    """Where the report of a vehicle is, below `out`; empty where it has none: what was not explained has no key, and a
    report in its folder is of an earlier run."""
    place = f"{result['vehicle']}/{REPORT}"
    return place if result["key"] and (out / place).is_file() else ""


def printed(results: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print one line for each vehicle, and how often each effect was found."""
    console.print()
    console.print(Text(_headline(results), style="bold"))
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for name in ("vehicle", "verdict", "what its model leaves out", "proven", "recordings"):
        table.add_column(name, justify="right" if name in ("proven", "recordings") else "left", overflow="fold")
    for line in map(_line, results):
        used = f"{line['recordings'] - line['unused']} of {line['recordings']}" if line["unused"] else "all"
        said = "\n".join(line["effects"]) or (line["reason"] if line["verdict"] in (FAILED, "not_assessable") else "–")
        cells = (line["vehicle"], line["verdict"].replace("_", " "), said, line["proven"], used)
        table.add_row(*(Text(cell) for cell in cells))
    console.print(table)
    for id, names in _frequency(results).items():
        console.print(
            f"{id}: {len(names)} of {len(results)} vehicles ({', '.join(names)})", soft_wrap=True, markup=False
        )
    for result in results:
        for recording in result["recordings"]:
            if recording["reason"]:
                text = f"Not used: {result['vehicle']}/{recording['name']}: {recording['reason']}"
                console.print(Text(text, style="yellow"), soft_wrap=True)


def _line(result: Mapping[str, Any]) -> dict[str, Any]:
    """One vehicle as people read it."""
    found = result["found"]
    effects = in_answer(found)
    proof = [e["gain_left_out"] if e["gain_held_out"] is None else e["gain_held_out"] for e in effects]
    return {
        "vehicle": result["vehicle"],
        "verdict": found["verdict"],
        "effects": [_shown(effect) for effect in effects],
        "proven": percent(max(proof, default=None)),
        "recordings": len(result["recordings"]),
        "unused": sum(bool(recording["reason"]) for recording in result["recordings"]),
        "reason": found["sentence"],
    }


def _shown(effect: Mapping[str, Any]) -> str:
    """An effect with its place, its form and its size."""
    return " ".join(filter(None, (effect["id"], place_in_words(effect), f"({sizes_in_words(effect)})")))


def _headline(results: Sequence[Mapping[str, Any]]) -> str:
    verdicts = Counter(result["found"]["verdict"] for result in results)
    said = ", ".join(f"{n} {verdict.replace('_', ' ')}" for verdict in _VERDICTS if (n := verdicts[verdict]))
    return f"{len(results)} vehicle{'' if len(results) == 1 else 's'}: {said}"


def _frequency(results: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Vehicles in whose answer an effect is, by effect, the most frequent first."""
    found: dict[str, list[str]] = {}
    for result in results:
        for effect in in_answer(result["found"]):
            found.setdefault(effect["id"], []).append(result["vehicle"])
    return dict(sorted(found.items(), key=lambda item: (-len(item[1]), item[0])))


def _mark(found: Mapping[str, Any], id: str) -> str:
    """How an effect stands with a vehicle: named, possible, or nothing."""
    if id not in {effect["id"] for effect in in_answer(found)}:
        return ""
    return str(found["verdict"])
