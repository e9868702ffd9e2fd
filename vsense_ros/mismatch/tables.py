"""The tables of an answer: effects with what speaks for and against each, errors of the signals, base parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import degrees, inf

from vsense_ros.mismatch.answer_schema import Answer, BaseParameter, EffectEntry, Errors, ObserverComparison
from vsense_ros.mismatch.words import (
    SIGNAL_UNITS,
    SizeInWords,
    behind,
    heading,
    is_share,
    label,
    percent,
    place_in_words,
    probability,
    range_along_road,
    shown_number,
    shown_value,
    size_in_words,
)
from vsense_ros.model.effects import BY_ID

MOST_PARAMETERS = 6  # of an effect that are listed; a profile of a road has dozens
TOGETHER = {2: "both", 3: "all three", 4: "all four", 5: "all five", 6: "all six"}


@dataclass(frozen=True)
class ErrorChange:
    """Root mean square of the error of a signal, before and after, in its SI unit."""

    before: float
    after: float
    unit: str

    @classmethod
    def of(cls, errors: Errors, unit: str) -> ErrorChange:
        return cls(errors.before, errors.after, unit)

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
        before, after = (f"{shown_number(error * factor)}{behind(unit)}" for error in (self.before, self.after))
        return before, after if self.changed else "–", self.change


@dataclass(frozen=True)
class SignalRow:
    """The errors of one signal, and bars of those that prove most: lengths between 0 and 1, with their colour."""

    label: str
    null: str  # what a good model leaves
    training: ErrorChange
    held_out: ErrorChange | None  # on recordings that no fit has seen
    bars: list[tuple[float, str]]
    mark: float | None  # the length of what a good model leaves

    @property
    def errors(self) -> list[ErrorChange]:
        return [self.training, *([self.held_out] if self.held_out else [])]


@dataclass(frozen=True)
class Bar:
    """A share of the squared error: its `figure`, and the `length` of its bar between 0 and 1."""

    name: str
    figure: str
    length: float


@dataclass(frozen=True)
class EffectRow:
    """An effect that was fitted, with what speaks for and against it."""

    name: str
    sentence: str
    sizes: list[SizeInWords]
    more: int  # sizes that are not listed
    bars: list[Bar]
    mark: float  # the length that chance reaches
    together: str  # with which other effects it was fitted, to which its gains belong as well
    independent_share: str
    confidence: str
    in_answer: bool
    standing: str


def effect_rows(answer: Answer) -> list[EffectRow]:
    """All effects that were fitted, ranked."""
    gains = [_gains(effect, held_out=bool(answer.held_out)) for effect in answer.effects]
    widest = max(answer.threshold, 1e-12, *(gain for one in gains for gain in one.values()))
    fitted = [gain for effect, gain in zip(answer.effects, gains, strict=True) if not _before_any_fit(answer, effect)]
    _, best = _deciding(fitted[0]) if fitted else ("", 0.0)
    return [_effect_row(answer, effect, gain, best, widest) for effect, gain in zip(answer.effects, gains, strict=True)]


def _effect_row(
    answer: Answer, effect: EffectEntry, gains: Mapping[str, float], best: float, widest: float
) -> EffectRow:
    """`best` is the gain of the first effect, `widest` the one whose bar has length 1."""
    named = answer.verdict == "named" and effect.accepted
    sizes = [size_in_words(size) for size in effect.parameters]
    if effect.profile is not None:
        sizes[:1] = [range_along_road(effect), replace(sizes[0], name="of it everywhere")]
    return EffectRow(
        name=", ".join(filter(None, (heading(effect.id), place_in_words(effect)))),
        sentence=effect.sentence,
        sizes=sizes[:MOST_PARAMETERS],
        more=max(0, len(sizes) - MOST_PARAMETERS),
        bars=[Bar(name, percent(share), max(share, 0.0) / widest) for name, share in gains.items()],
        mark=answer.threshold / widest,
        together=_together(answer, effect),
        independent_share=percent(effect.keep),
        confidence=probability(effect.confidence),
        in_answer=named or (answer.verdict == "ambiguous" and effect.id in answer.answer_set),
        standing="the answer" if named else _standing(answer, effect, gains, best),
    )


def _gains(effect: EffectEntry, *, held_out: bool) -> dict[str, float]:
    """Relative fall of the squared error by where it was seen, the strictest proof last; minus infinity where the
    simulation broke down."""
    gains: dict[str, float | None] = {"fitted": effect.gain_training, "left out in turn": effect.gain_left_out}
    if held_out:
        gains["held out"] = effect.gain_held_out
    return {name: -inf if gain is None else gain for name, gain in gains.items()}


def _deciding(gains: Mapping[str, float]) -> tuple[str, float]:
    """Where an effect explains least, and how much: what it explains where it was left out of the fit in turn decides
    only if nothing was held out."""
    deciding = [name for name in gains if name != "left out in turn" or "held out" not in gains]
    weakest = min(deciding, key=lambda name: gains[name])
    return weakest, gains[weakest]


def fitted_with(answer: Answer, id: str) -> tuple[str, ...]:
    """Ids of the effects that were fitted together with one of the answer, itself among them; else itself alone."""
    if answer.verdict not in ("named", "ambiguous"):
        return (id,)
    return next((ids for ids in answer.rivals if id in ids), (id,))


def _together(answer: Answer, effect: EffectEntry) -> str:
    """To which other effects the gains of an effect belong as well."""
    ids = fitted_with(answer, effect.id)
    others = " and ".join(label(id) for id in ids if id != effect.id)
    if not others:
        return ""
    without = "" if effect.gain_without is None else f"; without it {percent(effect.gain_without)}"
    return f"gains of {TOGETHER.get(len(ids), 'all')} together, with {others}{without}"


def _before_any_fit(answer: Answer, effect: EffectEntry) -> bool:
    """True for a defect of a sensor that is known before any fit, in an answer that names nothing else."""
    return effect.accepted and answer.verdict not in ("named", "ambiguous")


def _standing(answer: Answer, effect: EffectEntry, gains: Mapping[str, float], best: float) -> str:
    """Why an effect is not the answer, or not the only one."""
    if effect.id not in BY_ID:
        return "describes what is left over, and names no physics"
    if _before_any_fit(answer, effect):
        return "determined before any fit, by sensors of one motion"
    if answer.verdict == "ambiguous" and effect.id in answer.sure:
        return "sure: in every explanation that remains"
    within = effect.id in answer.answer_set
    weakest, least = _deciding(gains)
    if not within and (least < answer.threshold or best <= 0.0):
        words = "no more than chance" if least > 0.0 else "nothing"
        if gains["fitted"] > answer.threshold:
            return f"excluded: explains where it was fitted, but {words} {weakest}"
        return f"excluded: explains {words}"
    relative = f"{percent(least / best)} of what the best explains"
    if within:
        return "cannot be excluded" + ("" if least == best else f": {relative}")
    if answer.verdict not in ("named", "ambiguous"):
        if effect.objection:
            return f"refused: {effect.objection}"
        return "not enough" + ("" if least == best else f": {relative}")
    adds = effect.adds_to_best
    besides = "" if adds is None else f", and {percent(adds) if adds > 0.0 else 'nothing'} besides it"
    return f"explains less: {relative}{besides}"


def base_rows(answer: Answer) -> list[tuple[str, str, str]]:
    """The base parameters in words, with their offsets in the fit without what was found and in that with it; the
    latter empty where nothing was found."""
    explained = any(parameter.explained is not None for parameter in answer.base.values())
    return [
        (
            base_name(name),
            _base_offset(name, parameter, parameter.value),
            _base_offset(name, parameter, parameter.explained) if explained else "",
        )
        for name, parameter in answer.base.items()
    ]


def base_name(name: str) -> str:
    """A base parameter as people read it."""
    return ", ".join(map(label, name.split(".")[1:])) if name.startswith("effects.") else name


def _base_offset(name: str, parameter: BaseParameter, offset: float | None) -> str:
    if offset is None:
        return "–"
    if parameter.unit == "-" and not is_share(name, parameter.unit):
        return shown_number(offset, signed=True)
    return shown_value(offset, parameter.unit, change=True)


def signal_rows(answer: Answer) -> list[SignalRow]:
    """Errors of all signals, the most affected first. Bars show the held-out errors where there are any: a signal that
    no held-out recording has is then without bars."""
    null = {signal.name: signal.null for signal in answer.located.signals}
    fits = {name: answer.fit[name] for name in [*null, *answer.fit] if name in answer.fit}
    training = {name: ErrorChange.of(fit.training, fit.unit) for name, fit in fits.items()}
    held_out = {name: ErrorChange.of(fit.held_out, fit.unit) for name, fit in fits.items() if fit.held_out}
    drawn = held_out if proven(answer) else training
    scale = {name: null.get(name) or max(error.before, error.after, 1e-12) for name, error in drawn.items()}
    longest = max((max(e.before, e.after) / scale[name] for name, e in drawn.items()), default=1.0)
    longest = max(longest, 1.0)
    rows = []
    for name, fit in fits.items():
        shown: list[tuple[float, str]] = []
        if (error := drawn.get(name)) is not None:
            shown = [(error.before, "before"), *([(error.after, "after")] if error.changed else [])]
        rows.append(
            SignalRow(
                label=label(name),
                null=ErrorChange(null[name], null[name], fit.unit).cells[0] if name in null else "–",
                training=training[name],
                held_out=held_out.get(name),
                bars=[(value / scale[name] / longest, kind) for value, kind in shown],
                mark=1.0 / longest if name in null else None,
            )
        )
    return rows


def proven(answer: Answer) -> bool:
    """True if errors on recordings that no fit has seen are known."""
    return any(errors.held_out for errors in answer.fit.values())


def changed(answer: Answer) -> bool:
    """True if something was added to the model, so that there is an error after beside the one before."""
    return any(row.training.changed for row in signal_rows(answer))


def remainder_in_words(answer: Answer) -> str:
    """What is left over besides what is named: which signals stay how far off, and what describes it; empty where that
    is all."""
    rest = answer.remainder
    if rest is None:
        return ""
    parts = [
        f"{label(signal.name)}, {signal.before / signal.null:.1f} times what a good model leaves"
        for signal in rest.signals
        if signal.null > 0
    ]
    said = "; ".join(parts) or f"all signals together, {rest.level:.1f} times what a good model leaves"
    if rest.force is not None:
        sizes = ", ".join(shown_value(size.value, size.unit) for size in rest.force.sizes)
        said += f". It is described by {rest.force.description} ({sizes})"
    elif rest.region is not None:
        said += f". {rest.region.description[:1].upper()}{rest.region.description[1:]}"
    return said


OBSERVER_COLUMNS = ("file as it was", "noise levels alone fitted", "extended file")


@dataclass(frozen=True)
class ObserverRow:
    """A figure of the observer with each of the `OBSERVER_COLUMNS`."""

    what: str
    cells: tuple[str, ...]


def observer_rows(compared: ObserverComparison) -> list[ObserverRow]:
    """How the observer fares, in words."""
    columns = (compared.as_it_was, compared.retuned, compared.extended)
    rows = [ObserverRow("log-likelihood per message", tuple(_three_digits(one.log_likelihood) for one in columns))]
    for name in compared.as_it_was.sensors:
        sensors = [one.sensors[name] for one in columns]
        rows.append(
            ObserverRow(
                f"{label(name)}: size of the innovations", ("1", *(f"{one.innovation:.2f} ×" for one in sensors[1:]))
            )
        )
        rows.append(
            ObserverRow(f"{label(name)}: log-likelihood", tuple(_three_digits(one.log_likelihood) for one in sensors))
        )
    for name, first in compared.as_it_was.errors.items():
        errors = [one.errors[name] for one in columns]
        unit, factor = SIGNAL_UNITS.get(first.unit, (first.unit, 1.0))
        for words, values in (
            ("error", [error.rmse for error in errors]),
            ("error, constant fitted", [error.without_constant for error in errors]),
        ):
            cells = tuple(f"{shown_number(value * factor)}{behind(unit)}" for value in values)
            rows.append(ObserverRow(f"{label(name)}: {words}", cells))
    return rows


def _three_digits(value: float) -> str:
    return f"{value:.3f}".replace("-", "−")


def reference_in_words(compared: ObserverComparison) -> str:
    """Where the recordings say that their reference is mounted; empty without one."""
    places = [one.reference for one in (compared.as_it_was, compared.extended)]
    if places[0] is None or places[1] is None:
        return ""
    said = [
        f"{place.x:+.2f} m ahead and {place.y:+.2f} m to the left of the centre of gravity, turned by "
        f"{degrees(place.yaw):+.2f}°".replace("-", "−")
        for place in places
        if place is not None
    ]
    return (
        f"Where the reference is mounted is fitted for errors without a constant: {said[0]}; with the extended file "
        f"{said[1]}."
    )


def next_test_in_words(answer: Answer) -> str:
    """The manoeuvre, or the driving, that would tell the remaining answers apart; empty where none is known."""
    test = answer.would_separate
    if test is None:
        return answer.drive_next
    return f"{test.manoeuvre}; watch the {label(test.signal)} (d′ {test.d_prime:.1f} predicted)"
