"""Events at their time: late ones go back, the remembered past is repeated, faults lead to the last valid state."""

from __future__ import annotations

import numpy as np
import pytest

from sources import SECOND
from systems import COURSE, YawKkf
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian, Innovation
from vsense_ros.estimation.timeline import Channel, Event, Timeline

START = Gaussian(np.array([0.1, 0.0]), np.diag([0.01, 0.0004]))
CHANNELS = (Channel("inputs", np.inf, 0), Channel("course", 1e9))
STEP = 0.01


def timeline(**changes: object) -> Timeline:
    filter = Ekf(Dense(YawKkf(), [COURSE]))
    filter.start(START)
    made = Timeline(filter, CHANNELS, **({"reach": 0.5, "longest_step": STEP} | changes))  # type: ignore[arg-type]
    made.begin(0)
    return made


def course(time: float, value: float = 0.1) -> Event:
    return Event(1, round(time * SECOND), np.array([value]), COURSE.variances)


def rate(time: float, value: float) -> Event:
    return Event(0, round(time * SECOND), np.array([value]), np.ones(1))


def drive(begin: float, end: float, period: float = 0.02) -> list[Event]:
    times = np.arange(begin + period, end + period / 2, period)
    return [
        one for t in times for one in (rate(t - 0.001, float(np.sin(3 * t))), course(t, 0.1 + 0.01 * np.cos(9 * t)))
    ]


def after(made: Timeline, events: list[Event]) -> np.ndarray:
    for event in events:
        made.add(Event(event.sensor, event.stamp, event.value, event.variance))
    made.catch_up()
    return made.filter.memory.copy()


