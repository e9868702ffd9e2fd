"""What was found where model and recordings differ, as a page that opens without a network, and in a terminal."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import floor, inf, isfinite, log10
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.evaluate.report import page_environment
from vsense_ros.files.atomic import atomic_write
from vsense_ros.mismatch.candidates import UNKNOWN_TORQUES
from vsense_ros.mismatch.picture import (
    SIGNAL_UNITS,
    UNITS,
    Trace,
    before_and_after,
    heading,
    is_share,
    label,
    most_affected,
    other_signals,
    road_profile,
    size_unit,
    when,
)
from vsense_ros.model.effects import BY_ID
from vsense_ros.model.effects.base import CORNERS

PLACES = ("wheel", "axle", "sensor", "axis", "form")
MOST_PARAMETERS = 6  # of an effect that are listed; a profile of a road has dozens
PRINTED_SIGNALS = 6
TOGETHER = {2: "both", 3: "all three"}
# Amounts at which there is nothing of what no vehicle file has, and which is told as it is therefore.
NOTHING = {parameter.name: parameter.low for parameter in UNKNOWN_TORQUES}
PAGE = "report.html"
NEXT_TEST = re.compile(r'<p id="next-test">.*?</p>', re.DOTALL)  # the paragraph of a page


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


ASSUMED = Verdict("Assumed", "What was assumed to be left out", "open")


def _verdict(found: Mapping[str, Any]) -> Verdict:
    named = found["verdict"] == "named"
    return ASSUMED if named and found.get("assumed") else VERDICTS[found["verdict"]]  # earlier answers do not tell it


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
class Size:
    """How large an effect is, as people read it; `known`: its 90 % interval, or where it is."""

    name: str
    value: str
    known: str
    figure: str = ""  # the value in short, where it is a range

    @property
    def words(self) -> str:
        return f"{self.name} {self.value}".strip()

    def __str__(self) -> str:
        return f"{self.words} ({self.known})"


@dataclass(frozen=True)
class Candidate:
    """An effect as the page shows it."""

    name: str
    sentence: str
    parameters: list[Size]
    more: int  # parameters that are not listed
    bars: list[Bar]
    mark: float  # the length that chance reaches
    together: str  # with which other effects it was fitted, to which its gains belong as well
    keep: str
    confidence: str
    answer: bool
    standing: str


def write_report(found: Mapping[str, Any], traces: Sequence[Trace], path: Path) -> None:
    """Write the page about `found`, the content of explain.json, with the curves of `traces`, to `path`."""
    located = found["located"]
    signals = [signal["name"] for signal in located["signals"]]
    shown = most_affected(traces, signals)
    verdict = _verdict(found)
    candidates = _candidates(found)
    page = (
        _templates()
        .get_template("explain.html.j2")
        .render(
            found=found,
            verdict=verdict,
            written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            headlines=_headlines(found, shown),
            shown=shown,
            caption=_caption(found, shown) if shown else "",
            picture=_embedded(before_and_after(shown)) if shown else "",
            beside=_embedded(other_signals(traces, shown, signals)) if shown else "",
            timeline=_embedded(when(located["segments"], traces)),
            region=_described(located["region"]),
            force=_described(located["force"]),
            candidates=candidates,
            first=_first(found),
            out_of_reach=[(heading(one["id"]), one["reason"]) for one in found["out_of_reach"]],
            profiles=[
                (_sentence(effect), _embedded(road_profile(effect)), "latitude" in effect["profile"][0])
                for effect in found["effects"]
                if "profile" in effect and effect["id"] in found["answer_set"]
            ],
            threshold=percent(found["threshold"]),
            signals=_signal_rows(found),
            proven=_proven(found),
            changed=_changed(found),
            acting=_acting(found),
            together=any(one.together for one in candidates),
            base=_base_rows(found),
            used=_used(found),
            unused=_unused(found),
            next_test=_next_test(found),
        )
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(page)


def write_next_test(found: Mapping[str, Any], path: Path) -> None:
    """Say the next test of `found` on the page at `path`, which else stays as it is; nothing where there is no page.

    The curves of the page are not stored, so that it cannot be written anew.
    """
    if path.is_file():
        words = _templates().get_template("next_test.html.j2").render(found=found, next_test=_next_test(found)).strip()
        page = path.read_text(encoding="utf-8")
        with atomic_write(path) as file:
            file.write(NEXT_TEST.sub(lambda _: words, page, count=1))


def printed(found: Mapping[str, Any], console: Console) -> None:
    """Print what was found."""
    console.print()
    console.print(Text(f"{found['vehicle']}: {_verdict(found).badge}", style="bold"))
    console.print(Text(found["sentence"]))
    if test := _next_test(found):
        console.print(Text(f"Next test: {test}.", style="bold"))
    if candidates := _candidates(found):
        table = _table("squared error explained by", *(f">{bar.name}" for bar in candidates[0].bars), "")
        for one in candidates:
            standing = "; ".join(filter(None, (one.standing, one.together)))
            _add(table, one.name, *(bar.figure for bar in one.bars), standing)
        console.print(table)
    for one in candidates:
        if one.answer:
            console.print(Text(f"{one.name}: {', '.join(map(str, one.parameters))}"))
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


def in_words(effect: Mapping[str, Any]) -> str:
    """An effect of explain.json, as the end of "the model leaves out …": what it is, where, and how large."""
    return f"{_sentence(effect)} ({sizes_in_words(effect)})"


def sizes_in_words(effect: Mapping[str, Any]) -> str:
    """How large an effect is; the range where that changes along the road."""
    sizes = [_size(entry) for entry in effect["parameters"]]
    if "profile" in effect:
        sizes[:1] = [_along_road(effect)]
    return ", ".join(size.words for size in sizes)


def place_of(effect: Mapping[str, Any]) -> str:
    """Where an effect is, and in which form, as explain.json has it; empty where it has no place."""
    return ", ".join(str(effect[key]) for key in PLACES if effect.get(key))


def place_in_words(effect: Mapping[str, Any]) -> str:
    """The same as people read it."""
    return ", ".join(CORNERS.get(str(effect[key]), str(effect[key])) for key in PLACES if effect.get(key))


def shown_number(value: float, *, signed: bool = False, digits: int = 3) -> str:
    """The digits that count, without an exponent unless there is no other way."""
    if not isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    decimals = digits - 1 - floor(log10(abs(value)))
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
    if round(100 * share, decimals) == 0.0:
        return "0 %"
    return f"{100 * share:{'+' if signed else ''}.{decimals}f} %".replace("-", "−")


def probability(share: float) -> str:
    """In percent, and never certain."""
    if share < 0.01:
        return "< 1 %"
    return "> 99 %" if share > 0.99 else percent(share)


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
    errors = found["fit"].get(shown.signal, {}) if shown else {}
    where = f"held-out recordings, {_unseen(found)}" if errors.get("held_out") else "the recordings it was fitted to"
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
        proof, several = answer[0].bars[-1], TOGETHER.get(len(_fitted_with(found, found["effects"][0]["id"])))
        by = f", by {several} together" if several else ""
        result.append((proof.figure, f"of the squared error of all signals explained, {proof.name}{by}"))
    if named:
        for one in answer:
            size = one.parameters[0] if one.parameters else Size("", "–", "")
            what = f"{one.name}: {size.name}" if size.name else one.name
            known = f"along the road, {size.known}" if size.figure else f"90 % interval {size.known}"
            result.append((size.figure or size.value, f"{what}, {known}" if size.known else what))
        least = min(effect["confidence"] for effect in _accepted(found))
        of = "confidence in the name" if len(answer) == 1 else "confidence in the less certain name"
        calibrated = "how often such names were right on the public split of the examination"
        result.append((probability(least), f"{of}: {calibrated}"))
    if rest := _remainder(found):
        times, signal = rest
        remains = "the largest error that remains" if _changed(found) else "the largest error"
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


def _unseen(found: Mapping[str, Any]) -> str:
    """What makes held-out recordings a proof."""
    pieces = found.get("by_pieces")  # answers of earlier versions know nothing of it
    return "of another road, each piece as its neighbours foretell it" if pieces else "which no fit has seen"


def _caption(found: Mapping[str, Any], shown: Trace) -> str:
    unit, factor = shown.shown
    before, after = (f"{shown_number(error * factor)}{_behind(unit)}" for error in shown.errors)
    seen = f"held out, {_unseen(found)}" if shown.held_out else "part of the fit"
    change = f"root mean square of the error {before} before, {after} after" if shown.changed else f"error {before}"
    return (
        f"{heading(shown.signal)}, the most affected signal, in the window where it is "
        f"worst: {shown.recording}, {shown.t[0]:.0f} to {shown.t[-1]:.0f} s ({seen}); {change}."
    )


def _candidates(found: Mapping[str, Any]) -> list[Candidate]:
    """All effects that were fitted, ranked, with what speaks for and against them."""
    effects = found["effects"]
    accepted = _accepted(found)
    gains = [_gains(effect, held_out=bool(found["held_out"])) for effect in effects]
    widest = max(found["threshold"], 1e-12, *(gain for one in gains for gain in one.values()))
    _, best = _decisive(gains[0]) if gains else ("", 0.0)
    result = []
    for effect, gain in zip(effects, gains, strict=True):
        place = place_of(effect)
        answer = found["verdict"] == "named" and any(effect is one for one in accepted)
        within = {effect["id"], f"{effect['id']} {place}"} & set(found["answer_set"])
        rival = found["verdict"] == "ambiguous" and bool(within)
        parameters = [_size(entry) for entry in effect["parameters"]]
        if "profile" in effect:
            everywhere = replace(parameters[0], name="of it everywhere")
            parameters[:1] = [_along_road(effect), everywhere]
        result.append(
            Candidate(
                name=", ".join(filter(None, (heading(effect["id"]), place_in_words(effect)))),
                sentence=effect["sentence"],
                parameters=parameters[:MOST_PARAMETERS],
                more=max(0, len(parameters) - MOST_PARAMETERS),
                bars=[Bar(name, percent(share), max(share, 0.0) / widest) for name, share in gain.items()],
                mark=found["threshold"] / widest,
                together=_together(found, effect),
                keep=percent(effect["keep"]),
                confidence=probability(effect["confidence"]),
                answer=answer or rival,
                standing="the answer" if answer else _standing(effect, gain, best, found, within=bool(within)),
            )
        )
    return result


def _accepted(found: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The effects that are the answer where one is named."""
    return [effect for effect in found["effects"] if effect.get("accepted")] or found["effects"][:1]


