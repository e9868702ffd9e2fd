"""Numbers, effects and verdicts as people read them, on the page, in the terminal and in sentences."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import floor, isfinite, log10, pi
from typing import NamedTuple

from vsense_ros.messages.topics import WHEELS
from vsense_ros.mismatch.answer_schema import ActingPart, Answer, EffectEntry, Size, places
from vsense_ros.model.effects.base import CORNERS

# The unit in which people read a parameter, and the factor to it.
UNITS: Mapping[str, tuple[str, float]] = {
    "rad": ("°", 180 / pi),
    "rad/s": ("°/s", 180 / pi),
    "rad/N": ("°/kN", 180e3 / pi),
    "-": ("", 1.0),
}
SIGNAL_UNITS = {**UNITS, "m": ("mm", 1e3)}  # the same for signals, where lengths are travels of a suspension
# Endings of names without a unit that are not given in percent; the changes of shares would pass for relative ones.
NO_SHARES = ("coefficient", "in driving", "in braking")
CAPITALS = (*WHEELS, "imu", "gnss")  # words of names that are written in capitals
END_OF_SENTENCE = re.compile(r"(?<=[.?]) (?=[A-Z])")


class Badge(NamedTuple):
    """How a verdict is shown."""

    badge: str
    title: str  # of the page in a browser's tab
    tone: str  # how the page colours the badge


BADGES: Mapping[str, Badge] = {
    "named": Badge("Named", "What the model leaves out", "found"),
    "ambiguous": Badge("Cannot be told apart", "What the model may leave out", "open"),
    "unknown": Badge("Unknown physics", "Something the model leaves out", "open"),
    "no_mismatch": Badge("Nothing to find", "Model and recordings agree", "calm"),
    "not_assessable": Badge("Not assessable", "Nothing can be said", "calm"),
}
DEFECTIVE = Badge("Only the recordings are wrong", "What is wrong in the recordings", "found")
ASSUMED = Badge("Assumed", "What was assumed to be left out", "open")


def badge_of(answer: Answer) -> Badge:
    """How the verdict of an answer is shown."""
    if answer.verdict == "no_mismatch" and answer.recording_defects:
        return DEFECTIVE
    return ASSUMED if answer.verdict == "named" and answer.assumed else BADGES[answer.verdict]


@dataclass(frozen=True)
class SizeInWords:
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


def first_and_rest(said: str) -> tuple[str, str]:
    """The first sentence of an answer in words, which is its headline, and those behind it."""
    first, *others = END_OF_SENTENCE.split(said, maxsplit=1)
    return first, "".join(others)


def ended(said: str) -> str:
    """A sentence with its full stop, unless it ends with a question."""
    return said if said.endswith(("?", ".")) else f"{said}."


def label(name: str) -> str:
    """A name of the files in words."""
    return " ".join(word.upper() if word in CAPITALS else word for word in name.split("_"))


def heading(name: str) -> str:
    """A name of the files in words, with a capital."""
    words = label(name)
    return words[:1].upper() + words[1:]


def in_words(effect: EffectEntry, *alike: EffectEntry) -> str:
    """An effect as the end of "the model leaves out …": what it is, where, and how large; how large at each place, if
    there are several that are alike."""
    return f"{physics_in_words(effect)} ({'; '.join(map(sizes_in_words, (effect, *alike)))})"


def physics_in_words(effect: EffectEntry) -> str:
    """The physics of an effect, with its form."""
    return ", ".join(filter(None, (effect.sentence, effect.form)))


def sizes_in_words(effect: EffectEntry) -> str:
    """How large an effect is; the range where that changes along the road."""
    sizes = [size_in_words(size) for size in effect.parameters]
    if effect.profile is not None:
        sizes[:1] = [range_along_road(effect)]
    return ", ".join(size.words for size in sizes)


def place_in_words(of: EffectEntry | ActingPart) -> str:
    """Where an effect is, and in which form; empty where it has no place."""
    return ", ".join(CORNERS.get(place, place) for place in places(of))


def size_in_words(size: Size) -> SizeInWords:
    """A parameter of an effect with its 90 % interval; in percent, with its sign, where it is a share."""
    low, high = size.interval_90
    words = "" if size.name == "relative" else CORNERS.get(size.name, label(size.name))
    if is_share(size.name, size.unit):
        limits = (percent(value, signed=True) for value in (low, high))
        first, last = limits
        return SizeInWords(words, percent(size.value, signed=True), f"{first.removesuffix(' %')} to {last}")
    _, factor = UNITS.get(size.unit, (size.unit, 1.0))
    known = f"{shown_number(low * factor)} to {shown_value(high, size.unit)}"
    return SizeInWords(words, shown_value(size.value, size.unit), known)


def range_along_road(effect: EffectEntry) -> SizeInWords:
    """Between which values a size varies along the road."""
    size, profile = effect.parameters[0], effect.profile or ()
    unit, factor = size_unit(size)
    values = [factor * (size.value + point.value) for point in profile]
    low, high = (f"{shown_number(value, signed=True, digits=2)}{behind(unit)}" for value in (min(values), max(values)))
    return SizeInWords(
        size_in_words(size).name,
        f"between {low} and {high} along the road",
        f"at {len(profile)} places",
        f"{low} to {high}",
    )


def is_share(name: str, unit: str) -> bool:
    """True if people read a size of an effect in percent."""
    return unit == "-" and not name.endswith(NO_SHARES)


def size_unit(size: Size) -> tuple[str, float]:
    """What people read a size of an effect in, and the factor to it."""
    return ("%", 100.0) if is_share(size.name, size.unit) else UNITS.get(size.unit, (size.unit, 1.0))


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
    return f"{shown_number(value * factor, signed=change)}{behind(unit)}"


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


def behind(unit: str) -> str:
    """A unit as it stands behind a number."""
    return unit if unit.startswith("°") or not unit else f" {unit}"
