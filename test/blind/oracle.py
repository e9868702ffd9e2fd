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

    gain: float  # that the least of the effects adds to the others; the smaller of training and held-out gain
    left: dict[str, float]  # of each signal's error on held-out recordings, the share that is left after the fit

    @property
    def detectable(self) -> bool:
        return self.gain >= DETECTABLE


def ask(case: Path, report: Path, effects: list[str]) -> None:
    """`vsense explain … --assume EFFECT…`: the tool told the answer, and left with the fitting; of several effects also
    all but each."""
    for folder, assumed in _reports(report, effects).items():
        tool.explain(case, folder, *(word for effect in assumed for word in ("--assume", effect)), hidden=None)


def best(report: Path, effects: list[str]) -> Best | None:
    """From the answers that `ask` has left in `report`; None where there is none."""
    answer = tool.earlier(report)
    if not answer or not answer.explain.get("effects"):
        return None
    gain, *without = (_gain(folder, assumed) for folder, assumed in _reports(report, effects).items())
    errors = reading.errors(answer.explain)
    left = {signal: after / before for signal, (before, after) in errors.items() if before > 0}
    return Best(gain - max([0.0, *without]), left)


def _reports(report: Path, effects: list[str]) -> dict[Path, list[str]]:
    """Where it is told what: all effects, and of several all but each."""
    rest = {report / f"without_{one}": [other for other in effects if other != one] for one in effects}
    return {report: effects} | (rest if len(effects) > 1 else {})


def _gain(report: Path, effects: list[str]) -> float:
    answer = tool.earlier(report)
    found = answer.explain.get("effects", [])[: len(effects)] if answer else []
    return max((reading.gain(effect) for effect in found), default=0.0)
