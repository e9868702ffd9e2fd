"""What is read of the tool's `explain.json`: the one place that knows its keys. None: the tool gave no answer."""

from __future__ import annotations

from typing import TypeVar

from vsense_ros.mismatch.answer_schema import Answer, EffectEntry

T = TypeVar("T")
Interval = tuple[float, float]


def verdict(explain: Answer | None) -> str:
    return explain.verdict if explain else "no_answer"


def effects(explain: Answer | None) -> tuple[EffectEntry, ...]:
    """Ranked."""
    return explain.effects if explain else ()


def ranked(explain: Answer | None) -> list[str]:
    """Ids of the effects."""
    return [effect.id for effect in effects(explain)]


def accepted(explain: Answer | None) -> list[str]:
    """Ids of the effects that the tool says are there."""
    return [effect.id for effect in explain.accepted] if explain and explain.verdict in ("named", "ambiguous") else []


def answer_set(explain: Answer | None) -> list[str]:
    """Ids of the effects within reach of the best."""
    return list(explain.answer_set) if explain else []


def parameters(effect: EffectEntry) -> dict[str, float]:
    """Values by name; a single one of an effect that says its wheel, axle or sensor goes by that."""
    return _by_place(effect, {size.name: size.value for size in effect.parameters})


def intervals(effect: EffectEntry) -> dict[str, Interval]:
    """90 % intervals by the same names."""
    return _by_place(effect, {size.name: size.interval_90 for size in effect.parameters})


def _by_place(effect: EffectEntry, found: dict[str, T]) -> dict[str, T]:
    place = effect.wheel or effect.axle or effect.sensor
    return {place: next(iter(found.values()))} if place and len(found) == 1 else found


def driven(explain: Answer | None) -> float:
    """Duration of what is looked at in all recordings, held out or not [s]."""
    return explain.driven_s if explain else 0.0


def misfit(explain: Answer | None) -> float | None:
    """Root mean square of what the refitted model leaves over in training, in standard deviations of a good model."""
    return explain.misfit if explain else None


def gains(effect: EffectEntry) -> tuple[float, float]:
    """What it gains on training and on held-out manoeuvres."""
    assert effect.gain_held_out is not None, "every case of the examination has held-out manoeuvres"
    return effect.gain_training, effect.gain_held_out


def explained_seconds(explain: Answer) -> tuple[float, str]:
    """What the effect that explains most gains where it was not fitted, times the duration [s], and its id."""
    each = ((min(e.gain_training, e.gain_left_out) * explain.driven_s, e.id) for e in explain.effects)
    return max(each, default=(0.0, "nothing"))


def errors(explain: Answer | None) -> dict[str, tuple[float, float]]:
    """Errors of each signal on held-out manoeuvres, before and after."""
    return {
        signal: (found.held_out.before, found.held_out.after)
        for signal, found in (explain.fit.items() if explain else ())
        if found.held_out
    }
