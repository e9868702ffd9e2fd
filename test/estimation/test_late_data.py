"""A measurement that comes late acts at its time: any filter ends as if all had come in order, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from systems import COURSE, LINEAR, VELOCITY, VelocityKkf, YawKkf, continuous
from vsense_ros.estimation.cascade import Cascade
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.estimation.ukf import Ukf


def cascade() -> Cascade:
    filters = {"heading": Ekf(Dense(YawKkf(), [COURSE])), "velocity": Ekf(Dense(VelocityKkf(), [VELOCITY]))}
    return Cascade(filters, (), ())


FILTERS: dict[str, tuple[Callable[[], Any], tuple[str, ...], list[float]]] = {
    "extended": (lambda: Ekf(Dense(VelocityKkf(), [VELOCITY])), ("velocity",), [1.0, 0.5, 1.0, 0.5]),
    "unscented": (lambda: Ukf(VelocityKkf(), [VELOCITY]), ("velocity",), [1.0, 0.5, 1.0, 0.5]),
    "continuous": (lambda: continuous(LINEAR["heading"]), ("course",), [0.1, 0.02]),
    "cascade": (cascade, ("velocity", "course"), [0.1, 0.02, 1.0, 0.5, 1.0, 0.5]),
}
SIZE = {"velocity": 2, "course": 1}


def events(sensors: tuple[str, ...], count: int, random: np.random.Generator) -> list[Event]:
    """A measurement, then inputs every 10 ms, of which the first changes, and measurements of each sensor between."""
    found = [Event(1, 1_000_000, np.zeros(SIZE[sensors[0]]), np.ones(SIZE[sensors[0]]))]
    for i in range(1, count):
        found.append(Event(0, i * 10_000_000, 0.1 * random.normal(size=1), np.ones(1)))
        for k, sensor in enumerate(sensors, 1):
            if i % (3 * k) == 0:
                value = 0.1 * random.normal(size=SIZE[sensor])
                found.append(Event(k, i * 10_000_000 + k * 1_000_000, value, np.full(SIZE[sensor], 0.01)))
    return found


def delayed(order: list[Event], by: list[int]) -> list[Event]:
    """In the order in which they come if each is late by so many nanoseconds, but for the first."""
    arrivals = [event.stamp + late for event, late in zip(order, by, strict=True)]
    return [order[0], *(order[i] for i in sorted(range(1, len(order)), key=arrivals.__getitem__))]


def after(make: Callable[[], Any], sensors: tuple[str, ...], deviations: list[float], order: list[Event]) -> Array:
    """Memory of a filter after events in this order."""
    filter = make()
    filter.start(Gaussian(np.zeros(len(deviations)), np.diag(deviations) ** 2))
    channels = [Channel("inputs", np.inf, 0), *(Channel(sensor, 1e9) for sensor in sensors)]
    timeline = Timeline(filter, channels, reach=5.0, longest_step=0.01)
    timeline.begin(0)
    for event in order:
        timeline.add(Event(event.sensor, event.stamp, event.value, event.variance))
    timeline.catch_up()
    return np.array(filter.memory)


@pytest.mark.parametrize("name", FILTERS)
def test_late_equals_in_order_exactly(name: str) -> None:
    make, sensors, deviations = FILTERS[name]
    order = events(sensors, 60, np.random.default_rng(0))
    late = delayed(order, [130_000_000 if event.sensor else 0 for event in order])
    assert late != order
    assert (after(make, sensors, deviations, order) == after(make, sensors, deviations, late)).all()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_order_gives_the_same_bits(seed: int) -> None:
    make, sensors, deviations = FILTERS["extended"]
    random = np.random.default_rng(seed)
    order = events(sensors, 40, random)
    shuffled = delayed(order, random.integers(0, 200_000_000, size=len(order)).tolist())
    assert (after(make, sensors, deviations, order) == after(make, sensors, deviations, shuffled)).all()
