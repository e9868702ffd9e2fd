"""Which messages reach a filter: none twice, nothing frozen, no clock that went elsewhere on its own."""

from __future__ import annotations

import numpy as np
import pytest

from sources import SECOND, Gyro, message
from vsense_ros.estimation.health import Health
from vsense_ros.estimation.intake import FROZEN, LONGEST_GAP, Intake, Timing
from vsense_ros.estimation.reading import Map
from vsense_ros.estimation.timeline import Event

REACH = 0.5


def intake(*gyros: Gyro, moving: bool = True, merge: float = 0.0) -> Intake[Gyro]:
    sensors = {f"gyro_{i}": gyro for i, gyro in enumerate(gyros or (Gyro(),))}
    return Intake(sensors, Map(None), REACH, lambda: moving, merge)


def event(stamp: float, sensor: int = 0) -> Event:
    return Event(sensor, round(stamp * SECOND), np.zeros(2), np.ones(2))


def take(made: Intake[Gyro], time: float, index: int = 0, value: tuple[float, float] | None = None) -> Event | None:
    """A new message, and its stamp believed as the filter's runner does."""
    read = made.read(index, message(time, (time, -time) if value is None else value, arrival=time))
    if read is not None:
        made.believe(index, read.stamp)
    return read


def test_a_new_message_is_a_measurement() -> None:
    made = intake()
    read = take(made, 1.0, value=(0.3, 0.4))
    assert read is not None
    assert read.value.tolist() == [0.3, 0.4]
    assert (read.sensor, read.stamp) == (0, SECOND)
    assert made.health[0].invalid == 0


def test_a_repeated_stamp_is_refused_and_one_that_was_overtaken_is_not() -> None:
    made = intake()
    for time in (1.0, 1.2):
        assert take(made, time) is not None
    assert take(made, 1.2) is None
    assert made.health[0].problem == "stamp repeated"
    assert take(made, 1.0) is None
    assert take(made, 1.1) is not None
    assert made.health[0].invalid == 2


def test_a_message_that_cannot_be_read_is_counted_with_the_reason() -> None:
    made = intake()
    assert made.read(0, message(1.0, kind="sensor_msgs/msg/Imu")) is None
    assert made.health[0].invalid == 1
    assert "message type sensor_msgs/msg/Imu" in made.health[0].problem


@pytest.mark.parametrize(
    ("value", "moving", "noisy", "frozen"),
    [
        ((0.2, 0.0), False, True, True),  # a turn has no equal readings
        ((0.0, 0.0), True, True, True),
        ((0.0, 0.0), False, True, False),  # a coarse sensor at rest
        ((0.0009, 0.0), False, True, False),
        ((0.0, -0.0011), False, True, True),
        ((0.2, 0.0), True, False, False),  # wheel speeds may be equal
    ],
)
def test_equal_readings_are_frozen_where_noise_makes_them_impossible(
    value: tuple[float, float], moving: bool, noisy: bool, frozen: bool
) -> None:
    made = intake(Gyro(noisy=noisy), moving=moving)
    taken = [take(made, 1 + 0.01 * i, value=value) is not None for i in range(FROZEN + 3)]
    assert all(taken[:FROZEN])
    assert taken[FROZEN:] == [not frozen] * 3
    assert (made.health[0].problem == "value frozen") == frozen


def test_another_value_ends_the_count_of_equal_ones() -> None:
    made = intake()
    for i in range(2 * FROZEN):
        assert take(made, 1 + 0.01 * i, value=(0.2, 0.3 if i == FROZEN - 1 else 0.0)) is not None


# Messages that come faster than the filter takes them


def test_fast_messages_are_averaged_at_their_mean_time() -> None:
    made = intake(merge=0.01)
    events = [take(made, 1 + 0.002 * i, value=(float(i), 1.0)) for i in range(40)]
    means = [one for one in events if one is not None]
    assert len(means) == 1 + 39 // 6, "the first, before a period is known, and one for each 10 ms"
    for one in means[1:]:
        time = (one.stamp - SECOND) / SECOND
        assert one.value[0] == pytest.approx(time / 0.002, abs=1e-6)
        assert one.value[1] == pytest.approx(1.0)
    apart = np.diff([one.stamp for one in means[1:]])
    np.testing.assert_allclose(apart, 0.012 * SECOND, err_msg="6 messages of 2 ms are within 10 ms")
    assert made.health[0].used == 40 - len(means), "those in a mean were used as well"


