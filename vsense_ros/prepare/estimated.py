"""A number that is not exactly known: its value, how far it may be off, and who says so."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

GIVEN = "given"  # in place of a rule, for what the user states


@dataclass(frozen=True)
class Estimated:
    """A value with its standard deviation, both in the same unit; the `rule` that it comes from, and its source."""

    value: float
    deviation: float
    rule: str = GIVEN
    source: str = "as given"

    @property
    def relative(self) -> float:
        """Standard deviation over the amount of the value, infinite for a value of zero."""
        return self.deviation / abs(self.value) if self.value else float("inf")

    def times(self, factor: float, *relative: float) -> Estimated:
        """The value times a factor, with the `relative` deviations of what the factor is made of in quadrature."""
        value = self.value * factor
        return replace(
            self, value=value, deviation=hypot(self.deviation * factor, *(value * share for share in relative))
        )

    def by(self, rule: Estimated) -> Estimated:
        """This number as a result of another rule."""
        return replace(self, rule=rule.rule, source=rule.source)