def _gains(effect: Mapping[str, Any], *, held_out: bool) -> dict[str, float]:
    """Relative fall of the squared error by where it was seen, the strictest proof last; minus infinity where the
    simulation broke down."""
    keys = {"fitted": "gain_training", "left out in turn": "gain_left_out"} | (
        {"held out": "gain_held_out"} if held_out else {}
    )
    return {name: -inf if effect[key] is None else effect[key] for name, key in keys.items()}


def _decisive(gains: Mapping[str, float]) -> tuple[str, float]:
    """Where it explains least, and how much: what was left out in turn decides where nothing was held out."""
    deciding = [name for name in gains if name != "left out in turn" or "held out" not in gains]
    weakest = min(deciding, key=lambda name: gains[name])
    return weakest, gains[weakest]


def _fitted_with(found: Mapping[str, Any], id: str) -> list[str]:
    """Ids of the effects that were fitted together with one of the answer, itself among them; else itself alone."""
    answers = found.get("rivals") or [[one["id"] for one in _accepted(found)]]
    if found["verdict"] not in ("named", "ambiguous"):
        return [id]
    return next((list(ids) for ids in answers if id in ids), [id])


def _first(found: Mapping[str, Any]) -> str:
    """Of several answers the one with which the model is shown."""
    if found["verdict"] != "ambiguous" or not found["effects"]:
        return ""
    return " and ".join(label(id) for id in _fitted_with(found, found["effects"][0]["id"]))


