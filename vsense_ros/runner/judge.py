"""What judges of whole sensors have in common: they hear every message before it acts on the filter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import SensorBase
from vsense_ros.runner.adapter import Widening

Array = NDArray[np.float64]


class Judge(ABC):
    """One judge; `judged` is true if the car has the sensors for it, `out` are the places of sensors that are not
    believed, and `why` says what for."""

    judged: bool
    why: str = ""
    suspect: bool = False  # True while an inertial axis that seems wrong may be right, because another sensor is wrong

    def __init__(self) -> None:
        self.out: set[int] = set()

    @property
    def doubts(self) -> list[str]:
        """What is doubtful of the whole estimate, in words, besides sensors that are out."""
        return []

    def doubt(self, index: int) -> str:
        """What is doubtful about a sensor that is in use, in words; empty for nothing."""
        return ""

    @abstractmethod
    def forget(self, stamp: int) -> None:
        """The filter begins anew, at a time [ns]; what is out stays out."""

    @abstractmethod
    def hear(self, event: Event) -> None:
        """Take in a message, in order of arrival; what is not believed of it is changed in it."""

    @abstractmethod
    def settle(self, timeline: Timeline) -> None:
        """Do what follows: leave a sensor out, believe it again, or move the filter."""


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
