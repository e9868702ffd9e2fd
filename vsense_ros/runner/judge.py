"""Judges of whole sensors: what they have in common, and how messages come to them before they act on the filter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.messages.diagnostic import Level
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.runner.adapter import Apart, Move, Widening

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JudgeSettings:
    """Times at which judges look: decisions of this project."""

    block: int = 40_000_000  # [ns] in which inertial messages are averaged, and wheel speeds collected
    longest: int = 1_000_000_000  # [ns] between two of them, beyond which a block begins anew
    between: int = 40_000_000  # [ns] between two judgements


JUDGES = JudgeSettings()


class Rolled(NamedTuple):
    """The wheel speeds of a block in order of arrival, at least one: their stamps [ns], the spins as they came (n, 4),
    and the newest message as far as it is believed."""

    stamps: list[int]
    spins: Array
    newest: Event


class Judge(ABC):
    """One judge; `judged` is true if the car has the sensors for it, `hears` are the places of those whose messages it
    takes one by one, `out` the places of sensors that are not believed; `why` says what for, and `level` how bad that
    is."""

    judged: bool
    hears: frozenset[int]
    why: str = ""
    level: Level = Level.WARN
    suspect: bool = False  # True while an inertial axis that seems wrong may be right, because another sensor is wrong

    def __init__(self) -> None:
        self.out: set[int] = set()

    @property
    def doubts(self) -> list[str]:
        """What is doubtful of the whole estimate, in words, besides sensors that are out."""
        return []

    @property
    def confirms(self) -> dict[tuple[int, int], int]:
        """Inertial sensors and axes of them that another sensor confirms without the model of the car, and the stamp
        [ns] of its newest message that does."""
        return {}

    @property
    def spares(self) -> frozenset[tuple[int, int]]:
        """Inertial sensors and axes of them that contradict a model of the car which is known to be wrong."""
        return frozenset()

    @property
    def apart(self) -> Apart | None:
        """How far apart the motions are that sensors measure, while it is not decided which of them are right; None
        where nothing is undecided."""
        return None

    def doubt(self, index: int) -> str:
        """What is doubtful about a sensor that is in use, in words; empty for nothing."""
        return ""

    def figures(self, index: int) -> dict[str, str]:
        """What the judge knows of a sensor in numbers, for its line of diagnostics."""
        return {}

    @abstractmethod
    def forget(self, stamp: int) -> None:
        """The filter begins anew, at a time [ns]; what is out stays out."""

    @abstractmethod
    def hear(self, event: Event) -> None:
        """Take in a message, in order of arrival; what is not believed of it is changed in it."""

    @abstractmethod
    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        """Take in the mean of an inertial sensor (6), in the axes of the car, over `h` [s] up to a time [ns]."""

    def roll(self, rolled: Rolled) -> None:  # noqa: B027
        """Take in the wheel speeds of a block, before what was felt in it."""

    def before(self, timeline: Timeline, event: Event) -> None:  # noqa: B027
        """Do what is to be done before the filter has a message: what may have changed while none came."""

    @abstractmethod
    def settle(self, timeline: Timeline) -> None:
        """Do what follows: leave a sensor out, believe it again, or move the filter."""


class Judges:
    """All judges of one car, those of `judges` that have their sensors; they hear messages before these act.

    `frozen(sensor)` are the places of axes of an inertial sensor that are frozen: they feel nothing.
    `apart` is the widest of what was undecided for any of them when they last looked; None for nothing.
    """

    def __init__(
        self, sensors: Sequence[SensorBase], judges: Iterable[Judge], frozen: Callable[[int], list[int]]
    ) -> None:
        self._frozen = frozen
        self._judges = tuple(judge for judge in judges if judge.judged)
        inertial, wheels = (place_of(sensors, what) for what in ("rates and forces", "rolling speed"))
        self._inertial, self._wheels = (inertial, wheels) if self._judges else (-1, -1)
        self._into_car = into_axes_of_car(sensors, self._inertial)
        self._listeners = {
            i: tuple(judge.hear for judge in self._judges if i in judge.hears) for i in range(len(sensors))
        }
        self._roll = tuple(judge.roll for judge in self._judges if type(judge).roll is not Judge.roll)
        self._before = tuple(judge.before for judge in self._judges if type(judge).before is not Judge.before)
        self._undecided = tuple(judge for judge in self._judges if type(judge).apart is not Judge.apart)
        self._settled = 0
        self.apart: Apart | None = None
        self._begin_block(0)

    def __iter__(self) -> Iterator[Judge]:
        return iter(self._judges)

    @property
    def suspect(self) -> bool:
        """True while an inertial axis that seems wrong may be right, because another sensor is wrong."""
        return any(judge.suspect for judge in self._judges)

    @property
    def confirms(self) -> dict[tuple[int, int], int]:
        """Inertial sensors and axes that any of them confirms, with stamps [ns]."""
        confirmed: dict[tuple[int, int], int] = {}
        for judge in self._judges:
            confirmed |= judge.confirms
        return confirmed

    @property
    def spares(self) -> frozenset[tuple[int, int]]:
        """Inertial sensors and axes that any of them spares."""
        return frozenset().union(*(judge.spares for judge in self._judges))

    def _widest(self) -> Apart | None:
        """The widest of what is undecided for any of them; None for nothing."""
        undecided = [apart for judge in self._undecided if (apart := judge.apart) is not None]
        if len(undecided) > 1:
            return Apart(*map(max, zip(*undecided, strict=True)))
        return undecided[0] if undecided else None

    def forget(self, stamp: int) -> None:
        """The filter begins anew, at a time [ns]."""
        self._begin_block(0)
        for judge in self._judges:
            judge.forget(stamp)
        self.apart = self._widest()

    def hear(self, event: Event) -> None:
        """Take in a message, in order of arrival; what is not believed of it is changed in it."""
        index, stamp, value = event.sensor, event.stamp, event.value
        if index == self._inertial:
            self._felt.append(value)
            if not 0 <= stamp - self._begun < JUDGES.block:
                self._end_block(stamp)
            return
        for hear in self._listeners[index]:
            hear(event)
        if index == self._wheels:
            self._stamps.append(stamp)
            self._spins.append(value)
            self._newest = event
            if stamp - self._begun >= JUDGES.block:  # while no inertial message comes
                self._end_block(stamp)

    def _end_block(self, stamp: int) -> None:
        """Let the judges look at what has come since the last block, at a time [ns]."""
        passed, block, stamps, spins = stamp - self._begun, self._felt, self._stamps, self._spins
        self._begin_block(stamp)
        if stamps:
            rolled = Rolled(stamps, np.array(spins), self._newest)
            for roll in self._roll:
                roll(rolled)
        if block and 0 <= passed < JUDGES.longest:
            mean = np.add.reduce(block) / len(block)
            mean[self._frozen(self._inertial)] = nan
            felt = self._into_car(mean).tolist()
            for judge in self._judges:
                judge.feel(stamp, passed * 1e-9, felt)

    def _begin_block(self, stamp: int) -> None:
        self._felt: list[Array] = []
        self._stamps: list[int] = []
        self._spins: list[Array] = []
        self._begun = stamp

    def before(self, timeline: Timeline, event: Event) -> None:
        """Let all judges do what is to be done before the filter has a message."""
        for before in self._before:
            before(timeline, event)

    def settle(self, timeline: Timeline) -> bool:
        """Let all judges do what follows, if it is time; True if they did."""
        if not self._judges or 0 <= timeline.stamp - self._settled < JUDGES.between:
            return False
        self._settled = timeline.stamp
        for judge in self._judges:
            judge.settle(timeline)
        self.apart = self._widest()
        return True


def into_axes_of_car(sensors: Sequence[SensorBase], place: int) -> Callable[[Array], Array]:
    """What brings a reading (6,) of the inertial sensor at a place into the axes of the car; no change without one."""
    if place < 0:
        return lambda value: value
    sensor = sensors[place]
    turn = sensor.in_axes_of_car(np.eye(6)).T
    if np.array_equal(turn, np.eye(6)):
        return lambda value: value
    return lambda value: turn @ value if isfinite(value.dot(value)) else sensor.in_axes_of_car(value[None])[0]


def widening_event(channel: int, stamp: int, widening: Widening) -> Event:
    """The event on a channel by hand that widens an element of the state at a time [ns]."""
    return Event(channel, stamp, np.array(widening), np.zeros(len(widening)), counted=True)


def moving_event(channel: int, stamp: int, move: Move) -> Event:
    """The event on a channel by hand that moves an element of the state at a time [ns]."""
    return Event(channel, stamp, np.array(move), np.zeros(len(move)), counted=True)
