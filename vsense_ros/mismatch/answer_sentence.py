"""The answer in a few sentences."""

from __future__ import annotations

from collections.abc import Sequence

from vsense_ros.mismatch.answer_schema import (
    Answer,
    EffectEntry,
    Force,
    Remainder,
)
from vsense_ros.mismatch.beforehand import Beforehand
from vsense_ros.mismatch.objections import LITTLE_LASTS, NO_MORE_THAN_CHANCE
from vsense_ros.mismatch.simulation import LOST
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.words import ended, in_words, label, percent, physics_in_words, shown_value
from vsense_ros.model.effects import BY_ID

DEFECTS_SAID = 3  # defects of recordings that the sentence lists


def sentence(answer: Answer) -> str:
    """The answer in words."""
    if answer.verdict == "no_mismatch":
        more = " else" if answer.recording_defects else ""
        return (
            f"Model and recordings agree once mass, tyres and the like are fitted: there is nothing{more} to find here."
        )
    if answer.verdict == "unknown":
        left = f"Something is left over that no effect of the library explains{_unexplained(answer)}."
        possible = _possible(answer)
        if possible is None:
            return left + _began(answer)
        begins = answer.onset is not None and answer.onset.gain > possible.gain_training
        return left + (_began(answer) if begins else "") + _may_be(possible, answer)
    if answer.verdict == "ambiguous":
        return _in_doubt(answer)
    accepted = answer.accepted
    alike: dict[str, list[EffectEntry]] = {}
    for effect in accepted:
        alike.setdefault(physics_in_words(effect), []).append(effect)
    named = _listed([in_words(*effects) for effects in alike.values()])
    falls = f"With {'it' if len(accepted) == 1 else 'them'} {_falls(accepted[0], answer)}."
    if answer.assumed:
        return f"Assumed, not searched for: {named}. {falls}"
    rest = "" if answer.remainder is None else f" Something more is left over{_rest_in_words(answer.remainder)}."
    return f"The model leaves out {named}. {falls}{rest}{_began(answer)}"


def conditions(answer: Answer, known: Sequence[Beforehand], left_out: Sequence[str]) -> str:
    """On what an answer rests, as sentences behind its own: defects of sensors that are `known` before any fit, where
    the answer does not name them itself, what is wrong in the recordings, and the signals that were left out of the
    comparison, each with its reason."""
    said = ""
    if known and answer.verdict != "named":
        sizes = (f"{BY_ID[one.effect].sentence} ({label(one.field)} {_in_unit(one)})" for one in known)
        said += f" Determined before any fit, and taken into account: {'; '.join(sizes)}."
    reasons = [one.partition(", ")[2] for one in left_out]  # without the name of the recording
    defects = [one for one in answer.recording_defects if not any(reason and reason in one for reason in reasons)]
    if defects:
        more = len(defects) - DEFECTS_SAID
        rest = f"; and {more} more, which the remarks list" if more > 0 else ""
        said += f" In the recordings themselves: {'; '.join(defects[:DEFECTS_SAID])}{rest}."
    if left_out:
        said += f" Left out of the comparison: {ended('; '.join(left_out))}"
    return said


def _listed(parts: Sequence[str]) -> str:
    """Parts of a sentence, which have commas of their own, as one."""
    *most, last = parts
    return f"{'; '.join(most)}; and {last}" if most else last


def _in_unit(known: Beforehand) -> str:
    extra = BY_ID[known.effect].model_fields[known.field].json_schema_extra
    assert isinstance(extra, dict)
    return shown_value(known.value, str(extra["unit"]))


def _began(answer: Answer) -> str:
    """Since when it is there, as a sentence behind others; empty where that is not known."""
    if answer.onset is None:
        return ""
    when = " and ".join(
        f"at {one.at:.1f} s ({one.interval_90[0]:.1f} to {one.interval_90[1]:.1f} s) in {one.recording}"
        for one in answer.onset.begins
    )
    like = f"{answer.onset.sentence}{f' ({label(answer.onset.where)})' if answer.onset.where else ''}"
    return (
        f" It was not there from the beginning: it begins {when}. It looks like {like}, which explains "
        f"{percent(answer.onset.gain)} if it begins then and {percent(answer.onset.gain_always)} if it is always there."
    )


def _rest_in_words(rest: Remainder) -> str:
    """What else is left over, as the end of a sentence."""
    if rest.force is not None:
        return f", which {rest.force.description} describes"
    return "" if rest.region is None else f": {rest.region.description}"


def _unexplained(answer: Answer) -> str:
    """What is known of unknown physics, as the end of a sentence."""
    if force := answer.located.force:
        return f". It is described by {force.description}, with which {_falls(force, answer)}"
    if lost := answer.located.lost:
        return f": in {' and '.join(dict.fromkeys(window.recording for window in lost))} {LOST}"
    return f": {answer.located.region.description}" if answer.located.region else ""


def _possible(answer: Answer) -> EffectEntry | None:
    """The effect that explains most where there is too little driving to prove it. None where none explains half as
    much as is asked for, or longer recordings would not ask for less."""
    if answer.threshold <= THRESHOLDS.least_gain or answer.held_out:
        return None
    likely = (e for e in answer.effects if e.objection in (NO_MORE_THAN_CHANCE, LITTLE_LASTS))
    best = max(likely, key=lambda e: e.gain_training, default=None)
    return best if best is not None and best.gain_training >= answer.threshold / 2 else None


def _may_be(effect: EffectEntry, answer: Answer) -> str:
    """What an effect explains that is not proven, and why not, as a sentence behind others."""
    why = LITTLE_LASTS
    if effect.objection == NO_MORE_THAN_CHANCE:
        why = f"chance explains up to {percent(answer.threshold)}"
    explains = f" It may be {effect.sentence}: that explains {percent(effect.gain_training)}"
    return f"{explains}, but on {answer.driven_s:.0f} s of driving {why}. Longer recordings would decide."


def _in_doubt(answer: Answer) -> str:
    """Which effects the recordings cannot tell apart, and which are sure besides."""
    shared = answer.sure
    others = [[id for id in effects if id not in shared] for effects in answer.rivals]
    choices = [" with ".join(BY_ID[id].sentence for id in effects) for effects in others if effects]
    more = "" if answer.remainder is None else " Whichever it is, something more is left over."
    doubt = f"these recordings cannot determine which it is: {', or '.join(dict.fromkeys(choices))}.{more}"
    if not shared:
        return doubt[0].upper() + doubt[1:]
    return f"The model leaves out {_listed([BY_ID[id].sentence for id in shared])}. It leaves out more, and {doubt}"


def _falls(term: EffectEntry | Force, answer: Answer) -> str:
    """By how much the error falls with what was found, and where that is proven."""
    trained, proven, on = term.gain_training, term.gain_held_out, "on recordings it was not fitted to"
    if answer.by_pieces:
        on = "on another road, where neighbouring pieces predict each other"
    if proven is None or not round(100 * proven):
        untouched = "" if proven is None else "; recordings it was not fitted to have no trace of it"
        proven, on = term.gain_left_out, f"where it was left out of the fit{untouched}"
    ways = ["grows" if gain < 0 else "falls" for gain in (trained, proven)]
    again = "" if ways[0] == ways[1] else f"{ways[1]} "
    return f"the squared error {ways[0]} by {100 * abs(trained):.0f} %, and {again}by {100 * abs(proven):.0f} % {on}"
