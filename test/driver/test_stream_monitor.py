"""What is said of one stream: its rate, its silence, its faults, and stamps that do not belong into it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.driver.monitor import LATEST, NANO, StreamLimits, StreamMonitor
from vsense_ros.messages.diagnostic import Level

START = 1_700_000_000 * NANO


def monitor(**limits: float) -> StreamMonitor:
    return StreamMonitor("stream", StreamLimits(**{"timeout": 0.5, **limits}))  # type: ignore[arg-type]


def fed(made: StreamMonitor, count: int, period: float = 0.1, first: float = 0.0) -> StreamMonitor:
    for i in range(count):
        assert made.accept(START + round((first + i * period) * NANO))
    return made


def said(made: StreamMonitor, seconds: float) -> tuple[Level, str]:
    found = made.diagnostic(START + round(seconds * NANO))
    return found.level, found.message


@pytest.mark.parametrize(
    ("rate", "level"), [(10.0, Level.OK), (7.1, Level.OK), (14.9, Level.OK), (6.9, Level.WARN), (15.2, Level.WARN)]
)
def test_the_rate_may_be_from_seven_tenths_to_one_and_a_half_of_the_nominal(rate, level):
    made = fed(monitor(nominal_rate=10.0), 40, 1 / rate)
    assert made.rate() == pytest.approx(rate, rel=1e-6)
    found = made.diagnostic(START + round(39 / rate * NANO))
    assert found.level == level
    assert found.values["rate [Hz]"] == f"{rate:.1f}"
    assert found.values["nominal rate [Hz]"] == "10"
    assert fed(monitor(), 40, 1 / rate).diagnostic(START + round(39 / rate * NANO)).level == Level.OK


def test_a_rate_is_known_from_sixteen_stamps_on_and_is_that_of_the_latest():
    assert fed(monitor(), 15).rate() is None
    made = fed(monitor(), 16)
    assert made.rate() == pytest.approx(10.0)
    fed(made, 64, 0.02, first=1.6)
    assert made.rate() == pytest.approx(50.0)


def test_a_silent_stream_is_stale_and_one_that_never_came_says_why():
    assert said(monitor(), 0.0) == (Level.STALE, "never received")
    never = monitor()
    never.absence = "the bus is off"
    assert said(never, 0.0) == (Level.STALE, "never received: the bus is off")
    made = fed(monitor(), 10)
    assert said(made, 1.39)[0] == Level.OK
    assert said(made, 1.5) == (Level.STALE, "silent for 0.60 s (timeout 0.5 s)")


def test_faults_colour_the_diagnostic_for_two_seconds_and_are_counted():
    made = fed(monitor(timeout=10.0), 10)
    made.fault("bad checksum", START + NANO)
    made.note("position jump", START + NANO)
    made.fault("broken", START + NANO, Level.ERROR)
    assert said(made, 1.5) == (Level.ERROR, "bad checksum, position jump, broken")
    assert said(made, 3.0)[0] == Level.ERROR
    assert said(made, 3.1) == (Level.OK, "ok")
    assert said(made, -1.1) == (Level.OK, "ok")  # the clock was set back
    made.passed("of another kind")
    values = made.diagnostic(START, {"more": "x"}).values
    assert (values["accepted"], values["dropped"], values["bad checksum"]) == ("10", "2", "1")
    assert (values["position jump"], values["of another kind"], values["more"]) == ("1", "1", "x")


def test_a_stream_of_faults_alone_has_nothing_usable():
    made = monitor()
    made.fault("NaN", START)
    assert said(made, 0.1) == (Level.ERROR, "nothing usable: NaN")
    assert said(made, 0.6)[0] == Level.STALE
    made = fed(monitor(), 5)
    made.fault("NaN", START + 3 * NANO)
    assert said(made, 3.0) == (Level.ERROR, "nothing usable: NaN")


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (0.0, "duplicated time stamp"), (-0.05, "time stamp going backwards"), (10.1, "time stamp jumping ahead"),
        (9.9, None), (0.01, None),
    ],
)  # fmt: skip
def test_a_stamp_that_is_not_later_or_much_later_is_refused_with_the_reason(step, reason):
    made = fed(monitor(), 5)
    assert made.accept(START + round((0.4 + step) * NANO)) == (reason is None)
    assert dict(made.faults) == ({} if reason is None else {reason: 1})
    assert made.accepted == (6 if reason is None else 5)
    assert made.last_stamp == START + round((0.4 + (step if reason is None else 0.0)) * NANO)


def test_a_gap_that_the_arrivals_show_as_well_is_none():
    made = monitor()
    assert made.accept(START, START)
    assert made.accept(START + 60 * NANO, START + 61 * NANO)
    assert not made.accept(START + 120 * NANO, START + 62 * NANO)
    assert made.faults == {"time stamp jumping ahead": 1}


@given(jump=st.sampled_from([-3600.0, -0.5, 3600.0]))
def test_a_stream_whose_clock_was_set_goes_on_after_five_stamps_that_agree(jump):
    made = fed(monitor(), 20)
    taken = [made.accept(START + round((2.0 + jump + 0.01 * i) * NANO)) for i in range(8)]
    assert taken == [False] * 4 + [True] * 4
    assert made.doubts == {"clock was set to another time": 1}
    assert made.rate() is None


def test_stray_stamps_that_do_not_agree_with_each_other_set_no_clock():
    made = fed(monitor(), 20)
    for i in range(20):
        assert not made.accept(START + round((3600.0 * (-1) ** i + i) * NANO))
    assert made.last_stamp == START + round(1.9 * NANO)
    for _ in range(20):
        assert not made.accept(made.last_stamp)
    assert made.faults["duplicated time stamp"] == 20


@pytest.mark.parametrize("stamp", [-1, LATEST, 10 * LATEST])
def test_a_stamp_that_no_message_holds_is_refused(stamp):
    made = monitor()
    assert not made.accept(stamp, START)
    assert made.faults == {"time stamp out of range": 1}
    assert made.accept(LATEST - 1)
    assert monitor().accept(0)