def test_the_largest_variance_counts_and_absent_components_are_left_out_of_the_mean() -> None:
    made = intake(merge=0.01)
    found = []
    for i in range(12):
        value = (1.0 if i % 2 else np.nan, 2.0 * i)
        one = made.read(0, message(1 + 0.002 * i, value, arrival=1 + 0.002 * i, stated=[0.01 * (1 + i), 0.02]))
        if one is not None:
            found.append(one)
    mean = found[-1]
    assert mean.value[0] == 1.0
    assert mean.value[1] == pytest.approx((mean.stamp - SECOND) / (0.001 * SECOND))
    first, last = ((mean.stamp - SECOND) / SECOND + side * 0.005 for side in (-1, 1))
    assert last - first == pytest.approx(0.01)
    assert mean.variance[0] == pytest.approx(0.01 * (1 + round(last / 0.002)))


def test_slow_messages_and_those_of_exact_sensors_are_not_averaged() -> None:
    for made, period in ((intake(merge=0.01), 0.02), (intake(Gyro(noisy=False), merge=0.01), 0.002)):
        assert all(take(made, 1 + period * i) is not None for i in range(20))


def test_a_mean_does_not_span_a_gap() -> None:
    made = intake(merge=0.01)
    for i in range(8):
        take(made, 1 + 0.002 * i)
    later = [take(made, 2 + 0.002 * i, value=(5.0, 5.0 + i)) for i in range(8)]
    means = [one for one in later if one is not None]
    assert means[0].value[0] == 5.0
    assert means[0].stamp >= 2 * SECOND


# Clocks


def test_stamps_within_reach_are_used() -> None:
    made = intake()
    for stamp in (1.0, 1.7, 2.0, 2.0 + REACH):
        assert made.timing(event(stamp), SECOND, 2 * SECOND) == Timing.USED


def test_a_measurement_from_before_the_history_is_too_late() -> None:
    made = intake(Gyro(), Gyro())
    take(made, 2.0, 1)
    assert made.timing(event(0.9), SECOND, 2 * SECOND) == Timing.REFUSED
    health = made.health[0]
    assert (health.too_late, health.invalid) == (1, 0)
    assert health.problem == "measurement 1.1 s old, history is 0.5 s"


def test_a_clock_that_alone_went_ahead_is_refused() -> None:
    made = intake(Gyro(), Gyro())
    for time in (1.9, 2.0):
        take(made, time, 0)
        take(made, time, 1)
    assert made.timing(event(12.0), SECOND, 2 * SECOND) == Timing.REFUSED
    assert made.health[0].problem == "stamp 10 s ahead of all others"
    assert made.timing(event(2.7), SECOND, 2 * SECOND) == Timing.REFUSED


def test_clocks_that_all_went_to_the_same_time_are_followed() -> None:
    made = intake(Gyro(), Gyro())
    for index in (0, 1):
        take(made, 2.0, index)
    assert made.timing(event(100.0, 0), SECOND, 2 * SECOND) == Timing.REFUSED
    assert made.timing(event(101.0, 1), SECOND, 2 * SECOND) == Timing.RESTART


@pytest.mark.parametrize("apart", [-LONGEST_GAP - 1, LONGEST_GAP + 1])
def test_clocks_that_went_to_different_times_are_not_followed(apart: float) -> None:
    made = intake(Gyro(), Gyro())
    for index in (0, 1):
        take(made, 2.0, index)
    made.timing(event(100.0, 0), SECOND, 2 * SECOND)
    assert made.timing(event(100.0 + apart, 1), SECOND, 2 * SECOND) == Timing.REFUSED


def test_clocks_that_all_went_back_are_followed_too() -> None:
    made = intake(Gyro(), Gyro())
    for index in (0, 1):
        take(made, 50.0, index)
    assert made.timing(event(1.0, 0), 49 * SECOND, 50 * SECOND) == Timing.REFUSED
    assert made.timing(event(1.1, 1), 49 * SECOND, 50 * SECOND) == Timing.RESTART


def test_a_sensor_that_returns_to_the_filters_time_no_longer_asks_to_be_followed() -> None:
    made = intake(Gyro(), Gyro())
    for index in (0, 1):
        take(made, 2.0, index)
    made.timing(event(100.0, 0), SECOND, 2 * SECOND)
    assert made.timing(event(2.1, 0), SECOND, 2 * SECOND) == Timing.USED
    assert made.timing(event(100.0, 1), SECOND, 2 * SECOND) == Timing.REFUSED


