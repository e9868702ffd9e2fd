"""Resets: where GNSS goes on somewhere else, for long and steadily, and no other sensor contradicts it, the filter is
wrong, and its place or velocity is moved there, once; that is reported, and nothing else is touched.

A position that is drawn there by its covariance instead would pull at velocity, heading and biases, for minutes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Event
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase
from vsense_ros.runner.adapter import Adapter, Move
from vsense_ros.runner.turns import Turns

Array = NDArray[np.float64]

_KEPT = 64  # refused measurements that are looked at
_STEADY = 0.2  # scatter of what they differ by, as a share of it, or
_EXPECTED = 2.0  # in standard deviations of what is expected, up to which they agree with each other
_SPEED: frozenset[MeasuredQuantity] = frozenset({"rolling speed", "ground speed"})
_MOTION: frozenset[MeasuredQuantity] = _SPEED | {"position"}  # what contradicts a speed


class Resets:
    """Resets of one filter; `reported` are stamp [ns] and sentence of all of them, newest last."""

    def __init__(self, adapter: Adapter, intake: Intake[SensorBase]) -> None:
        self._adapter, self._intake = adapter, intake
        self._differences: dict[int, list[tuple[Array, Array]]] = {}
        self._turns: dict[int, Turns] = {}
        self._asked: list[Move] = []
        self.reported: list[tuple[int, str]] = []

    def forget(self) -> None:
        """The filter begins anew."""
        self._differences.clear()
        self._turns.clear()
        self._asked.clear()

    def report(self, stamp: int, sentence: str) -> None:
        """Something was reset."""
        self.reported.append((stamp, sentence))

    @property
    def waiting(self) -> bool:
        """True if anything is to be moved."""
        return bool(self._asked)

    def asked(self) -> Iterator[Move]:
        """The jumps that are to be made, once."""
        asked, self._asked = self._asked, []
        return iter(asked)

    def refused(self, event: Event, innovation: Innovation) -> None:
        """A measurement was refused."""
        if not self._intake.sensors[event.sensor].measures & {"position", "course"}:
            return
        difference = self._adapter.difference(event, innovation)
        if difference is None:
            return
        kept = self._differences.setdefault(event.sensor, [])
        if self._intake.health[event.sensor].refused_in_a_row <= 1:
            kept.clear()
            self._turns.pop(event.sensor, None)
        kept.append(difference)
        del kept[:-_KEPT]
        if "course" in self._intake.sensors[event.sensor].measures:
            measured = event.value[:2]
            self._turns.setdefault(event.sensor, Turns()).add(measured, measured - difference[0])

    def is_alone(self, index: int) -> bool:
        """True if no sensor that the filter uses and believes measures what this one does; a speed is measured by
        positions, too, by and by."""
        sensors, health = self._intake.sensors, self._intake.health
        measured = sensors[index].measures
        if measured & _SPEED:
            measured = measured | _MOTION
        others = (
            i
            for i, (name, sensor) in enumerate(zip(self._adapter.sensors, sensors, strict=True))
            if i != index and not sensor.is_input and sensor.measures & measured
            if self._intake.sends(i) and self._adapter.uses(name)
        )
        return all(health[i].refused_in_a_row for i in others)

    def ask(self, event: Event, now: int, name: str) -> bool:
        """Ask for the jump to where a sensor says the car is, or as fast as it says. False if the filter has no such
        element, or the sensor measures neither; True also while its measurements scatter too much to be followed."""
        sensor = self._intake.sensors[event.sensor]
        if not sensor.measures & {"position", "course"} or not self._adapter.moves(sensor, np.zeros(2), np.zeros(2)):
            return False
        turn, heading = self._turns.get(event.sensor), self._adapter.heading_element
        if turn is not None and heading is not None and (angle := turn.of_all()) is not None:
            self._asked.append(Move(heading, *angle))
            self._follow(event.sensor, now, f"heading turned by {np.degrees(angle[0]):.0f}° to that of {name}")
            return True
        apart = self._difference(event.sensor)
        if apart is None:
            return True  # refused on: what scatters so much is nowhere
        difference, deviation = apart
        self._asked += self._adapter.moves(sensor, difference, deviation)
        far = float(np.hypot(*difference))
        what = f"position moved by {far:.1f} m" if "position" in sensor.measures else f"velocity moved by {far:.1f} m/s"
        self._follow(event.sensor, now, f"{what} to where {name} says it is")
        return True

    def _follow(self, index: int, now: int, sentence: str) -> None:
        """The filter follows a sensor, whose refused measurements are dealt with."""
        self._intake.health[index].refused_in_a_row = 0
        self._differences.pop(index)
        self._turns.pop(index, None)
        self.report(now, sentence)

    def _difference(self, index: int) -> tuple[Array, Array] | None:
        """What the refused measurements say that the filter does not (2,), and its standard deviation (2,); None if
        they do not agree with each other."""
        kept = self._differences.get(index, ())
        known = [(d, s) for d, s in kept if np.isfinite(d).all()]
        if not known:
            return None
        differences = np.array([d for d, _ in known])
        middle, deviation = np.median(differences, axis=0), known[-1][1]
        scatter = float(np.median(np.hypot(*(differences - middle).T)))
        largest = max(_STEADY * float(np.hypot(*middle)), _EXPECTED * float(np.hypot(*deviation)))
        return (middle, deviation) if scatter <= largest else None
