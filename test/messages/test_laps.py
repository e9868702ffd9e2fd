"""Laps by position."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.messages.laps import METRES, laps
from vsense_ros.messages.recording import Channel, Recording

SPEED = 12.0  # [m/s]


def round_a_track(
    count: float, radius: float, *, noise: float = 0.0, backwards: bool = False, latitude: float = 45.0
) -> Recording:
    """So many laps of a circle, with fixes at 10 Hz and one reading at each of them that says the time."""
    duration = count * 2 * np.pi * radius / SPEED
    t = np.arange(0.0, duration, 0.1)
    angle = SPEED * t / radius * (-1 if backwards else 1)
    rng = np.random.default_rng(1)
    east, north = radius * np.cos(angle), radius * np.sin(angle)
    east, north = (v + noise * rng.standard_normal(len(v)) for v in (east, north))
    columns = {
        "latitude": (latitude + north / METRES)[:, None],
        "longitude": (8 + east / METRES / np.cos(np.radians(latitude)))[:, None],
        "altitude": np.zeros((len(t), 1)),
    }
    stamp = np.round(t * 1e9).astype(np.int64)
    return Recording({"gps/fix": Channel("gps/fix", "sensor_msgs/msg/NavSatFix", stamp, stamp, columns)}, "drive")


@settings(deadline=None, max_examples=25)
@given(
    count=st.integers(2, 5), radius=st.floats(40.0, 200.0), over=st.floats(0.05, 0.5), backwards=st.booleans()
)  # fmt: skip
def test_each_lap_lasts_as_long_as_the_track_is(count, radius, over, backwards):
    found = laps(round_a_track(count + over, radius, noise=0.3, backwards=backwards))
    assert [one.name for one in found] == [f"drive lap {i + 1}" for i in range(count)]
    for one in found:
        assert one.duration == pytest.approx(2 * np.pi * radius / SPEED, abs=1.5)


@pytest.mark.parametrize("latitude", [0.0, 45.0, 70.0])
def test_a_degree_of_longitude_is_as_long_as_it_is_at_that_latitude(latitude):
    """A circle of 113 m is shorter than any lap, so that every lap is two turns."""
    turn = 2 * np.pi * 18.0 / SPEED
    found = laps(round_a_track(8.5, 18.0, latitude=latitude))
    assert [one.duration for one in found[:-1]] == pytest.approx([2 * turn] * (len(found) - 1), abs=1.0)


def test_a_drive_that_does_not_come_back_is_one():
    drive = round_a_track(0.8, 150.0)
    assert laps(drive) == [drive]
    assert laps(Recording({}, "nothing")) == [Recording({}, "nothing")]
