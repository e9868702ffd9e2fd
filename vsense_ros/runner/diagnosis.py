"""What a runner says of itself and of its sensors, in the lines of diagnostics."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from vsense_ros.estimation.intake import Intake
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.model.sensors import SensorBase
from vsense_ros.runner.adapter import Adapter
from vsense_ros.runner.guard import Guard
from vsense_ros.runner.judge import Judges
from vsense_ros.runner.placement import Place, Placement
from vsense_ros.runner.receiver_judge import noisier_in_words
from vsense_ros.runner.resets import Resets
from vsense_ros.runner.vote import Vote

_NEWS = 5_000_000_000  # [ns] for which a reset is reported


class Diagnosed(Protocol):
    """What a runner has that its diagnostics tell of."""

    adapter: Adapter
    sensors: dict[str, SensorBase]
    names: tuple[str, ...]
    intake: Intake
    vote: Vote
    judges: Judges
    guard: Guard
    resets: Resets
    placement: Placement | None
    started: bool
    faults: int
    restarts: int

    @property
    def stamp(self) -> int:
        """Time of the newest state [ns]."""

    @property
    def heading_known(self) -> bool:
        """True once the direction of the car on the map is known."""

    @property
    def converged(self) -> bool:
        """True once the estimates are known well enough to be used."""


def lines(runner: Diagnosed, now: int) -> list[Diagnostic]:
    """One line for the observer and one for each sensor; `now` [ns] on the clock of arrivals."""
    diagnostics = [_own_line(runner), *runner.adapter.diagnostics()]
    for i, ((name, sensor), health) in enumerate(zip(runner.sensors.items(), runner.intake.health, strict=True)):
        line = health.diagnostic(name, sensor, now)
        figures = {what: value for judge in runner.judges for what, value in judge.figures(i).items()}
        diagnostics.append(_sensor_line(runner, i, replace(line, values={**line.values, **figures})))
    return diagnostics


def _own_line(runner: Diagnosed) -> Diagnostic:
    """How far the filter has come, what it goes without, and what was reset."""
    values = {**runner.adapter.details, "faults": str(runner.faults), "restarts": str(runner.restarts)}
    if not runner.started:
        if runner.guard.failures:
            return Diagnostic("observer", Level.ERROR, f"diverged: {runner.guard.failures[-1][1]}", values)
        return Diagnostic("observer", Level.WARN, runner.adapter.waiting(), values)
    converged = runner.converged
    condition = runner.adapter.condition(converged)
    if not runner.heading_known:
        return Diagnostic("observer", Level.WARN, condition, values)
    doubts = [*runner.adapter.doubts, *(f"without {axes.name(axis)}" for axes, axis, _ in runner.vote.out)]
    for judge in runner.judges:
        doubts += [*judge.doubts, *(f"without {runner.names[index]}" for index in judge.out)]
    if runner.placement is not None:
        place = runner.placement.at(runner.stamp)
        if place is not Place.KNOWN:
            doubts.append(place.value)
        if place in (Place.RECKONED, Place.LOST):
            values["without position"] = f"{runner.placement.age(runner.stamp):.1f} s"
    if runner.resets.reported:
        stamp, sentence = runner.resets.reported[-1]
        values["resets"] = str(len(runner.resets.reported))
        if runner.stamp - stamp < _NEWS:
            doubts.append(sentence)
    level = Level.OK if converged and not doubts else Level.WARN
    return Diagnostic("observer", level, ", ".join([condition, *doubts]), values)


def _sensor_line(runner: Diagnosed, index: int, line: Diagnostic) -> Diagnostic:
    """The line of a sensor, with its axes that are not believed or absent."""
    axes = runner.vote.axes.get(index)
    if line.level == Level.STALE:
        return line
    for judge in runner.judges:
        if index in judge.out:
            return Diagnostic(line.name, judge.level, f"not believed: {judge.why}", line.values)
    parts = [f"{axes.words[axis]} {out.why}" for axis, out in axes.out.items()] if axes is not None else []
    if parts:
        return Diagnostic(line.name, max(Level.WARN, line.level), f"not believed: {', '.join(parts)}", line.values)
    if line.level != Level.OK:
        return line
    absent = axes.absent if axes is not None and axes.sums.begun else _absent(runner, index, begun=axes is None)
    doubts = [f"without {', '.join(absent)}"] if absent else []
    doubts += noisier_in_words(runner.intake.sensors[index].components, runner.intake.health[index].noisier)
    said = runner.intake.doubt(index), runner.adapter.doubt(line.name), *(j.doubt(index) for j in runner.judges)
    doubts += [doubt for doubt in said if doubt]
    return Diagnostic(line.name, Level.WARN, ", ".join(["in use", *doubts]), line.values) if doubts else line


def _absent(runner: Diagnosed, index: int, *, begun: bool) -> list[str]:
    """Names of the components of a sensor that do not come any more; while the filter has not begun to use it, of those
    that do not come."""
    sensor, health = runner.intake.sensors[index], runner.intake.health[index]
    absent = health.absent(sensor) if begun else health.lacking(sensor)
    return [sensor.components[one].words for one in absent] if sensor.components else []
