"""What was found where model and recordings differ, as a page that opens without a network, and in a terminal."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import floor, inf, isfinite, log10
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.evaluate.report import page_environment
from vsense_ros.mismatch.picture import (
    SIGNAL_UNITS,
    UNITS,
    Trace,
    before_and_after,
    heading,
    label,
    most_affected,
    other_signals,
    road_profile,
    when,
)
from vsense_ros.model.effects.base import CORNERS

PLACES = ("wheel", "axle", "sensor", "axis")
MOST_PARAMETERS = 6  # of an effect that are listed; a profile of a road has dozens
PRINTED_SIGNALS = 6


class Verdict(NamedTuple):
    badge: str
    title: str  # of the page in a browser's tab
    tone: str  # how the page colours the badge


VERDICTS: Mapping[str, Verdict] = {
    "named": Verdict("Named", "What the model leaves out", "found"),
    "ambiguous": Verdict("Cannot be told apart", "What the model may leave out", "open"),
    "unknown": Verdict("Unknown physics", "Something the model leaves out", "open"),
    "no_mismatch": Verdict("Nothing to find", "Model and recordings agree", "calm"),
    "not_assessable": Verdict("Not assessable", "Nothing can be said", "calm"),
}


@dataclass(frozen=True)
class Error:
    """Root mean square of what a signal differs by, before and after, in its SI unit."""

    before: float
    after: float
    unit: str

    @classmethod
    def of(cls, entry: Mapping[str, float], unit: str) -> Error:
        return cls(entry["before"], entry["after"], unit)

    @property
    def changed(self) -> bool:
        return self.after != self.before

    @property
    def change(self) -> str:
        if not self.changed or self.before <= 0.0:
            return "–"
        return percent(self.after / self.before - 1.0, signed=True)

    @property
    def cells(self) -> tuple[str, str, str]:
        """Before, after and change as people read them."""
        unit, factor = SIGNAL_UNITS.get(self.unit, (self.unit, 1.0))
        before, after = (f"{shown_number(error * factor)}{_behind(unit)}" for error in (self.before, self.after))
        return before, after if self.changed else "–", self.change


@dataclass(frozen=True)
class SignalRow:
    """The errors of one signal, and bars of the strictest of them: lengths between 0 and 1, with their colour."""

    label: str
    null: str  # what a good model leaves
    training: Error
    held_out: Error | None  # on recordings that no fit has seen
    bars: list[tuple[float, str]]
    mark: float | None  # the length of what a good model leaves

    @property
    def errors(self) -> list[Error]:
        return [self.training, *([self.held_out] if self.held_out else [])]


@dataclass(frozen=True)
class Bar:
    """A share of the squared error: its `figure`, and the `length` of its bar between 0 and 1."""

    name: str
    figure: str
    length: float


@dataclass(frozen=True)
class Candidate:
    """An effect as the page shows it."""

    name: str
    sentence: str
    parameters: list[tuple[str, str]]
    more: int  # parameters that are not listed
    bars: list[Bar]
    mark: float  # the length that chance reaches
    keep: str
    confidence: str
    answer: bool
    standing: str


def write_report(found: Mapping[str, Any], traces: Sequence[Trace], path: Path) -> None:
    """Write the page about `found`, the content of explain.json, with the curves of `traces`, to `path`."""
    located = found["located"]
    signals = [signal["name"] for signal in located["signals"]]
    shown = most_affected(traces, signals)
    verdict = VERDICTS[found["verdict"]]
    environment = page_environment("vsense_ros.mismatch")
    page = environment.get_template("explain.html.j2").render(
        found=found,
        verdict=verdict,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        headlines=_headlines(found, shown),
        shown=shown,
        caption=_caption(shown) if shown else "",
        picture=_embedded(before_and_after(shown)) if shown else "",
        beside=_embedded(other_signals(traces, shown, signals)) if shown else "",
        timeline=_embedded(when(located["segments"], traces)),
        region=_described(located["region"]),
        force=_described(located["force"]),
        candidates=_candidates(found),
        profiles=[
            (effect["sentence"], _embedded(road_profile(effect)))
            for effect in found["effects"]
            if "profile" in effect and effect["id"] in found["answer_set"]
        ],
        threshold=percent(found["threshold"]),
        signals=_signal_rows(found),
        proven=_proven(found),
        changed=_changed(found),
        base=[(name, shown_value(entry["value"], entry["unit"], change=True)) for name, entry in found["base"].items()],
        next_test=_next_test(found),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def printed(found: Mapping[str, Any], console: Console) -> None:
    """Print what was found."""
    console.print()
    console.print(Text(f"{found['vehicle']}: {VERDICTS[found['verdict']].badge}", style="bold"))
    console.print(Text(found["sentence"]))
    if test := _next_test(found):
        console.print(Text(f"Next test: {test}.", style="bold"))
    if candidates := _candidates(found):
        table = _table("squared error explained by", *(f">{bar.name}" for bar in candidates[0].bars), "")
        for one in candidates:
            _add(table, one.name, *(bar.figure for bar in one.bars), one.standing)
        console.print(table)
    for one in candidates:
        if one.answer:
            console.print(Text(f"{one.name}: {', '.join(f'{name} {value}' for name, value in one.parameters)}"))
    if rows := _signal_rows(found):
        headings = (">before", ">after", ">change") if _changed(found) else (">error",)
        proof = tuple(f"{words}, held out" for words in headings) if _proven(found) else ()
        table = _table("error", *headings, *proof)
        for row in rows[:PRINTED_SIGNALS]:
            cells = [cell for error in row.errors for cell in error.cells[: len(headings)]]
            _add(table, row.label, *cells)
        console.print(table)
        if len(rows) > PRINTED_SIGNALS:
            console.print(Text(f"The report shows {len(rows)} signals.", style="dim"))
    for remark in found["remarks"]:
        console.print(Text(f"Note: {remark}", style="yellow"))
    for reason in dict.fromkeys(one["reason"] for one in found["out_of_reach"]):
        ids = ", ".join(one["id"] for one in found["out_of_reach"] if one["reason"] == reason)
        console.print(Text(f"Nothing can be said of {ids}: {reason}", style="yellow"))
    console.print(Text(f"{found['cpu_s']:.0f} s of computing for {found['driven_s']:.0f} s of driving", style="dim"))


def shown_number(value: float, *, signed: bool = False) -> str:
    """Three digits that count, without an exponent unless there is no other way."""
    if not isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    decimals = 2 - floor(log10(abs(value)))
    if not -4 <= decimals <= 8:
        return f"{value:{'+' if signed else ''}.2e}".replace("-", "−")
    return f"{round(value, decimals):{'+' if signed else ''}.{max(decimals, 0)}f}".replace("-", "−")


def shown_value(value: float, unit: str, *, change: bool = False) -> str:
    """A quantity in the unit people read it in; with `change` signed, and in percent where it has no unit."""
    if change and unit == "-":
        return percent(value, signed=True)
    unit, factor = UNITS.get(unit, (unit, 1.0))
    return f"{shown_number(value * factor, signed=change)}{_behind(unit)}"


def percent(share: float | None, *, signed: bool = False) -> str:
    """A share of 1 in percent; "–" where there is none."""
    if share is None or not isfinite(share):
        return "–"
    decimals = 0 if abs(share) >= 0.0995 else 1
    return f"{100 * share:{'+' if signed else ''}.{decimals}f} %".replace("-", "−")


def _behind(unit: str) -> str:
    return unit if unit.startswith("°") or not unit else f" {unit}"


def _proven(found: Mapping[str, Any]) -> bool:
    """True where the errors on recordings that no fit has seen are known."""
    return any(errors.get("held_out") for errors in found["fit"].values())


def _changed(found: Mapping[str, Any]) -> bool:
    """True where something was added to the model, so that there is an error after beside the one before."""
    return any(row.training.changed for row in _signal_rows(found))


def _headlines(found: Mapping[str, Any], shown: Trace | None) -> list[tuple[str, str]]:
    """The figures below the sentence, each with what it is."""
    result = []
    where = "held-out recordings, which no fit has seen" if _proven(found) else "the recordings it was fitted to"
    errors = found["fit"].get(shown.signal, {}) if shown else {}
    if shown and (entry := errors.get("held_out") or errors.get("training")):
        error = Error.of(entry, shown.unit)
        of = f"error of the {label(shown.signal)}, on {where}"
        if error.changed:
            result.append((error.change, f"{of}: from {error.cells[0]} to {error.cells[1]}"))
        else:
            result.append((error.cells[0], of))
    named = found["verdict"] == "named"
    answer = [one for one in _candidates(found) if one.answer]
    if answer and (named or found["verdict"] == "ambiguous"):
        proof = answer[0].bars[-1]
        result.append((proof.figure, f"of the squared error of all signals explained, {proof.name}"))
    if named:
        for one in answer:
            name, value = one.parameters[0] if one.parameters else ("", "–")
            size, _, interval = value.partition(" (")
            result.append(
                (size, f"{one.name}: {name}" + (f", 90 % interval {interval.rstrip(')')}" if interval else ""))
            )
        result.append((answer[0].confidence, "confidence in the name"))
    if rest := _remainder(found):
        times, signal = rest
        remains = "what remains of the largest error" if _changed(found) else "the largest error"
        result.append((f"{times:.1f} ×", f"what a good model leaves: {remains}, of the {label(signal)}"))
    return result


def _remainder(found: Mapping[str, Any]) -> tuple[float, str] | None:
    """The largest error of the model as it was found, in multiples of what a good model leaves, and its signal."""
    ratios = []
    for signal in found["located"]["signals"]:
        errors = found["fit"].get(signal["name"], {})
        if signal["null"] > 0 and (entry := errors.get("held_out") or errors.get("training")):
            ratios.append((entry["after"] / signal["null"], signal["name"]))
    return max(ratios, default=None)


def _caption(shown: Trace) -> str:
    unit, factor = shown.shown
    before, after = (f"{shown_number(error * factor)}{_behind(unit)}" for error in shown.errors)
    seen = "held out: no fit has seen it" if shown.held_out else "part of the fit"
    change = f"root mean square of the error {before} before, {after} after" if shown.changed else f"error {before}"
    return (
        f"{heading(shown.signal)}, the most affected signal, in the window where it is "
        f"worst: {shown.recording}, {shown.t[0]:.0f} to {shown.t[-1]:.0f} s ({seen}); {change}."
    )


def _candidates(found: Mapping[str, Any]) -> list[Candidate]:
    """All effects that were fitted, ranked, with what speaks for and against them."""
    effects = found["effects"]
    accepted = [effect for effect in effects if effect.get("accepted")] or effects[:1]
    gains = [_gains(effect, held_out=bool(found["held_out"])) for effect in effects]
    widest = max(found["threshold"], 1e-12, *(gain for one in gains for gain in one.values()))
    best = min(gains[0].values()) if gains else 0.0
    result = []
    for effect, gain in zip(effects, gains, strict=True):
        place = next((str(effect[key]) for key in PLACES if effect.get(key)), "")
        answer = found["verdict"] == "named" and any(effect is one for one in accepted)
        within = {effect["id"], f"{effect['id']} {place}"} & set(found["answer_set"])
        rival = found["verdict"] == "ambiguous" and bool(within)
        parameters = [(entry["name"].replace("_", " "), _with_interval(entry)) for entry in effect["parameters"]]
        if "profile" in effect:
            parameters.append(("along the road", _along_road(effect)))
        result.append(
            Candidate(
                name=", ".join(filter(None, (heading(effect["id"]), CORNERS.get(place, place)))),
                sentence=effect["sentence"],
                parameters=parameters[:MOST_PARAMETERS],
                more=max(0, len(parameters) - MOST_PARAMETERS),
                bars=[Bar(name, percent(share), max(share, 0.0) / widest) for name, share in gain.items()],
                mark=found["threshold"] / widest,
                keep=percent(effect["keep"]),
                confidence="> 99 %" if effect["confidence"] > 0.99 else percent(effect["confidence"]),
                answer=answer or rival,
                standing="the answer" if answer else _standing(effect, gain, best, found, within=bool(within)),
            )
        )
    return result


def _gains(effect: Mapping[str, Any], *, held_out: bool) -> dict[str, float]:
    """Relative fall of the squared error by where it was seen, the strictest proof last; minus infinity where the
    simulation broke down."""
    keys = {"fitted": "gain_training", "left out in turn": "gain_left_out"} | (
        {"held out": "gain_held_out"} if held_out else {}
    )
    return {name: -inf if effect[key] is None else effect[key] for name, key in keys.items()}


def _standing(
    effect: Mapping[str, Any], gains: Mapping[str, float], best: float, found: Mapping[str, Any], *, within: bool
) -> str:
    """Why an effect is not the answer, or not the only one."""
    decisive, threshold = min(gains.values()), found["threshold"]
    weakest = min(gains, key=lambda name: gains[name])
    if decisive < threshold or best <= 0.0:
        words = "chance" if decisive > 0.0 else "nothing"
        if gains["fitted"] > threshold:
            return f"excluded: explains where it was fitted, but no more than {words} {weakest}"
        return f"excluded: explains no more than {words}"
    relative = f"{percent(decisive / best)} of what the best explains"
    if within:
        return "cannot be excluded" + ("" if decisive == best else f": {relative}")
    if found["verdict"] not in ("named", "ambiguous"):
        return f"not enough: {relative}"
    adds = effect["adds_to_best"]
    return f"explains less: {relative}" + ("" if adds is None else f", and {percent(adds)} besides it")


def _with_interval(entry: Mapping[str, Any]) -> str:
    low, high = entry["interval_90"]
    _, factor = UNITS.get(entry["unit"], (entry["unit"], 1.0))
    return (
        f"{shown_value(entry['value'], entry['unit'])} ({shown_number(low * factor)} to {shown_number(high * factor)})"
    )


def _along_road(effect: Mapping[str, Any]) -> str:
    """Between which values a size varies along the road."""
    everywhere, unit = effect["parameters"][0]["value"], effect["parameters"][0]["unit"]
    values = [everywhere + place["value"] for place in effect["profile"]]
    return f"{shown_value(min(values), unit)} to {shown_value(max(values), unit)}, at {len(values)} places"


def _signal_rows(found: Mapping[str, Any]) -> list[SignalRow]:
    """Errors of all signals, the most affected first."""
    null = {signal["name"]: signal["null"] for signal in found["located"]["signals"]}
    fits = {name: found["fit"][name] for name in [*null, *found["fit"]] if name in found["fit"]}
    errors = {
        name: {where: Error.of(fit[where], fit["unit"]) for where in ("training", "held_out") if fit.get(where)}
        for name, fit in fits.items()
    }
    strictest = {name: found.get("held_out", found["training"]) for name, found in errors.items()}
    scale = {name: null.get(name) or max(error.before, error.after, 1e-12) for name, error in strictest.items()}
    longest = max((max(e.before, e.after) / scale[name] for name, e in strictest.items()), default=1.0)
    longest = max(longest, 1.0)
    rows = []
    for name, error in strictest.items():
        shown = [(error.before, "before"), *([(error.after, "after")] if error.changed else [])]
        level = Error(scale[name], scale[name], error.unit).cells[0]
        rows.append(
            SignalRow(
                label=label(name),
                null=level if name in null else "–",
                training=errors[name]["training"],
                held_out=errors[name].get("held_out"),
                bars=[(value / scale[name] / longest, kind) for value, kind in shown],
                mark=1.0 / longest if name in null else None,
            )
        )
    return rows


def _next_test(found: Mapping[str, Any]) -> str:
    """The manoeuvre that would tell the remaining answers apart, in words."""
    separating = found["would_separate"]
    return f"{separating['manoeuvre']}; watch the {label(separating['signal'])}" if separating else ""


def _described(where: Mapping[str, Any] | None) -> str:
    """What was located, in words."""
    if not where:
        return ""
    sizes = ", ".join(shown_value(size["value"], size["unit"]) for size in where.get("sizes", []))
    return f"{where['description']} ({sizes})" if sizes else str(where["description"])


def _embedded(picture: bytes | None) -> str:
    return "" if picture is None else base64.b64encode(picture).decode("ascii")


def _table(*headings: str) -> Table:
    """A table with these headings; those that begin with > stand above figures."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1))
    for words in headings:
        table.add_column(words.removeprefix(">"), justify="right" if words.startswith(">") else "left")
    return table


def _add(table: Table, *cells: str) -> None:
    table.add_row(*(Text(cell) for cell in cells))
