"""How an observer is, in words: REP-107 statuses of the filter, its parameters and each sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.observer.placement import Place
from vsense_ros.observer.spi import Spi

if TYPE_CHECKING:
    from vsense_ros.observer.observer import Observer

_NEWS = 5_000_000_000  # [ns] for which a reset is told
_ALIKE = 0.9  # correlation of the errors of two parameters that can hardly be told apart


def of_observer(observer: Observer, now: int) -> list[Diagnostic]:
    """One line for the observer and one for each sensor; `now` [ns] on the clock of arrivals."""
    lines = [_own(observer)]
    if observer.left_out:
        lines.append(Diagnostic("effects", Level.WARN, observer.left_out))
    if isinstance(observer.filter, Spi):
        lines.append(_parameters(observer.filter))
    if observer.monitor is not None and observer.monitor.limits is not None:
        lines.append(observer.monitor.diagnostic())
    if observer.balance.sensor is not None:
        lines.append(observer.balance.diagnostic())
    for i, ((name, sensor), health) in enumerate(zip(observer.sensors.items(), observer.health, strict=True)):
        lines.append(_of_sensor(observer, i, health.diagnostic(name, sensor, now)))
    return lines


def _of_sensor(observer: Observer, index: int, line: Diagnostic) -> Diagnostic:
    """A sensor's line, and what of it is not believed or absent."""
    axes = observer.vote.axes.get(index)
    if axes is None or line.level == Level.STALE:
        return line
    parts = [f"{axes.words[axis]} {out.why}" for axis, out in axes.out.items()]
    if parts:
        return Diagnostic(line.name, max(Level.WARN, line.level), f"not believed: {', '.join(parts)}", line.values)
    if line.level != Level.OK:
        return line
    doubts = [f"without {', '.join(absent)}"] if (absent := axes.absent) else []
    if line.name == observer.tilt.sensor and (tilted := observer.tilt.sentence()):
        doubts.append(tilted)
    return Diagnostic(line.name, Level.WARN, ", ".join(["in use", *doubts]), line.values) if doubts else line


def _own(observer: Observer) -> Diagnostic:
    values = {"faults": str(observer.faults), "restarts": str(observer.restarts)}
    if not observer.started:
        missing = [n for n, h in zip(observer.names, observer.health, strict=True) if not h.last_stamp]
        text = "waiting for " + (", ".join(missing) if missing else "a speed")
        if missing and observer.waits_for_speed:
            able = (n for n, sensor in observer.sensors.items() if sensor.tells_speed)
            text += f"; nothing tells the speed, which {' or '.join(able)} would"
        return Diagnostic("observer", Level.WARN, text, values)
    if not observer.heading_known:
        moving = any(sensor.tells & {"course", "position"} for sensor in observer.sensors.values())
        silent = all(
            not observer.intake.sends(i) for i, sensor in enumerate(observer.sensors.values()) if sensor.on_map
        )
        until = "GNSS comes" if moving and silent else "the car moves" if moving else "two antennas tell it"
        return Diagnostic("observer", Level.WARN, f"heading unknown until {until}", values)
    text = "converged" if observer.converged else "converging"
    doubts = [f"without {axes.name(axis)}" for axes, axis, _ in observer.vote.out]
    if observer.placement is not None:
        place = observer.placement.at(observer.stamp)
        if place is not Place.TOLD:
            doubts.append(place.value)
        if place in (Place.RECKONED, Place.LOST):
            values["without position"] = f"{observer.placement.age(observer.stamp):.1f} s"
    if observer.resets.told:
        stamp, sentence = observer.resets.told[-1]
        values["resets"] = str(len(observer.resets.told))
        if observer.stamp - stamp < _NEWS:
            doubts.append(sentence)
    level = Level.OK if observer.converged and not doubts else Level.WARN
    return Diagnostic("observer", level, ", ".join([text, *doubts]), values)


def _parameters(spi: Spi) -> Diagnostic:
    seen = spi.observability()
    values = {
        name: f"{value:.6g} ± {deviation:.2g}, {share:.0%} of the deviation at start"
        for name, value, deviation, share in zip(seen.names, spi.values, seen.deviation, seen.share, strict=True)
    }
    values["independent combinations told"] = f"{seen.rank} of {len(seen.names)}"
    closest = np.abs(np.triu(seen.correlation, 1))
    if closest.max(initial=0.0) > _ALIKE:
        i, j = np.unravel_index(closest.argmax(), closest.shape)
        values["hard to tell apart"] = f"{seen.names[i]} and {seen.names[j]} ({seen.correlation[i, j]:+.2f})"
    if stuck := spi.at_bounds():
        return Diagnostic("parameters", Level.WARN, f"at its bound: {', '.join(stuck)}; {seen}", values)
    return Diagnostic("parameters", Level.OK, str(seen), values)
