"""When a filter is moved to where a sensor says it is, with a filter and sensors that are as small as can be."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vsense_ros.runner.adapter import Move
from vsense_ros.runner.resets import Resets

POSITION, VELOCITY, WHEELS, GYRO = 0, 1, 2, 3
MEASURED = ({"position"}, {"ground speed", "course"}, {"rolling speed"}, {"yaw rate"})


class SmallAdapter:
    """Compares places and velocities on the map, and can be moved in both."""

    heading_element: int | None = None
    unused: str = ""
    sensors = dict.fromkeys(("position", "velocity", "wheels", "gyro"))

    def uses(self, sensor: str) -> bool:
        return sensor != self.unused

    def __init__(self, moves: bool = True) -> None:
        self._moves = moves

    def difference(self, event: SimpleNamespace, innovation: object) -> object:
        return event.difference

    def moves(self, sensor: SimpleNamespace, difference: np.ndarray, deviation: np.ndarray) -> list[Move]:
        return [Move(i, float(difference[i]), float(deviation[i])) for i in range(2)] if self._moves else []


def resets(moves: bool = True, sends: tuple[bool, ...] = (True,) * 4) -> tuple[Resets, SimpleNamespace]:
    sensors = [SimpleNamespace(measures=frozenset(one), is_input=False) for one in MEASURED]
    health = [SimpleNamespace(refused_in_a_row=2) for _ in MEASURED]
    intake = SimpleNamespace(sensors=sensors, health=health, sends=lambda i: sends[i])
    return Resets(SmallAdapter(moves), intake), intake  # type: ignore[arg-type]


def refused(sensor: int, *difference: float, deviation: float = 1.0) -> SimpleNamespace:
    found = (np.array(difference), np.array([deviation, deviation])) if difference else None
    return SimpleNamespace(sensor=sensor, difference=found, value=np.full(2, np.nan))


@given(east=st.floats(-100, 100), north=st.floats(-100, 100))
def test_the_filter_is_moved_by_the_median_of_what_was_refused_once(east, north):
    made, intake = resets()
    for noise in (-0.1, 0.0, 0.1, 0.05, -0.05):
        made.refused(refused(POSITION, east + noise, north - noise), None)
    assert not made.waiting
    assert made.ask(refused(POSITION), 7, "gps/fix")
    assert made.waiting
    moves = list(made.asked())
    assert [move.by for move in moves] == pytest.approx([east, north])
    assert [move.deviation for move in moves] == [1.0, 1.0]
    assert not made.waiting
    assert list(made.asked()) == []
    far = float(np.hypot(east, north))
    assert made.reported == [(7, f"position moved by {far:.1f} m to where gps/fix says it is")]
    assert intake.health[POSITION].refused_in_a_row == 0


def test_a_velocity_is_said_to_be_one():
    made, _ = resets()
    made.refused(refused(VELOCITY, 3.0, 4.0), None)
    made.ask(refused(VELOCITY), 7, "gps/velocity")
    assert made.reported == [(7, "velocity moved by 5.0 m/s to where gps/velocity says it is")]


@pytest.mark.parametrize(("scatter", "followed"), [(10.0, True), (25.0, False)])
def test_what_scatters_by_more_than_a_fifth_is_not_followed(scatter, followed):
    made, _ = resets()
    for sign in (1.0, -1.0, 1.0, -1.0):
        made.refused(refused(POSITION, 100.0, scatter * sign), None)
    assert made.ask(refused(POSITION), 7, "gps/fix")
    assert made.waiting == followed
    assert bool(made.reported) == followed


def test_scatter_that_is_expected_does_not_matter():
    made, _ = resets()
    for sign in (1.0, -1.0, 1.0, -1.0):
        made.refused(refused(POSITION, 10.0, 20.0 * sign, deviation=8.0), None)
    made.ask(refused(POSITION), 7, "gps/fix")
    assert made.waiting


def test_refusals_before_one_that_was_believed_do_not_count():
    made, intake = resets()
    made.refused(refused(POSITION, 50.0, 0.0), None)
    intake.health[POSITION].refused_in_a_row = 1
    made.refused(refused(POSITION, 10.0, 0.0), None)
    made.ask(refused(POSITION), 7, "gps/fix")
    assert [move.by for move in made.asked()] == [10.0, 0.0]


def test_only_the_newest_refusals_count():
    made, _ = resets()
    for i in range(164):
        made.refused(refused(POSITION, 50.0 if i < 100 else 51.0, 0.0), None)
    made.ask(refused(POSITION), 7, "gps/fix")
    assert [move.by for move in made.asked()] == [51.0, 0.0]


def test_what_measures_neither_place_nor_course_moves_nothing():
    made, _ = resets()
    made.refused(refused(WHEELS, 50.0, 0.0), None)
    assert not made.ask(refused(WHEELS), 7, "wheels")
    fixed, _ = resets(moves=False)
    fixed.refused(refused(POSITION, 50.0, 0.0), None)
    assert not fixed.ask(refused(POSITION), 7, "gps/fix")
    assert not fixed.waiting


def test_without_a_difference_that_is_known_nothing_is_moved():
    made, _ = resets()
    made.refused(refused(POSITION), None)
    made.refused(refused(POSITION, np.nan, 1.0), None)
    assert made.ask(refused(POSITION), 7, "gps/fix")
    assert not made.waiting


def test_a_filter_that_begins_anew_has_forgotten_what_was_refused():
    made, _ = resets()
    made.refused(refused(POSITION, 50.0, 0.0), None)
    made.forget()
    made.ask(refused(POSITION), 7, "gps/fix")
    assert not made.waiting
    made.refused(refused(POSITION, 50.0, 0.0), None)
    made.ask(refused(POSITION), 7, "gps/fix")
    made.forget()
    assert not made.waiting


def test_a_sensor_is_alone_where_all_others_that_measure_the_same_are_refused_or_silent():
    made, intake = resets()
    assert made.is_alone(GYRO)  # nobody else measures a yaw rate
    assert made.is_alone(VELOCITY)
    intake.health[WHEELS].refused_in_a_row = 0
    assert made.is_alone(POSITION)  # wheels measure no place
    assert not made.is_alone(VELOCITY)
    silent, intake = resets(sends=(True, True, False, True))
    intake.health[WHEELS].refused_in_a_row = 0
    assert silent.is_alone(VELOCITY)
    intake.health[POSITION].refused_in_a_row = 0
    assert not silent.is_alone(VELOCITY)  # a place that goes on contradicts a speed
    intake.sensors[POSITION].is_input = True
    assert silent.is_alone(VELOCITY)


def test_a_sensor_that_the_filter_does_not_use_contradicts_nothing() -> None:
    made, intake = resets()
    for index in (POSITION, WHEELS):
        intake.health[index].refused_in_a_row = 0 if index == POSITION else 1
    assert not made.is_alone(VELOCITY)
    made._adapter.unused = "position"  # type: ignore[attr-defined]
    assert made.is_alone(VELOCITY)


def test_velocities_that_differ_by_an_angle_turn_the_filter_and_do_not_move_it() -> None:
    made, intake = resets()
    made._adapter.heading_element = 2
    turned = np.exp(1j * np.radians(13.0))
    for speed in (1.0, 3.0, 6.0, 9.0, 12.0, 15.0):  # along a course that changes; the first is too slow to show one
        expected = speed * np.exp(0.1j * speed)
        made.refused(measured(turned * expected, expected), None)
    assert made.ask(refused(VELOCITY), 7, "gps/velocity")
    assert list(made.asked()) == [Move(2, pytest.approx(np.radians(13.0)), 0.05)]
    assert made.reported == [(7, "heading turned by 13° to that of gps/velocity")]
    assert intake.health[VELOCITY].refused_in_a_row == 0


@given(turns=st.lists(st.floats(-0.09, 0.09) | st.just(3.0), min_size=5, max_size=9))
def test_velocities_that_do_not_agree_on_an_angle_turn_nothing(turns: list[float]) -> None:
    assume(abs(np.median(turns)) < 0.1)
    made, _ = resets()
    made._adapter.heading_element = 2
    for turn in turns:
        made.refused(measured(9.0 * np.exp(1j * turn), 9.0), None)
    made.ask(refused(VELOCITY), 7, "gps/velocity")
    assert 2 not in [move.element for move in made.asked()]


def measured(velocity: complex, expected: complex) -> SimpleNamespace:
    """A refused velocity with what was expected of it, as complex numbers east + north i."""
    apart = velocity - expected
    event = refused(VELOCITY, apart.real, apart.imag, deviation=0.1)
    event.value = np.array([velocity.real, velocity.imag])
    return event
