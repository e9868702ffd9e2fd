"""UBX, NMEA and RTCM on one line are each decoded, whichever comes first."""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2 import UBXMessage

from vsense_ros.bag.importers import import_recording
from vsense_ros.driver.gnss_stream import FrameFilter, ReceiverDecoder, crc_24q
from vsense_ros.messages.recording import Sample

SECOND = 1_000_000_000
NOON = 1_714_564_800 * SECOND  # 2024-05-01


def sentence(body: str) -> bytes:
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}\r\n".encode()


def pvt(tenths: int) -> bytes:
    """NAV-PVT at 10 Hz, 20 m/s to the east."""
    return UBXMessage(
        "NAV", "NAV-PVT", 0, iTOW=302_418_000 + 100 * tenths, year=2024, month=5, day=1, hour=12,
        min=tenths // 600, second=tenths // 10 % 60, validDate=1, validTime=1, fullyResolved=1, tAcc=20,
        nano=tenths % 10 * 100_000_000, fixType=3, gnssFixOk=1, numSV=14, lon=11.0 + tenths * 2.7e-5, lat=48.0,
        height=500_000, hMSL=453_000, hAcc=500, vAcc=900, velN=0, velE=20_000, velD=0, gSpeed=20_000, headMot=90.0,
        sAcc=100, headAcc=0.5, pDOP=1.2,
    ).serialize()  # fmt: skip


def rtcm(payload: bytes) -> bytes:
    frame = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    return frame + crc_24q(frame).to_bytes(3, "big")


def nmea(tenths: int) -> bytes:
    clock = f"12{tenths // 600:02d}{tenths // 10 % 60:02d}.00"
    return sentence("GNGSA,A,3,01,02,03,04,,,,,,,,,1.2,0.6,1.0,1") + sentence(
        f"GNGGA,{clock},4800.0000,N,01100.{tenths * 162:04d},E,1,12,0.6,453.0,M,47.0,M,,"
    )


def rmc(tenths: int) -> bytes:
    return sentence(f"GNRMC,1200{tenths // 10:02d}.00,A,4800.0000,N,01100.0000,E,38.9,90.0,010524,,,A")


def drive(order: str, seconds: int = 20) -> bytes:
    """A stream in which NMEA comes once a second, before or behind NAV-PVT, with corrections between."""
    sent = b""
    for tenths in range(10 * seconds):
        parts = {"n": nmea(tenths) if tenths % 10 == 0 else b"", "u": pvt(tenths), "r": rtcm(b"\x43\x50$GPGGA," * 3)}
        sent += b"".join(parts[part] for part in order)
    return sent


def decoded(decoder: ReceiverDecoder, data: bytes, step: int) -> list[Sample]:
    return [s for i in range(0, len(data), step) for s in decoder.feed(data[i : i + step], NOON + i * 1000)]


def test_the_checksum_of_rtcm_is_that_of_a_published_frame() -> None:
    # RTCM 10403, annex: message 1005.
    frame = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")
    assert crc_24q(frame[:-3]) == int.from_bytes(frame[-3:], "big")


@pytest.mark.parametrize("order", ["nur", "unr", "run", "rnu"])
@pytest.mark.parametrize("before", [b"", sentence("GNTXT,01,01,02,u-blox AG - www.u-blox.com,") * 100])
def test_a_file_of_both_gives_the_positions_of_ubx_with_their_date(order: str, before: bytes, tmp_path: Path) -> None:
    (tmp_path / "log.ubx").write_bytes(before + drive(order))
    found = import_recording(tmp_path / "log.ubx")
    for topic in ("gps/fix", "gps/velocity"):
        assert found[topic].stamp.tolist() == [NOON + tenths * SECOND // 10 for tenths in range(200)]
    np.testing.assert_allclose(found["gps/velocity"].columns["linear"], [[20.0, 0.0, 0.0]] * 200)


@pytest.mark.parametrize("step", [1, 7, 64, 100_000])
def test_on_a_line_ubx_takes_over_from_nmea(step: int) -> None:
    decoder = ReceiverDecoder()
    got = decoded(decoder, drive("unr"), step)
    assert sum(s.topic == "gps/fix" for s in got) == sum(s.topic == "gps/velocity" for s in got) == 200
    assert "broken frames" not in " ".join(d.message for d in decoder.diagnostics(got[-1].received or 0))


def test_headings_of_nmea_are_kept_beside_ubx() -> None:
    decoder = ReceiverDecoder()
    got = decoded(decoder, b"".join(pvt(i) + rmc(i) + sentence("GNHDT,90.0,T") for i in range(0, 50, 10)), 400)
    assert sum(s.topic == "gps/attitude" for s in got) > 0
    assert sum(s.topic == "gps/fix" for s in got) == 5


@given(
    st.lists(st.sampled_from([b"text\r\n", b"\xb5", b"\xd3", pvt(3), rtcm(b"abc"), nmea(0)]), max_size=12),
    st.integers(1, 50),
)
def test_what_the_filter_leaves_is_what_is_no_frame(parts: list[bytes], step: int) -> None:
    sent = b"".join(parts) + bytes(5000)  # behind which nothing is waited for
    subject = FrameFilter()
    left = b"".join(subject.feed(sent[i : i + step]) for i in range(0, len(sent), step))
    assert left == b"".join(part for part in parts if part not in (pvt(3), rtcm(b"abc"))) + bytes(5000)
