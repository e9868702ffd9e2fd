"""CAN logs as text: the examples of the programs' own documentation, and damaged lines that cost themselves alone."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.driver.can_log import format_of, read_frames

BUSMASTER = """***BUSMASTER Ver 2.4.0***
***PROTOCOL CAN***
***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***
***[START LOGGING SESSION]***
***START DATE AND TIME 8:8:2014 11:49:7:965***
***HEX***
***SYSTEM MODE***
***START CHANNEL BAUD RATE***
***CHANNEL 1 - Kvaser Leaf Light HS - 500000 bps***
***END CHANNEL BAUD RATE***
***START DATABASE FILES (DBF/DBC)***
***END OF DATABASE FILES (DBF/DBC)***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
11:49:12:9420 Rx 1 0x023 s 1 40
11:49:12:9440 Rx 1 0x460 s 8 03 E0 00 00 C0 00 00 00
11:49:13:0000 Tx 2 0x18FEF100 x 3 01 02 03
11:49:13:0100 Rx 1 0x123 sr 0
***END DATE AND TIME 8:8:2014 11:50:7:965***
***[STOP LOGGING SESSION]***
"""
CRTD = """1320745424.000 CXX OVMS CRTD
1320745424.000002 1R11 402 FA 01 C3 A0 96 00 07 01
1320745424.015 2R29 18FEF100 01 02
1320745424.016 1T11 7DF 02 3E 01
1320745424.020 1CEV can error
"""
VEHICLE_SPY = """Vehicle Spy 3
Number of messages,3
Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,Arb ID,Remote,Xtd,B1,B2,B3,B4,B5,B6,B7,B8,Value
1,0.000812,0.000812,67108868,F,F,HS CAN $402,HS CAN,,402,F,F,FA,01,C3,A0,96,00,07,01,
2,0.010812,0.010000,67108868,F,F,HS CAN $18FEF100,MS CAN,,18FEF100,F,T,01,02,,,,,,,
"""
MICROCHIP = """//---------------------------------
Microchip Technology Inc.
CAN BUS Analyzer
Logging Started: 8/8/2014 11:49:07
//---------------------------------
1247;RX;0xC2;8;0x5C;0x87;0x00;0x00;0x01;0x00;0x00;0x1C
1248;RX;0x18FEF100;1;0x10;0x00;0x00;0x00;0x00;0x00;0x00;0xF0
"""
LOGS = {"busmaster": BUSMASTER, "crtd": CRTD, "vehicle_spy": VEHICLE_SPY, "microchip": MICROCHIP}


def frames(text: str, folder: Path, name: str = "drive.log") -> CanFrames:
    (folder / name).write_text(text, encoding="utf-8")
    return read_frames(folder / name)


def data(found: CanFrames, row: int) -> bytes:
    return bytes(found.rows(np.array([row]))[0])


@pytest.mark.parametrize("name", LOGS)
def test_a_format_is_known_by_its_beginning(name: str, tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_text(LOGS[name], encoding="utf-8")
    assert format_of(tmp_path / "drive.log") == name


def test_busmaster_has_days_months_years_and_tenths_of_milliseconds(tmp_path: Path) -> None:
    found = frames(BUSMASTER, tmp_path)
    midnight = datetime(2014, 8, 8, tzinfo=UTC).timestamp()
    assert found.time - midnight == pytest.approx([42_552.942, 42_552.944, 42_553.0], abs=1e-5)
    assert found.identifier.tolist() == [0x23, 0x460, 0x18FEF100]
    assert found.is_extended.tolist() == [False, False, True]
    assert [found.channels[i] for i in found.channel] == ["1", "1", "2"]
    assert data(found, 1) == bytes.fromhex("03E00000C0000000")


def test_relative_times_of_busmaster_are_summed_and_decimal_bytes_are_decimal(tmp_path: Path) -> None:
    text = BUSMASTER.replace("***SYSTEM MODE***", "***RELATIVE MODE***").replace("***HEX***", "***DEC***")
    head = text[: text.index("11:49:12:9420")]
    found = frames(head + "0:00:00:0100 Rx 1 35 s 1 64\n0:00:00:0200 Rx 1 35 s 2 255 10\n", tmp_path)
    start = datetime(2014, 8, 8, 11, 49, 7, 965_000, tzinfo=UTC).timestamp()
    assert found.time - start == pytest.approx([0.01, 0.03], abs=1e-5)
    assert data(found, 1) == b"\xff\x0a"


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    head = BUSMASTER[: BUSMASTER.index("11:49:12:9420")].replace("11:49:7:965", "23:59:59:0")
    found = frames(head + "23:59:59:9000 Rx 1 0x023 s 1 40\n0:00:00:1000 Rx 1 0x023 s 1 40\n", tmp_path)
    assert np.diff(found.time) == pytest.approx(0.2, abs=1e-5)


def test_crtd_has_unix_times_and_buses(tmp_path: Path) -> None:
    found = frames(CRTD, tmp_path)
    assert found.time.tolist() == [1320745424.000002, 1320745424.015, 1320745424.016]
    assert [found.channels[i] for i in found.channel] == ["1", "2", "1"]
    assert found.is_extended.tolist() == [False, True, False]
    assert data(found, 0) == bytes.fromhex("FA01C3A096000701")


def test_vehicle_spy_has_networks_and_short_frames(tmp_path: Path) -> None:
    found = frames(VEHICLE_SPY, tmp_path, "drive.csv")
    assert found.time.tolist() == [0.000812, 0.010812]
    assert found.identifier.tolist() == [0x402, 0x18FEF100]
    assert found.length.tolist() == [8, 2]
    assert found.channels == ("HS CAN", "MS CAN")


def test_the_analyser_of_microchip_writes_more_bytes_than_a_frame_has(tmp_path: Path) -> None:
    found = frames(MICROCHIP, tmp_path)
    assert found.time.tolist() == [1.247, 1.248]
    assert found.length.tolist() == [8, 1]
    assert found.is_extended.tolist() == [False, True]


@pytest.mark.parametrize("name", LOGS)
def test_a_damaged_line_costs_itself_alone(name: str, tmp_path: Path) -> None:
    whole = len(frames(LOGS[name], tmp_path))
    lines = LOGS[name].splitlines()
    at = next(
        i
        for i, line in enumerate(lines)
        if "1320745424.015" in line or "0x460" in line or line[:2] == "2," or line.startswith("1248")
    )
    lines[at] = lines[at][: len(lines[at]) // 3] + "?"
    found = frames("\n".join(lines), tmp_path)
    assert len(found) == whole - 1
    assert any(f"line {at + 1}" in loss for loss in found.losses)
