"""Recordings of loggers with one clock are joined without a shift."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.bag.importers import build
from vsense_ros.bag.join import joined
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording


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
