"""The signs of a filter that has diverged, each just within and just beyond its limit."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from vsense_ros.runner.guard import GUARD, Guard, Vitals

SECOND = 1_000_000_000
LOOK = round(GUARD.between_looks * SECOND)


class Belief:
    def __init__(self) -> None:
        self.covariance = np.eye(2)


class Kept:
    def __init__(self, memory: np.ndarray) -> None:
        self.memory = memory.copy()


class SmallFilter:
    """As much of a filter as the guard asks for."""

    def __init__(self) -> None:
        self.memory = np.zeros(3)
        self.inflated = 0
        self.state = Belief()

    def backup(self) -> Kept:
        return Kept(self.memory)

    def belief(self) -> Belief:
        return self.state

    def inflate(self) -> None:
        self.inflated += 1


@pytest.fixture
def filtered() -> SmallFilter:
    return SmallFilter()


@pytest.fixture
def guard(filtered: SmallFilter) -> Guard:
    made = Guard(filtered)  # type: ignore[arg-type]
    made.begin(10 * SECOND)
    return made


def vitals(i: int = 0, **changes: float) -> Vitals:
    """A sane state whose forces are others at each look."""
    return Vitals(0.02, 0.1, 20.0, 0.1, 1.0, (np.array([float(i), 1.0]),))._replace(**changes)  # type: ignore[arg-type]


def looks(guard: Guard, count: int, first: int = 1, **changes: float) -> list[str]:
    return [guard.look(10 * SECOND + (first + i) * LOOK, vitals(first + i, **changes)) for i in range(count)]


def test_a_sane_state_shows_nothing(guard):
    assert not any(looks(guard, 100))


def test_it_is_time_to_look_ten_times_a_second_and_after_the_clock_was_set_back(guard):
    assert not guard.due(10 * SECOND)
    assert not guard.due(10 * SECOND + LOOK - 1)
    assert guard.due(10 * SECOND + LOOK)
    guard.look(10 * SECOND + LOOK, vitals())
    assert not guard.due(10 * SECOND + 2 * LOOK - 1)
    assert guard.due(9 * SECOND)


@pytest.mark.parametrize(("tilt", "said"), [(radians(59), ""), (radians(61), "lean by 61°, where 60° is the most")])
def test_a_car_on_its_side_is_a_sign(guard, tilt, said):
    (text,) = looks(guard, 1, tilt=tilt)
    assert said in text
    assert bool(text) == bool(said)


def test_a_road_that_stays_too_steep_is_a_sign_and_one_that_is_so_for_a_moment_is_none(guard):
    assert not any(looks(guard, 9, steepness=1.2))
    assert not any(looks(guard, 1, 10, steepness=0.9))
    found = looks(guard, 10, 11, steepness=1.2)
    assert not any(found[:9])
    assert found[9] == "the road would be 1.2 times as steep as roads are"


@pytest.mark.parametrize(("deviation", "sign"), [(9.9, False), (10.1, True)])
def test_a_speed_that_is_not_known_is_a_sign_after_five_seconds(guard, deviation, sign):
    assert not any(looks(guard, 50, speed_deviation=deviation))
    assert ("speed is only known to 10.1 m/s" in looks(guard, 1, 51, speed_deviation=deviation)[0]) == sign


@pytest.mark.parametrize(("speed", "sign"), [(1.1, True), (-1.1, True), (0.9, False)])
def test_numbers_that_stay_the_same_while_the_car_moves_are_a_sign(guard, speed, sign):
    same = (np.array([3.0, np.nan]),)
    found = [guard.look(11 * SECOND + i * LOOK, vitals(speed=speed)._replace(changing=same)) for i in range(12)]
    assert not any(found[:10])
    assert ("forces have not changed for 1.0 s" in found[10]) == sign


def test_numbers_that_change_in_between_are_no_sign(guard):
    for i in range(40):
        changing = (np.array([float(i // 9)]),)
        assert not guard.look(11 * SECOND + i * LOOK, vitals()._replace(changing=changing))


def test_vertical_forces_that_stay_the_same_are_a_sign_though_others_change(guard):
    stuck = np.full(4, 3000.0)
    looked = [vitals()._replace(changing=(np.array([float(i)]), stuck)) for i in range(12)]
    found = [guard.look(11 * SECOND + i * LOOK, one) for i, one in enumerate(looked)]
    assert not any(found[:10])
    assert "forces have not changed for 1.0 s" in found[10]


@pytest.mark.parametrize(("load", "speed", "sign"), [(0.0, 20.0, True), (0.05, 20.0, False), (0.0, 0.5, False)])
def test_tyres_that_carry_nothing_while_the_car_moves_are_a_sign_after_half_a_second(guard, load, speed, sign):
    """A car that jumps flies for less."""
    found = looks(guard, 6, load=load, speed=speed)
    assert not any(found[:5])
    assert ("no tyre would have touched the road for 0.6 s" in found[5]) == sign


def test_a_state_of_a_car_that_flies_is_not_kept(guard, filtered):
    looks(guard, 1)
    filtered.memory[:] = 5.0
    guard.look(11 * SECOND, vitals(1, load=0.0))
    assert guard.restore(11 * SECOND) == pytest.approx(0.9)
    assert filtered.memory[0] == 0.0


def test_a_covariance_that_is_none_is_a_sign_at_every_tenth_look(guard, filtered):
    filtered.state.covariance = np.diag([1.0, -1.0])
    found = looks(guard, 10)
    assert not any(found[:9])
    assert "covariance" in found[9]


@pytest.mark.parametrize(
    ("changes", "kept"),
    [
        ({}, True), ({"tilt": radians(29)}, True), ({"tilt": radians(31)}, False), ({"steepness": 0.49}, True),
        ({"steepness": 0.51}, False), ({"speed_deviation": 4.9}, True), ({"speed_deviation": 5.1}, False),
    ],
)  # fmt: skip
def test_a_state_within_half_of_the_limits_is_kept_to_go_back_to(guard, filtered, changes, kept):
    filtered.memory[:] = 7.0
    looks(guard, 1, **changes)
    filtered.memory[:] = 8.0
    age = guard.restore(10 * SECOND + LOOK + 2 * SECOND)
    assert age == (pytest.approx(2.0) if kept else None)
    assert filtered.memory[0] == (7.0 if kept else 8.0)
    assert filtered.inflated == kept


def test_a_state_that_repeats_itself_is_not_kept(guard, filtered):
    looks(guard, 1)
    filtered.memory[:] = 5.0
    guard.look(11 * SECOND, vitals(1))
    assert guard.restore(11 * SECOND) == pytest.approx(0.9)
    assert filtered.memory[0] == 0.0


def test_what_was_kept_before_a_start_and_a_time_before_it_do_not_count(guard, filtered):
    looks(guard, 1)
    assert guard.restore(5 * SECOND) == 0.0
    guard.begin(20 * SECOND)
    assert guard.restore(21 * SECOND) is None


def test_five_recoveries_within_a_minute_are_once_too_often(guard):
    assert [guard.recovered(10 * SECOND + i * SECOND) for i in range(5)] == [True, True, True, True, False]
    guard.begin(100 * SECOND)
    assert all(guard.recovered(100 * SECOND + 16 * i * SECOND) for i in range(10))
    guard.begin(500 * SECOND)
    assert [guard.recovered(stamp * SECOND) for stamp in (500, 501, 502, 503, 499)][-1]


def test_a_filter_that_was_given_up_pauses_for_five_seconds(guard):
    assert not guard.pausing(10 * SECOND)
    guard.give_up(20 * SECOND, "why")
    assert [guard.pausing(round(t * SECOND)) for t in (19.9, 20.0, 24.9, 25.0)] == [False, True, True, False]
    assert guard.failures == [(20 * SECOND, "why")]
