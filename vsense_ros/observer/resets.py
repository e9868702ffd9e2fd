"""Where GNSS goes on somewhere else, for long and steadily, and nobody contradicts it, it is the filter that is wrong:
place or velocity are moved there, once, and that is told; nothing else is touched.

A position that is drawn there by its covariance instead would pull at velocity, heading and biases, for minutes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Event
from vsense_ros.model.coordinates import SPIN, YAW, X, Y
from vsense_ros.model.sensors import SensorBase, Tells
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.state import FORWARD, LATERAL, U

Array = NDArray[np.float64]

_KEPT = 64  # refused measurements that are looked at
_STEADY = 0.2  # scatter of what they differ by, as a share of it, or
_EXPECTED = 2.0  # in standard deviations of what is expected, up to which they agree with each other
_SPIN = 2.0  # [rad/s] standard deviation of the spin of a wheel once the speed has been moved
_SPEED: frozenset[Tells] = frozenset({"rolling speed", "ground speed"})
_MOTION: frozenset[Tells] = _SPEED | {"position"}  # what contradicts a speed


class Resets:
    """Of one car; `told` are stamp [ns] and sentence of all resets, newest last."""

    def __init__(self, car: CarBlocks, intake: Intake[SensorBase]) -> None:
        self._car, self._intake = car, intake
        self._differences: dict[int, list[tuple[Array, Array]]] = {}
        self._asked: list[tuple[int, float, float]] = []
        self.told: list[tuple[int, str]] = []

    def forget(self) -> None:
        """The filter begins anew."""
        self._differences.clear()
        self._asked.clear()

    def tell(self, stamp: int, sentence: str) -> None:
        """Something was reset."""
        self.told.append((stamp, sentence))

    @property
    def waiting(self) -> bool:
        """Whether anything is to be moved."""
        return bool(self._asked)

    def asked(self) -> Iterator[tuple[int, float, float]]:
        """Elements of the state that are to be moved, by how much, and their standard deviations afterwards; once."""
        asked, self._asked = self._asked, []
        return iter(asked)

    def refused(self, event: Event, innovation: Innovation) -> None:
        """A measurement was refused."""
        if not self._intake.sensors[event.sensor].tells & {"position", "course"}:
            return
        kept = self._differences.setdefault(event.sensor, [])
        if self._intake.health[event.sensor].refused_in_a_row <= 1:
            kept.clear()
        factor = innovation.factor
        kept.append((factor @ innovation.whitened, np.sqrt(np.sum(factor**2, axis=1))))
        del kept[:-_KEPT]

    def is_alone(self, index: int) -> bool:
        """Whether nobody who is believed tells what a sensor tells; of a speed, positions do too, by and by."""
        sensors, health = self._intake.sensors, self._intake.health
        tells = sensors[index].tells
        if tells & _SPEED:
            tells = tells | _MOTION
        others = (
            i
            for i, sensor in enumerate(sensors)
            if i != index and not sensor.is_input and sensor.tells & tells and self._intake.sends(i)
        )
        return all(health[i].refused_in_a_row for i in others)

    def ask(self, event: Event, now: int, name: str) -> bool:
        """Whether place or velocity are moved to where a sensor says they are."""
        tells = self._intake.sensors[event.sensor].tells
        if not tells & {"position", "course"}:
            return False
        found = self._difference(event.sensor)
        if found is None:
            return True  # refused on: what scatters so much is nowhere
        difference, deviation = found
        far = float(np.hypot(*difference))
        if "position" in tells:
            moves = [(i, by, sd) for i, by, sd in zip((X, Y), difference.tolist(), deviation.tolist(), strict=True)]
            what = f"position moved by {far:.1f} m"
        else:
            yaw, spread = self._car.mean.item(YAW), float(deviation.max())
            forward, left = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ difference
            moves = [(FORWARD, float(forward), spread), (LATERAL, float(left), spread)]
            spins = self._car.mean[U][SPIN]
            speed = max(self._car.mean.item(FORWARD), 1.0)
            moves += [
                (U.start + SPIN.start + i, float(forward) / speed * spin, _SPIN)
                for i, spin in enumerate(spins.tolist())
            ]
            what = f"velocity moved by {far:.1f} m/s"
        self._asked += moves
        self._intake.health[event.sensor].refused_in_a_row = 0
        self._differences.pop(event.sensor)
        self.tell(now, f"{what} to where {name} says it is")
        return True

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
