"""What could be known at best: the true effect fitted, by the tool's own machinery. The one place where it is asked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from blind import reading, tool

DETECTABLE = (
    0.03  # gain on training and held-out manoeuvres that nothing-hidden recordings do not give (mismatch study)
)


@dataclass(frozen=True)
class Best:
    """The fit with the true effects."""

    gain: float  # the smaller of training and held-out gain; relative decrease of the misfit
    errors: dict[str, float]  # of each signal on held-out recordings, after the fit

    @property
    def detectable(self) -> bool:
        return self.gain >= DETECTABLE


def ask(case: Path, report: Path, effects: list[str]) -> None:
    """`vsense explain … --assume EFFECT…`: the tool told the answer, and left with the fitting."""
    tool.explain(case, report, *(word for effect in effects for word in ("--assume", effect)), hidden=None)


def best(report: Path, effects: list[str]) -> Best | None:
    """From the answer that `ask` has left in `report`; None where there is none."""
    answer = tool.earlier(report)
    found = answer.explain.get("effects", [])[: len(effects)] if answer else []
    if not answer or not found:
        return None
    after = {signal: after for signal, (_, after) in reading.errors(answer.explain).items()}
    return Best(max(reading.gain(effect) for effect in found), after)
