"""What was found where model and recordings differ, as a page that opens without a network."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vsense_ros.evaluate.html_page import embedded, page_template, write_page
from vsense_ros.files.atomic import atomic_write
from vsense_ros.mismatch.answer_schema import Answer, EffectEntry, Errors, Force, Region, SignalErrors, Size
from vsense_ros.mismatch.picture import Trace, before_and_after, most_affected, other_signals, road_profile, when
from vsense_ros.mismatch.tables import (
    OBSERVER_COLUMNS,
    TOGETHER,
    EffectRow,
    ErrorChange,
    base_rows,
    changed,
    effect_rows,
    fitted_with,
    next_test_in_words,
    observer_rows,
    proven,
    reference_in_words,
    remainder_in_words,
    signal_rows,
)
from vsense_ros.mismatch.words import (
    badge_of,
    behind,
    first_and_rest,
    heading,
    label,
    percent,
    physics_in_words,
    place_in_words,
    probability,
    shown_number,
    shown_value,
)

PAGE = "report.html"
_TEMPLATES = "vsense_ros.mismatch"
NEXT_TEST = re.compile(r'<p id="next-test">.*?</p>', re.DOTALL)  # the paragraph of a page

Headline = tuple[str, str]  # a figure, and what it is


def write_report(answer: Answer, traces: Sequence[Trace], path: Path) -> None:
    """Write the page about an answer, with the curves of `traces`, to `path`."""
    effects, sure = effect_rows(answer), answer.sure
    remain = [(row, entry.id in sure) for row, entry in zip(effects, answer.effects, strict=True) if row.in_answer]
    write_page(
        path,
        _TEMPLATES,
        "explain.html.j2",
        answer=answer,
        badge=badge_of(answer),
        said=first_and_rest(answer.sentence),
        effects=effects,
        sure=[row for row, is_sure in remain if is_sure],
        left_open=[row for row, is_sure in remain if not is_sure],
        designed=answer.would_separate is not None,
        first=_first(answer),
        together=any(row.together for row in effects),
        threshold=percent(answer.threshold),
        signals=signal_rows(answer),
        proven=proven(answer),
        changed=changed(answer),
        base=base_rows(answer),
        next_test=next_test_in_words(answer),
        used=_used(answer),
        unused=_unused(answer),
        remainder=remainder_in_words(answer),
        observer=observer_rows(answer.observer) if answer.observer else [],
        observer_columns=OBSERVER_COLUMNS,
        mounting=reference_in_words(answer.observer) if answer.observer else "",
        out_of_reach=[(heading(one.id), one.reason) for one in answer.out_of_reach],
        **_where(answer),
        **_pictures(answer, traces),
    )


def _where(answer: Answer) -> dict[str, str]:
    """Where the error is, and on what that which was found acts, in words."""
    return {
        "region": _described(answer.located.region),
        "force": _described(answer.located.force),
        "acting": _acting(answer),
    }


def _pictures(answer: Answer, traces: Sequence[Trace]) -> dict[str, Any]:
    """The pictures, and the words that go with them; empty where there is nothing to draw."""
    signals = [signal.name for signal in answer.located.signals]
    shown = most_affected(traces, signals)
    return {
        "headlines": _headlines(answer, shown),
        "shown": shown,
        "caption": _caption(answer, shown) if shown else "",
        "picture": embedded(before_and_after(shown)) if shown else "",
        "beside": embedded(other_signals(traces, shown, signals)) if shown else "",
        "timeline": embedded(when(answer.located.segments, traces)),
        "profiles": [
            (physics_in_words(effect), embedded(road_profile(effect)), effect.profile[0].latitude is not None)
            for effect in answer.effects
            if effect.profile and effect.id in answer.answer_set
        ],
    }


def write_next_test(answer: Answer, path: Path) -> None:
    """Say the next test on the page at `path`, of which nothing else changes; nothing where there is no page.

    The curves of the page are not stored, so that it cannot be written anew.
    """
    if path.is_file():
        words = (
            page_template(_TEMPLATES, "next_test.html.j2")
            .render(answer=answer, next_test=next_test_in_words(answer), designed=True)
            .strip()
        )
        page = path.read_text(encoding="utf-8")
        with atomic_write(path) as file:
            file.write(NEXT_TEST.sub(lambda _: words, page, count=1))


def _headlines(answer: Answer, shown: Trace | None) -> list[Headline]:
    """The figures below the sentence."""
    rows = [(row, effect) for row, effect in zip(effect_rows(answer), answer.effects, strict=True) if row.in_answer]
    sure = [(row, effect) for row, effect in rows if answer.verdict == "named" or effect.id in answer.sure]
    return [
        *_error_headline(answer, shown),
        *_proof_headline(answer, [row for row, _ in rows]),
        *(_size_headlines(sure) if sure else []),
        *_remainder_headline(answer),
    ]


def _error_headline(answer: Answer, shown: Trace | None) -> list[Headline]:
    """The error of the signal in the first picture."""
    fit = answer.fit.get(shown.signal) if shown else None
    if shown is None or fit is None:
        return []
    error = ErrorChange.of(_strictest(fit), shown.unit)
    where = f"held-out recordings, {_unseen(answer)}" if fit.held_out else "the recordings it was fitted to"
    of = f"error of the {label(shown.signal)}, on {where}"
    before, after, change = error.cells
    return [(change, f"{of}: from {before} to {after}")] if error.changed else [(before, of)]


def _strictest(fit: SignalErrors) -> Errors:
    """The errors that prove most."""
    return fit.held_out or fit.training


def _proof_headline(answer: Answer, rows: Sequence[EffectRow]) -> list[Headline]:
    """How much of the error the answer explains."""
    if not rows:
        return []
    proof, several = rows[0].bars[-1], TOGETHER.get(len(fitted_with(answer, answer.effects[0].id)))
    by = f", by {several} together" if several else ""
    return [(proof.figure, f"of the squared error of all signals explained, {proof.name}{by}")]


def _size_headlines(sure: Sequence[tuple[EffectRow, EffectEntry]]) -> list[Headline]:
    """How large what is sure is, by the size of it that is furthest from zero, and the least confidence in a name."""
    result = []
    for row, effect in sure:
        if not row.sizes:
            result.append(("–", row.name))
            continue
        size = row.sizes[0 if effect.profile else _clearest(effect.parameters[: len(row.sizes)])]
        what = f"{row.name}: {size.name}" if size.name else row.name
        known = f"along the road, {size.known}" if size.figure else f"90 % interval {size.known}"
        result.append((size.figure or size.value, f"{what}, {known}"))
    of = "confidence in the name" if len(sure) == 1 else "confidence in the less certain name"
    calibrated = "how often such names were right in the examination"
    return [*result, (probability(min(effect.confidence for _, effect in sure)), f"{of}: {calibrated}")]


def _clearest(sizes: Sequence[Size]) -> int:
    """Which of these sizes is furthest from zero, in widths of its interval."""
    clear = [abs(size.value) / max(size.interval_90[1] - size.interval_90[0], 1e-12) for size in sizes]
    return clear.index(max(clear))


def _remainder_headline(answer: Answer) -> list[Headline]:
    """The largest error of the model as it was found, in multiples of what a good model leaves."""
    ratios = [
        (_strictest(answer.fit[signal.name]).after / signal.null, signal.name)
        for signal in answer.located.signals
        if signal.null > 0 and signal.name in answer.fit
    ]
    if not ratios:
        return []
    times, signal = max(ratios)
    remains = "the largest error that remains" if changed(answer) else "the largest error"
    return [(f"{times:.1f} ×", f"what a good model leaves: {remains}, of the {label(signal)}")]


def _unseen(answer: Answer) -> str:
    """What makes held-out recordings a proof."""
    if answer.by_pieces:
        return "of another road, each piece as its neighbours predict it"
    return "which no fit has seen"


def _caption(answer: Answer, shown: Trace) -> str:
    unit, factor = shown.shown
    before, after = (f"{shown_number(error * factor)}{behind(unit)}" for error in shown.errors)
    seen = f"held out, {_unseen(answer)}" if shown.held_out else "part of the fit"
    change = f"root mean square of the error {before} before, {after} after" if shown.changed else f"error {before}"
    return (
        f"{heading(shown.signal)}, the most affected signal, in the window where it is "
        f"worst: {shown.recording}, {shown.t[0]:.0f} to {shown.t[-1]:.0f} s ({seen}); {change}."
    )


def _first(answer: Answer) -> str:
    """The answer with which the model is shown, if there are several."""
    if answer.verdict != "ambiguous" or not answer.effects:
        return ""
    return " and ".join(label(id) for id in fitted_with(answer, answer.effects[0].id))


def _acting(answer: Answer) -> str:
    """On which part of the car, or of its surroundings, what was found acts."""
    return "; ".join(
        f"{label(part.effect)} acts on the {', '.join(filter(None, (label(part.acts_on), place_in_words(part))))}"
        for part in answer.located.parts
    )


def _used(answer: Answer) -> list[str]:
    """Recordings that were fitted; all where nothing can be said."""
    if answer.verdict == "not_assessable":
        return list(answer.recordings)
    fitted = {segment.recording for segment in answer.located.segments}
    return [name for name in answer.recordings if name in fitted]


def _unused(answer: Answer) -> list[str]:
    """Recordings of which nothing was used, held out or not."""
    used = _used(answer)
    return [*(name for name in answer.recordings if name not in used), *answer.held_out_unused]


def _described(where: Region | Force | None) -> str:
    """What was located, in words."""
    if where is None:
        return ""
    if isinstance(where, Force) and where.sizes:
        return f"{where.description} ({', '.join(shown_value(size.value, size.unit) for size in where.sizes)})"
    return where.description
