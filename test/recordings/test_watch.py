"""Drivers say in their diagnostics what cannot be true together of what they receive."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from recordings import planted
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.checks.watch import PlausibilityWatch
from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.ubx import UbxDecoder
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording


def drive() -> Recording:
    return planted.drive("steady_state_circle", "prototype_real", 0)


def same(channel: Channel) -> Channel:
    return channel


@pytest.mark.parametrize("protocol", ["nmea", "ubx"])
@pytest.mark.parametrize(
    ("change", "told"),
    [(same, None), (planted.north_east, "east and north"), (planted.in_axes_of_car, "axes of the car")],
)
def test_a_receiver_whose_velocity_is_in_another_frame_is_told(
    protocol: str, change: Callable[[Channel], Channel], told: str | None
) -> None:
    recording = planted.changed(drive(), "gps/velocity", change)
    subject = NmeaDecoder() if protocol == "nmea" else UbxDecoder()
    last = 0
    for last, data in gnss_byte_stream(recording, protocol):
        subject.feed(data, last)
    found = [d for d in subject.diagnostics(last) if "plausibility" in d.name]
    if told is None:
        assert found == []
        return
    (doubt,) = found
    assert doubt.level == Level.WARN
    assert doubt.message.startswith("gps/velocity: is not the change of gps/fix")
    assert told in doubt.message


def test_a_watch_tells_of_a_sign_and_costs_little() -> None:
    recording = planted.changed(drive(), "vehicle/steering", planted.scaled("position", -1.0))
    watch = PlausibilityWatch("car")
    samples = list(recording.samples(("imu/data", "vehicle/steering", "vehicle/wheel_speeds")))
    before = time.perf_counter()
    for sample in samples:
        watch.add(sample)
    assert (time.perf_counter() - before) / len(samples) < 20e-6
    (found,) = watch.diagnostics(samples[-1].stamp)
    assert "vehicle/steering: steering_wheel is against" in found.message
    assert watch.diagnostics(samples[-1].stamp + 1_000_000_000) == [found]