def _together(found: Mapping[str, Any], effect: Mapping[str, Any]) -> str:
    """To which other effects the gains of an effect belong as well."""
    ids = _fitted_with(found, effect["id"])
    others = " and ".join(label(id) for id in ids if id != effect["id"])
    return f"gains of {TOGETHER.get(len(ids), 'all')} together, with {others}" if others else ""


def _acting(found: Mapping[str, Any]) -> str:
    """On which part of the car, or of its surroundings, what was found acts."""
    return "; ".join(
        f"{label(part['effect'])} acts on the {', '.join(filter(None, (label(part['acts_on']), place_in_words(part))))}"
        for part in found["located"].get("parts") or ()
    )


def _standing(
    effect: Mapping[str, Any], gains: Mapping[str, float], best: float, found: Mapping[str, Any], *, within: bool
) -> str:
    """Why an effect is not the answer, or not the only one."""
    if effect["id"] not in BY_ID:
        return "describes what is left over, and names no physics"
    weakest, decisive = _decisive(gains)
    threshold = found["threshold"]
    if not within and (decisive < threshold or best <= 0.0):
        words = "no more than chance" if decisive > 0.0 else "nothing"
        if gains["fitted"] > threshold:
            return f"excluded: explains where it was fitted, but {words} {weakest}"
        return f"excluded: explains {words}"
    relative = f"{percent(decisive / best)} of what the best explains"
    if within:
        return "cannot be excluded" + ("" if decisive == best else f": {relative}")
    if found["verdict"] not in ("named", "ambiguous"):
        objection = effect.get("objection", "")
        return f"refused: {objection}" if objection else "not enough" + ("" if decisive == best else f": {relative}")
    adds = effect["adds_to_best"]
    besides = "" if adds is None else f", and {percent(adds) if adds > 0.0 else 'nothing'} besides it"
    return f"explains less: {relative}{besides}"


def _sentence(effect: Mapping[str, Any]) -> str:
    """The physics of an effect, with its form."""
    return ", ".join(filter(None, (effect["sentence"], effect.get("form", ""))))


