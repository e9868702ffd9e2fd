"""What could be known at best: the true effect fitted, by the tool's own machinery; of what the tool has no effect for,
the same drive without it. The one place where that is asked."""

from __future__ import annotations

from dataclasses import dataclass, field
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
    adds: dict[str, float] = field(default_factory=dict)  # by effect, what it adds to all others

    @property
    def detectable(self) -> bool:
        return self.gain >= DETECTABLE

    def detects(self, effect: str) -> bool:
        """True if one of several effects adds enough to the others."""
        return self.adds.get(effect, 0.0) >= DETECTABLE


def ask(case: Path, report: Path, effects: list[str]) -> None:
    """`vsense explain … --assume EFFECT…`: the tool told the answer, and left with the fitting; of several effects also
    all but each."""
    for folder, assumed in _reports(report, effects).items():
        tool.explain(case, folder, *(word for effect in assumed for word in ("--assume", effect)), hidden=None)


def best(report: Path, effects: list[str]) -> Best | None:
    """From the answers that `ask` has left in `report`; None where there is none."""
    answer = tool.earlier(report)
    if not answer or not reading.effects(answer.explain):
        return None
    gains, *without = (_gains(folder, assumed) for folder, assumed in _reports(report, effects).items())
    errors = reading.errors(answer.explain)
    left = {signal: after / before for signal, (before, after) in errors.items() if before > 0}
    adds = {
        effect: min(all_of_them - max(others, 0.0) for all_of_them, others in zip(gains, one, strict=True))
        for effect, one in zip(effects, without or [(0.0, 0.0)], strict=True)
    }
    return Best(min(adds.values()), left, adds)


def ask_without(twin: Path, report: Path) -> None:
    """`vsense explain` of the same car, driver and sensors with nothing hidden."""
    tool.explain(twin, report, hidden=None)


def best_without(answer: tool.Answer, report: Path) -> Best | None:
    """What one gains who knows what is outside the library to its last detail: how much less the refitted model leaves
    over, in training, where it is not there. None where the twin or the tool's `answer` has no fit."""
    twin = tool.earlier(report)
    left = [reading.misfit(each.explain) for each in (answer, twin) if each]
    with_it, without = left if len(left) == 2 else (None, None)
    if with_it is None or without is None:
        return None
    return Best((with_it**2 - without**2) / max(with_it**2, 1.0), {})


def _reports(report: Path, effects: list[str]) -> dict[Path, list[str]]:
    """Where it is told what: all effects, and of several all but each."""
    rest = {report / f"without_{one}": [other for other in effects if other != one] for one in effects}
    return {report: effects} | (rest if len(effects) > 1 else {})


def _gains(report: Path, effects: list[str]) -> tuple[float, float]:
    """What they gain together on training and on held-out manoeuvres."""
    answer = tool.earlier(report)
    found = reading.effects(answer.explain)[: len(effects)] if answer else ()
    return max(map(reading.gains, found), key=min, default=(0.0, 0.0))
