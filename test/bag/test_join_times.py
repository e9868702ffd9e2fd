"""Recordings of loggers with one clock are joined without a shift."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.bag.importers import build
from vsense_ros.bag.join import joined
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import FIELDS, Channel, Recording
from vsense_ros.messages.topics import TOPICS


def test_times_are_kept_where_that_is_asked_for_even_without_a_common_motion() -> None:
    stamp = np.arange(500) * 10_000_000
    imu = build.imu(stamp, np.ones((500, 3)), np.ones((500, 3)))
    pressure = build.joints("vehicle/brake_pressure", stamp + 3_000_000, "effort", {"wheel_fl": np.ones(500)})
    sources = [Recording({"imu/data": imu}, "one"), Recording({pressure.topic: pressure}, "two")]
    with pytest.raises(InputError, match="if they have one clock: --keep-times"):
        joined(sources)
    found = joined(sources, keep_times=True)
    assert np.array_equal(found[pressure.topic].stamp, pressure.stamp)
    assert not any("its times are put" in note for note in found.notes)


@pytest.mark.parametrize("topic", ["vehicle/speed", "vehicle/velocity"])
@pytest.mark.parametrize("late", [-1.3, 0.7])
def test_clocks_are_compared_by_the_speed_that_a_car_states_itself(topic: str, late: float) -> None:
    """One logger has GNSS, the other has the car's own speed alone, by a clock that is late."""
    seconds = np.arange(0.0, 60.0, 0.05)
    speed = 12.0 + 4.0 * np.sin(0.5 * seconds) + 2.0 * np.sin(1.3 * seconds + 1.0)
    stamp = 1_700_000_000_000_000_000 + np.round(seconds * 1e9).astype(np.int64)
    ground = np.column_stack([0.6 * speed, 0.8 * speed, np.zeros(len(speed))])
    own = np.column_stack([speed, np.full(len(speed), np.nan), np.full(len(speed), np.nan)])
    with_gnss = Recording({"gps/velocity": build.velocity(stamp, ground)}, "gnss")
    body = build.body_velocity(stamp + round(late * 1e9), own)
    kind = TOPICS[topic].kind
    columns = {field: body.columns[field] for field in FIELDS[kind]}
    car = Recording({topic: Channel(topic, kind, body.stamp, body.received, columns)}, "car")
    found = joined([with_gnss, car])
    assert (found[topic].stamp[0] - stamp[0]) * 1e-9 == pytest.approx(0.0, abs=0.03)
