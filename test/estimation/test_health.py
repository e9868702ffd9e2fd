"""What is said of a sensor: whether it sends, is silent, comes back, or is refused."""

from __future__ import annotations

import pytest

from sources import SECOND, Gyro
from vsense_ros.estimation.health import Health
from vsense_ros.messages.diagnostic import Level

GYRO = Gyro(timeout=1.0)


def received(times: list[float], gyro: Gyro = GYRO) -> Health:
    """After messages that came at these times [s], each of which was believed."""
    health = Health()
    for time in times:
        health.receive(round(time * SECOND), gyro)
        health.last_stamp = round(time * SECOND)
    return health


def every(period: float, begin: float, end: float) -> list[float]:
    return [begin + period * i for i in range(round((end - begin) / period) + 1)]


def level(health: Health, now: float, gyro: Gyro = GYRO) -> Level:
    return health.diagnostic("gyro", gyro, round(now * SECOND)).level


def test_the_period_is_that_of_regular_messages() -> None:
    assert received(every(0.01, 1.0, 2.0)).period == pytest.approx(0.01)


def test_the_first_message_has_no_period() -> None:
    assert received([5.0]).period == 0.0


def test_messages_that_come_at_once_do_not_count_for_the_period() -> None:
    assert received([1.0, 1.1, 1.1, 1.2]).period == pytest.approx(0.1)


def test_a_period_that_changes_is_followed_slowly() -> None:
    health = received([*every(0.1, 1.0, 2.0), 2.12])
    assert health.period == pytest.approx(0.1 + 0.05 * 0.02)


def test_a_silence_does_not_count_for_the_period_and_is_when_the_sensor_came_back() -> None:
    health = received([*every(0.01, 1.0, 2.0), 3.0])
    assert health.period == pytest.approx(0.01)
    assert health.back == 3 * SECOND


@pytest.mark.parametrize(("period", "longest"), [(0.001, 0.15), (0.05, 0.5), (0.5, 1.0)])
def test_ten_periods_are_a_silence_but_neither_a_hiccup_nor_more_than_the_timeout(
    period: float, longest: float
) -> None:
    assert received(every(period, 1.0, 1.0 + 4 * period)).longest_silence(GYRO) == pytest.approx(longest)


def test_before_a_period_is_known_the_timeout_is_a_silence() -> None:
    assert Health().longest_silence(GYRO) == 1.0


def test_a_sensor_that_never_sent_is_stale() -> None:
    told = Health().diagnostic("gyro", GYRO, SECOND)
    assert (told.level, told.message) == (Level.STALE, "no message on gyro")


def test_a_sensor_that_sends_is_in_use() -> None:
    health = received(every(0.05, 1.0, 3.0))
    assert level(health, 3.4) == Level.OK
    assert level(health, 3.6) == Level.STALE
    assert "silent for 0.6 s" in health.diagnostic("gyro", GYRO, round(3.6 * SECOND)).message


def test_messages_that_cannot_be_used_are_no_use() -> None:
    health = Health()
    health.receive(SECOND, GYRO)
    health.complain("unreadable")
    told = health.diagnostic("gyro", GYRO, SECOND)
    assert (told.level, told.message) == (Level.STALE, "no usable message on gyro: unreadable")


def test_a_sensor_that_comes_back_is_doubted_for_two_silences() -> None:
    health = received([*every(0.05, 1.0, 2.0), *every(0.05, 3.0, 3.2)])  # a silence is 0.5 s
    told = health.diagnostic("gyro", GYRO, round(3.3 * SECOND))
    assert (told.level, told.message) == (Level.WARN, "back after a silence, for 0.3 s")
    settled = received([*every(0.05, 1.0, 2.0), *every(0.05, 3.0, 4.0)])
    assert level(settled, 3.95) == Level.WARN
    assert level(settled, 4.05) == Level.OK


def test_a_sensor_that_comes_and_goes_has_one_state() -> None:
    """Silent for longer than usual while it is doubted, it is not stale and back in turn, but back."""
    health = received([*every(0.05, 1.0, 2.0), *every(0.05, 3.0, 3.2)])
    assert level(health, 3.2 + 0.7) == Level.WARN
    assert level(health, 3.2 + 1.1) == Level.STALE


def test_a_sensor_that_has_never_been_silent_was_never_back() -> None:
    health = received(every(0.05, 0.05, 0.2))
    assert health.back == 0
    assert level(health, 0.3) == Level.OK


def refused(times: list[float]) -> Health:
    health = received(every(0.1, 1.0, max(times)))
    health.refused_in_a_row = len(times)
    health.refused_from, health.refused_to = round(times[0] * SECOND), round(times[-1] * SECOND)
    health.complain("innovation 9.0 standard deviations, limit 3.0")
    return health


@pytest.mark.parametrize(
    ("times", "contradicts"),
    [
        (every(0.5, 1.0, 3.0), True),  # five in 2 s
        (every(0.4, 1.0, 2.6), False),  # five in 1.6 s
        ([1.0, 2.0, 3.0, 4.0], False),  # four in 3 s
        (every(1.0, 1.0, 9.0), True),
    ],
)
def test_a_filter_is_contradicted_by_five_refusals_in_two_seconds(times: list[float], contradicts: bool) -> None:
    health = refused(times)
    assert health.contradicts == contradicts
    assert level(health, times[-1]) == (Level.ERROR if contradicts else Level.WARN)


def test_a_problem_is_reported_for_two_seconds_of_messages() -> None:
    health = received(every(0.1, 1.0, 2.0))
    health.complain("stamp repeated")
    for now, expected in ((3.8, Level.WARN), (4.1, Level.OK)):
        for time in every(0.1, 2.1, now):
            health.receive(round(time * SECOND), GYRO)
        assert level(health, now) == expected


def test_the_figures_go_with_the_level() -> None:
    health = received(every(0.1, 1.0, 2.0))
    health.used, health.refused, health.late, health.too_late, health.invalid = 1, 2, 3, 4, 5
    health.innovation_ratio, health.noise = 1.234, "0.1 rad/s"
    values = health.diagnostic("gyro", GYRO, 2 * SECOND).values
    assert values == {
        "used": "1", "refused": "2", "late": "3", "too_late": "4", "invalid": "5", "innovation_ratio": "1.23",
        "standard deviation": "0.1 rad/s",
    }  # fmt: skip
    health.noise = None
    assert "standard deviation" not in health.diagnostic("gyro", GYRO, 2 * SECOND).values