def expected(events: list[Event]) -> Gaussian:
    """The filter called by hand, in steps of at most `STEP` from measurement to measurement."""
    filter = Ekf(Dense(YawKkf(), [COURSE]))
    filter.start(START)
    now = 0
    for event in sorted(events, key=lambda one: one.stamp):
        if event.sensor == 0:
            filter.inputs[:] = event.value
            continue
        count = max(1, -(-(event.stamp - now) // round(STEP * SECOND)))
        for _ in range(count if event.stamp > now else 0):
            filter.predict((event.stamp - now) * 1e-9 / count)
        now = event.stamp
        filter.correct("course", event.value, event.variance)
    return filter.belief()


def test_a_timeline_does_what_the_filter_does_called_by_hand() -> None:
    events = drive(0, 1.0, 0.05)
    made = timeline()
    after(made, events)
    np.testing.assert_allclose(made.filter.belief().mean, expected(events).mean, rtol=1e-12)
    np.testing.assert_allclose(made.filter.belief().covariance, expected(events).covariance, rtol=1e-10)
    assert made.stamp == SECOND


def test_a_late_measurement_says_so_and_waits_until_the_newest_state_is_needed() -> None:
    made = timeline()
    newest = after(made, drive(0, 0.4))
    assert made.add(course(0.4)) is False
    assert made.add(course(0.35, 0.3)) is True
    made.catch_up()
    assert (made.filter.memory != newest).any()


def test_measurements_that_are_merged_act_at_one_time() -> None:
    made = timeline(merge=0.002)
    after(made, [course(0.1)])
    before = made.filter.covariance.copy()
    made.add(course(0.102))
    assert made.stamp == round(0.1 * SECOND), "no step was made for it"
    assert made.filter.covariance[0, 0] < before[0, 0]
    made.add(course(0.1031))
    assert made.stamp == round(0.1031 * SECOND)
    assert made.add(course(0.1015)) is False, "within the merging time it is not late"
    assert made.add(course(0.1005)) is True


def test_the_history_reaches_as_far_as_it_was_asked_to() -> None:
    made = timeline()
    assert made.begun
    after(made, drive(0, 0.3))
    assert made.oldest == 0
    after(made, drive(0.3, 2.0))
    assert made.oldest == round(1.5 * SECOND)
    made.forget_past()
    assert made.oldest == 2 * SECOND
    made.clear()
    assert not made.begun


@pytest.mark.parametrize("since", [1.97, 1.6, 1.2, 0.55, 0.3])
def test_what_is_remembered_can_be_gone_back_to_and_done_again(since: float) -> None:
    """Within the reach of late messages, and beyond it among places a tenth of a second apart."""
    made = timeline(remembered=2.0)
    newest = after(made, drive(0, 2.0))
    ahead = made.rewind(round(since * SECOND))
    went_to = made._history[-1].stamp
    assert since * SECOND - 0.13 * SECOND <= went_to <= since * SECOND
    later = [event.stamp for event in drive(0, 2.0) if event.stamp > went_to]
    assert [event.stamp for event in ahead] == later[1:], "but for inputs that the state at that time already had"
    made.catch_up()
    np.testing.assert_allclose(made.filter.memory, newest, rtol=1e-12, atol=1e-15)


def test_only_what_is_remembered_is_kept() -> None:
    made = timeline(remembered=1.0)
    after(made, drive(0, 4.0))
    assert len(made.rewind(0)) == pytest.approx(2 * 50 * 1.0, abs=16)
    assert made._history[-1].stamp == pytest.approx(3.0 * SECOND, abs=0.15 * SECOND)


def test_without_a_memory_one_goes_back_as_far_as_the_history() -> None:
    made = timeline()
    newest = after(made, drive(0, 2.0))
    made.rewind(0)
    assert made._history[-1].stamp == pytest.approx(1.5 * SECOND, abs=0.05 * SECOND)
    made.catch_up()
    np.testing.assert_allclose(made.filter.memory, newest, rtol=1e-12, atol=1e-15)


def test_one_can_go_back_twice() -> None:
    made = timeline(remembered=2.0)
    newest = after(made, drive(0, 2.0))
    for since in (1.0, 0.6, 1.4, 0.6):
        made.rewind(round(since * SECOND))
        made.catch_up()
        np.testing.assert_allclose(made.filter.memory, newest, rtol=1e-12, atol=1e-15)


def test_a_second_look_by_other_means_leaves_the_filter_as_it_was() -> None:
    """With the calls of the first run it comes to the same state, and then is as before."""
    made = timeline(remembered=2.0)
    newest = after(made, drive(0, 2.0, 0.05))
    seen = []

    def act(event: Event) -> None:
        made._happen(event)
        seen.append((event.stamp, made.filter.memory.copy()))

    assert made.again(round(0.7 * SECOND), act)
    assert (made.filter.memory == newest).all()
    assert seen[0][0] > 0.55 * SECOND
    assert seen[-1][0] == 2 * SECOND
    np.testing.assert_allclose(seen[-1][1], newest, rtol=1e-12, atol=1e-15)


def test_a_second_look_that_cannot_go_all_the_way_says_so() -> None:
    made = timeline(remembered=2.0)
    newest = after(made, drive(0, 1.0, 0.05))

    def act(event: Event) -> None:
        made.filter.mean[:] = np.nan

    assert not made.again(round(0.5 * SECOND), act)
    assert (made.filter.memory == newest).all()


def test_each_event_is_reported_once_with_its_innovation() -> None:
    reported: list[tuple[int, float, Innovation | None]] = []
    made = timeline(corrected=lambda event, nis, innovation: reported.append((event.stamp, nis, innovation)))
    events = drive(0, 0.2)
    after(made, events)
    after(made, [course(0.05, 0.12)])
    stamps = [stamp for stamp, _, _ in reported]
    assert sorted(stamps) == sorted([one.stamp for one in events] + [round(0.05 * SECOND)])
    measured = {one.stamp for one in events if one.sensor == 1}
    for stamp, nis, innovation in reported[: len(events)]:
        assert (innovation is not None) == (stamp in measured)
        assert nis == (innovation.nis if innovation is not None else 0.0)


def test_events_by_hand_are_left_to_those_who_know_them() -> None:
    acted: list[int] = []
    filter = Ekf(Dense(YawKkf(), [COURSE]))
    filter.start(START)
    channels = [*CHANNELS, Channel("by hand", np.inf, by_hand=True)]
    made = Timeline(
        filter,
        channels,
        reach=1.0,
        longest_step=STEP,
        act=lambda one: acted.append(one.stamp) if one.sensor == 2 else None,
    )
    made.begin(0)
    for time in (0.1, 0.2, 0.3):
        made.add(Event(2, round(time * SECOND), np.zeros(1), np.ones(1)))
    made.add(course(0.05))
    made.catch_up()
    assert acted == [round(t * SECOND) for t in (0.1, 0.2, 0.3, 0.1, 0.2, 0.3)]


def test_a_filter_that_cannot_be_moved_goes_on_from_its_newest_valid_state() -> None:
    made = timeline()
    after(made, drive(0, 0.2))
    valid = made.filter.belief()
    made.filter.inputs[:] = np.nan
    made.add(course(0.22))
    assert np.isfinite(made.filter.mean).all()
    assert np.sqrt(made.filter.covariance[1, 1]) > 1.9 * np.sqrt(valid.covariance[1, 1]), "with less trust"


def test_without_any_valid_state_there_is_no_recovery() -> None:
    made = timeline()
    assert not made.recover()
    after(made, drive(0, 0.1))
    assert made.recover()
    for instant in made._history[:-1]:
        instant.kept.memory[:] = np.nan
    assert not made.recover()


def test_what_happened_is_announced_after_each_event_and_each_return() -> None:
    happened: list[int] = []
    made: Timeline = timeline(afterwards=lambda: happened.append(made.stamp))
    after(made, [course(0.1), course(0.2)])
    assert happened == [round(0.1 * SECOND), round(0.2 * SECOND)]
    made.add(course(0.15))
    assert len(happened) == 3


@pytest.mark.parametrize("at_once", [True, False])
def test_what_is_repeated_is_the_same_in_one_go_and_event_by_event(at_once: bool) -> None:
    events = drive(0, 1.0)

    def arrival(event: Event) -> int:
        return event.stamp + (round(0.15 * SECOND) if event.sensor and event.stamp % 3 == 0 else 0)

    late = sorted(events, key=arrival)
    assert late != events
    assert (after(timeline(in_one_go=lambda: at_once), late) == after(timeline(), events)).all()


def test_going_on_to_a_time_that_has_passed_leaves_the_filter_where_it_is() -> None:
    made = timeline()
    before = after(made, drive(0, 0.4))
    for time in (0.05, 0.3, 0.4):
        made.go_on(round(time * SECOND))
        np.testing.assert_array_equal(made.filter.memory, before)
        assert made.stamp == round(0.4 * SECOND)
    made.go_on(round(0.41 * SECOND))
    assert made.stamp == round(0.41 * SECOND)
    assert not np.array_equal(made.filter.memory, before)