def _size(entry: Mapping[str, Any]) -> Size:
    """A parameter of an effect with its 90 % interval; in percent, with its sign, where it is a share."""
    name, unit, (low, high) = entry["name"], entry["unit"], entry["interval_90"]
    words = "" if name == "relative" else CORNERS.get(name, label(name))
    if is_share(name, unit):
        low, high = (percent(value, signed=True) for value in (low, high))
        return Size(words, percent(entry["value"], signed=True), f"{low.removesuffix(' %')} to {high}")
    _, factor = UNITS.get(unit, (unit, 1.0))
    return Size(words, shown_value(entry["value"], unit), f"{shown_number(low * factor)} to {shown_value(high, unit)}")


def _along_road(effect: Mapping[str, Any]) -> Size:
    """Between which values a size varies along the road."""
    size, places = effect["parameters"][0], effect["profile"]
    unit, factor = size_unit(size)
    values = [factor * (size["value"] + place["value"]) for place in places]
    low, high = (f"{shown_number(value, signed=True, digits=2)}{_behind(unit)}" for value in (min(values), max(values)))
    return Size(
        _size(size).name, f"between {low} and {high} along the road", f"at {len(places)} places", f"{low} to {high}"
    )


def _base_rows(found: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """The base parameters in words with their amounts in the fit without what was found, and in that with it; the
    latter empty where nothing tells them."""
    explained = any(entry.get("explained") is not None for entry in found["base"].values())
    rows = []
    for name, entry in found["base"].items():
        unit = entry["unit"]

        def offset(value: float | None, name: str = name, unit: str = unit) -> str:
            if value is None:
                return "–"
            if name in NOTHING:
                return percent(value - NOTHING[name])
            if unit == "-" and not is_share(name, unit):
                return shown_number(value, signed=True)
            return shown_value(value, unit, change=True)

        words = ", ".join(map(label, name.split(".")[1:])) if name.startswith("effects.") else name
        if name in NOTHING:
            words = f"{name} (itself, as no vehicle file has it)"
        rows.append((words, offset(entry["value"]), offset(entry.get("explained")) if explained else ""))
    return rows


def _signal_rows(found: Mapping[str, Any]) -> list[SignalRow]:
    """Errors of all signals, the most affected first; without bars where others are proven and this one is not."""
    null = {signal["name"]: signal["null"] for signal in found["located"]["signals"]}
    fits = {name: found["fit"][name] for name in [*null, *found["fit"]] if name in found["fit"]}
    errors = {
        name: {where: Error.of(fit[where], fit["unit"]) for where in ("training", "held_out") if fit.get(where)}
        for name, fit in fits.items()
    }
    strictest = "held_out" if _proven(found) else "training"
    drawn = {name: each[strictest] for name, each in errors.items() if strictest in each}
    scale = {name: null.get(name) or max(error.before, error.after, 1e-12) for name, error in drawn.items()}
    longest = max((max(e.before, e.after) / scale[name] for name, e in drawn.items()), default=1.0)
    longest = max(longest, 1.0)
    rows = []
    for name, each in errors.items():
        unit = fits[name]["unit"]
        shown: list[tuple[float, str]] = []
        if (error := drawn.get(name)) is not None:
            shown = [(error.before, "before"), *([(error.after, "after")] if error.changed else [])]
        rows.append(
            SignalRow(
                label=label(name),
                null=Error(null[name], null[name], unit).cells[0] if name in null else "–",
                training=each["training"],
                held_out=each.get("held_out"),
                bars=[(value / scale[name] / longest, kind) for value, kind in shown],
                mark=1.0 / longest if name in null else None,
            )
        )
    return rows


def _used(found: Mapping[str, Any]) -> list[str]:
    """Recordings that were fitted; all where nothing can be said."""
    if found["verdict"] == "not_assessable":
        return list(found["recordings"])
    fitted = {segment["recording"] for segment in found["located"]["segments"]}
    return [name for name in found["recordings"] if name in fitted]


def _unused(found: Mapping[str, Any]) -> list[str]:
    """Recordings of which nothing was used, held out or not."""
    used = _used(found)
    return [*(name for name in found["recordings"] if name not in used), *found.get("held_out_unused", ())]


def _next_test(found: Mapping[str, Any]) -> str:
    """The manoeuvre that would tell the remaining answers apart, in words."""
    separating = found["would_separate"]
    if not separating:
        return ""
    predicted = f" (d′ {separating['d_prime']:.1f} predicted)" if "d_prime" in separating else ""
    return f"{separating['manoeuvre']}; watch the {label(separating['signal'])}{predicted}"


def _described(where: Mapping[str, Any] | None) -> str:
    """What was located, in words."""
    if not where:
        return ""
    sizes = ", ".join(shown_value(size["value"], size["unit"]) for size in where.get("sizes", []))
    return f"{where['description']} ({sizes})" if sizes else str(where["description"])


def _templates() -> Environment:
    return page_environment("vsense_ros.mismatch")


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
