"""Which numbers of a signal are values: codes that say that there is none, and ranges that a value may leave steadily.

Buses have no word for "absent": senders use the highest numbers of a signal (SAE J1939-71), numbers to which the
database gives a name (VAL_), or numbers outside the range that the database states. Ranges are guesses of who wrote the
database, too: a steering wheel is turned beyond its one without a jump.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database import Signal as DbcSignal
from numpy.typing import NDArray

from vsense_ros.driver.can_signal import Array, SignalField


@dataclass(frozen=True)
class ValiditySettings:
    """What counts as steady beyond a range: decisions of this project."""

    largest_step: float = 0.03  # from one value to the next, of the width of the range
    furthest: float = 0.25  # beyond the range, of its width


SETTINGS = ValiditySettings()

_WORDS = re.compile(r"[A-ZÄÖÜ]+(?![a-zäöüß])|[A-ZÄÖÜ]?[a-zäöüß]+")
_NO_VALUE = re.compile(
    r"\b(?:sna|n a|na|invalid|not valid|ungueltig|ungültig|ungultig|init\w*|error|err|fehler\w*|fault\w*|failure|"
    r"failed|defect\w*|defekt|not available|unavailable|not avail|nicht verf\w*|not present|not defined|undefined|"
    r"unknown|unbekannt|no data\w*|no signal|no value|unplausi\w*|implausi\w*|snv)\b"
)
_DENIED = re.compile(
    r"\b(?:no|not|kein|keine|without|ohne) (?:init\w*|error|err|fehler|fault|failure|defect\w*)|fehlerfrei"
)
_LAST_OF_J1939 = 0xFE  # the first byte of a number from which on it is an error or not available (SAE J1939-71)


def is_no_value(name: str) -> bool:
    """True if the name that a database gives to a number (VAL_) says that the number is no value."""
    words = " ".join(_WORDS.findall(name)).lower()
    return bool(_NO_VALUE.search(words)) and not _DENIED.search(words)


@dataclass(frozen=True, slots=True)
class Validity:
    """Which numbers of one signal are values.

    A number in `codes`, or from `first_code` on, is none. Values in [lowest, highest] are taken; others are only if
    they continue the value before.
    """

    name: str
    codes: dict[int, str]
    first_code: float = math.inf
    lowest: float = -math.inf
    highest: float = math.inf
    text: str = ""  # of the range

    @staticmethod
    def of(signal: DbcSignal, field: SignalField, *, j1939: bool, ranged: bool) -> tuple[Validity, str]:
        """By what the database says of a signal; without its range where not `ranged`. The text says why a range that
        it states is not used."""
        codes = {int(raw): str(name) for raw, name in (signal.choices or {}).items() if is_no_value(str(name))}
        first_code = math.inf
        if j1939 and field.length >= 8 and not (field.is_signed or field.is_float):
            first_code = _LAST_OF_J1939 << (field.length - 8)
        limits, doubt = _range_of(signal, field) if ranged else (None, "")
        return Validity(signal.name, codes, first_code, *(limits or (-math.inf, math.inf, ""))), doubt

    def objection(self, raw: float, value: float, before: float | None) -> str:
        """Why a number is not taken for a value, which follows the value `before`; empty if it is taken."""
        if raw in self.codes:
            return f"{self.name} has no value ({self.codes[int(raw)]})"
        if raw >= self.first_code:
            return f"{self.name} has no value (code {raw:#x} of J1939)"
        if self.lowest <= value <= self.highest:
            return ""
        width = self.highest - self.lowest
        beyond = max(self.lowest - value, value - self.highest)
        steady = before is not None and abs(value - before) <= SETTINGS.largest_step * width
        if steady and beyond <= SETTINGS.furthest * width:
            return ""
        return f"{self.name} out of range {self.text}"

    def usual(self, scale: float, offset: float) -> tuple[float, float]:
        """The least and the largest value that needs no closer look, of a signal with this scale and offset."""
        if math.isinf(self.first_code):
            return self.lowest, self.highest
        last = (self.first_code - 0.5) * scale + offset
        return (self.lowest, min(self.highest, last)) if scale > 0 else (max(self.lowest, last), self.highest)

    @property
    def beyond(self) -> str:
        """What is said of values that continue others beyond the range."""
        return f"{self.name} moves steadily beyond its range {self.text}, and is used"

    def of_all(
        self, raw: NDArray[Any], values: Array, good: NDArray[np.bool_], said: Counter[str]
    ) -> NDArray[np.bool_]:
        """Which numbers of a log are values, (n,), as `objection` judges one after the other those that are `good`;
        `said` counts what is objected."""
        coded = np.isin(raw, list(self.codes)) if self.codes else np.zeros(len(raw), bool)
        if math.isfinite(self.first_code):
            coded |= raw >= self.first_code
        valid = ~coded & (values >= self.lowest) & (values <= self.highest)
        inside = np.flatnonzero(valid & good)
        last_inside = -1
        before: float | None = None
        for row in np.flatnonzero(~valid & good):  # few, as most values are in their range
            place = int(np.searchsorted(inside, row)) - 1
            if place > last_inside:
                before, last_inside = float(values[inside[place]]), place
            reason = self.objection(raw[row].item(), float(values[row]), before)
            if reason:
                said[reason] += 1
            else:
                valid[row] = True
                before = float(values[row])
                said[self.beyond] += 1
        return valid


def _range_of(signal: DbcSignal, field: SignalField) -> tuple[tuple[float, float, str] | None, str]:
    """The range that a database gives, widened by half a step, and its text; None with the reason where it contradicts
    the signal's own scale and offset."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None, ""
    lowest, highest = float(signal.minimum), float(signal.maximum)
    text = f"[{signal.minimum}, {signal.maximum}]"
    slack = 0.5 * abs(field.scale)
    least, most = field.representable
    if field.is_float:
        return (lowest, highest, text), ""
    counts = (lowest, highest) in (field.raw_range, (0.0, float(field.raw_range[1])))
    if lowest < least - 2 * slack or highest > most + 2 * slack or (counts and (field.scale, field.offset) != (1, 0)):
        return None, (
            f"range {text} of {signal.name} is not used: with its scale {field.scale:g} and offset {field.offset:g} "
            f"it goes from {least:g} to {most:g}"
        )
    if (lowest, highest) == (0.0, 1.0) and field.length > 1 and signal.unit:
        return None, f"range {text} of {signal.name} is not used: it has {field.length} bits and a unit"
    return (lowest - slack, highest + slack, text), ""
