"""Files of what a GNSS receiver sent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import read_bag
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder


@pytest.mark.parametrize(("protocol", "ending"), [("nmea", "txt"), ("nmea", "nmea"), ("ubx", "ubx")])
def test_fixes_and_velocities_come_out_at_the_time_of_their_measurement(
    protocol: str, ending: str, tmp_path: Path
) -> None:
    drive = read_bag(shared_folder("bags") / "steady_state_circle")
    sent = b"".join(data for _, data in gnss_byte_stream(drive, protocol))
    extra = b"$GPGSV,1,1,00*79\r\n$GPRMC,garbage*00\r\n" if protocol == "nmea" else b"\xb5\x62\x01\x07garbage"
    path = tmp_path / f"log.{ending}"
    path.write_bytes(sent + extra)
    found = import_recording(path)
    for topic, field, tolerance in (("gps/fix", "latitude", 2e-7), ("gps/velocity", "linear", 2e-3)):
        # NMEA tells no vertical velocity.
        expected, got = (r[topic].columns[field][:, :2] for r in (drive, found))
        np.testing.assert_allclose(got, expected, atol=tolerance)
        assert np.abs(found[topic].stamp - drive[topic].stamp).max() < 10_000_000
        assert np.array_equal(found[topic].received, found[topic].stamp)
    if protocol == "nmea":
        assert any("not decoded: GPGSV × 1" in note for note in found.notes)
        assert any("1 broken frames" in note for note in found.notes)


def test_a_log_without_a_fix_says_what_there_is(tmp_path: Path) -> None:
    path = tmp_path / "log.nmea"
    path.write_bytes(b"$GPGSV,1,1,00*79\r\n" * 5)
    with pytest.raises(InputError, match=r"no fix and no velocity in 5 frames: .*GPGSV"):
        import_recording(path)