def test_clocks_that_are_forgotten_must_agree_anew() -> None:
    made = intake(Gyro(), Gyro())
    for index in (0, 1):
        take(made, 2.0, index)
    made.timing(event(100.0, 0), SECOND, 2 * SECOND)
    made.forget_clocks()
    assert made.timing(event(100.0, 1), SECOND, 2 * SECOND) == Timing.REFUSED


@pytest.mark.parametrize(("gap", "expected"), [(3.0, Timing.USED), (20.0, Timing.RESTART)])
def test_after_a_silence_of_all_sensors_time_has_gone_on(gap: float, expected: Timing) -> None:
    """As long a silence as the stamp is ahead: the clock is right, and after a long one the filter starts anew."""
    made = intake(Gyro(timeout=100.0), Gyro(timeout=100.0))
    for index in (0, 1):
        take(made, 2.0, index)
    made.read(0, message(2 + gap, (1.0, 2.0), arrival=2 + gap))
    assert made.timing(event(2 + gap), SECOND, 2 * SECOND) == expected


def test_a_sensor_sends_until_its_timeout() -> None:
    made = intake(Gyro(timeout=1.0), Gyro())
    assert not made.sends(0)
    take(made, 2.0, 0)
    assert made.sends(0)
    take(made, 2.9, 1)
    assert made.sends(0)
    take(made, 3.1, 1)
    assert not made.sends(0)


def test_arrivals_go_on_with_the_stamps_where_messages_do_not_tell_them() -> None:
    made = intake()
    for stamp, arrival in ((1.0, 1.0), (1.05, 1.05), (0.9, 1.05), (9.0, 1.15), (1.1, 1.15)):
        made.read(0, message(stamp, (stamp, 1.0)))
        assert made.newest_arrival == round(arrival * SECOND)


def test_after_a_restart_stamps_from_before_mean_nothing() -> None:
    made = intake(Gyro(), Gyro())
    for index in (0, 1):
        take(made, 50.0, index)
    made.read(0, message(1.0, (1.0, 2.0), arrival=51.0))
    made.restart(0)
    assert made.newest_arrival == 51 * SECOND
    assert not made.sends(1)
    assert take(made, 50.0, 1) is not None


# What became of measurements


def counted(nis: list[float], limit: float = 9.0) -> Health:
    made = intake()
    for i, one in enumerate(nis):
        made.count(event(1.0 + i), one, limit, measured=True)
    return made.health[0]


def test_what_is_believed_and_refused_is_counted() -> None:
    health = counted([2.0, 10.0, 11.0, 9.0, 12.0])
    assert (health.used, health.refused, health.refused_in_a_row) == (2, 3, 1)
    assert (health.refused_from, health.refused_to) == (5 * SECOND, 5 * SECOND)
    assert health.problem == "innovation 3.5 standard deviations, limit 3.0"


def test_refusals_in_a_row_have_a_beginning_and_an_end() -> None:
    health = counted([2.0, 10.0, 11.0, 12.0])
    assert (health.refused_in_a_row, health.refused_from, health.refused_to) == (3, 2 * SECOND, 4 * SECOND)


def test_an_innovation_that_is_no_number_is_refused() -> None:
    assert counted([float("nan")]).refused == 1


def test_the_innovation_ratio_goes_to_that_of_the_measurements() -> None:
    """Normalized innovations squared of two components, twice as large as expected."""
    assert counted([4.0] * 400).innovation_ratio == pytest.approx(2.0, abs=1e-3)
    assert counted([4.0]).innovation_ratio == pytest.approx(1.02)


def test_inputs_are_used_whatever_they_are() -> None:
    made = intake()
    made.count(event(1.0), 1e9, 9.0, measured=False)
    assert (made.health[0].used, made.health[0].refused) == (1, 0)
    assert made.health[0].innovation_ratio == 1.0


def test_patience_ends_with_a_refusal_after_many() -> None:
    made = intake()
    for i in range(6):
        made.count(event(1.0 + i), 100.0, 9.0, measured=True)
    assert made.out_of_patience(0, 100.0, 9.0)
    assert not made.out_of_patience(0, 4.0, 9.0)
    assert not made.out_of_patience(0, float("nan"), 9.0)
    fresh = intake()
    fresh.count(event(1.0), 100.0, 9.0, measured=True)
    assert not fresh.out_of_patience(0, 100.0, 9.0)
