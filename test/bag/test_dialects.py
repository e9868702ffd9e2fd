"""Tables in the dialects of loggers: the proposed mapping reads them unedited, and says units and times rightly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from vsense_ros.bag.importers import import_recording
from vsense_ros.bag.importers.dialect import dialect_of
from vsense_ros.bag.importers.guess import guess
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

START = datetime(2024, 10, 27, 14, 59, 54, tzinfo=UTC)
T = np.arange(120) * 0.05  # [s]
SPEED = 20.0 + np.sin(0.5 * T)  # [m/s]
STEERING = 0.3 * np.sin(T)  # [rad]


def dates(form: str) -> list[str]:
    return [(START + timedelta(seconds=float(t))).strftime(form) for t in T]


def table(times: Sequence[object], time: str = "Time", delimiter: str = ",", decimal: str = ".") -> list[str]:
    head = delimiter.join((time, "Vehicle Speed (km/h)", "Steering Angle [deg]"))
    rows = (
        delimiter.join((str(t), f"{v * 3.6:.6f}".replace(".", decimal), f"{np.degrees(s):.6f}".replace(".", decimal)))
        for t, v, s in zip(times, SPEED, STEERING, strict=True)
    )
    return [head, *rows]


def motec() -> list[str]:
    above = ['"Format","MoTeC CSV File","","","Workbook","wb"', '"Sample Rate","20.000","Hz","","End Time","6.0","s"']
    body = ['"Time","Ground Speed","Steered Angle"', '"s","km/h","deg"', ""]
    rows = [f'"{t:.3f}","{v * 3.6:.6f}","{np.degrees(s):.6f}"' for t, v, s in zip(T, SPEED, STEERING, strict=True)]
    return [*above, "", *body, *rows]


def one_value_a_row() -> list[str]:
    lines = ['"SECONDS";"PID";"VALUE";"UNITS"']
    for t, v, s in zip(T, SPEED, STEERING, strict=True):
        lines += [f'"{t:.3f}";"Vehicle speed";"{v * 3.6:.6f}";"km/h"']
        lines += [f'"{t:.3f}";"Steering wheel angle";"{np.degrees(s):.6f}";"deg"']
    return lines


def with_laps() -> list[str]:
    lines = table([f"{t:.3f}" for t in T])
    return [
        "# RaceRender Data: TrackAddict",
        "# User Settings: SL1;U1",
        *lines[:60],
        "# Lap 0: 00:01:02.1",
        *lines[60:],
    ]


def with_repeated_header() -> list[str]:
    lines = table(dates("%d-%b-%Y %H:%M:%S.%f"), " Device Time")
    return [*lines[:40], lines[0], *lines[40:]]


def padded_by_a_spreadsheet() -> list[str]:
    lines = table([f"{t:.3f}" for t in T])
    return ["Session,Track day,", "Vehicle,Car,", ",,", lines[0], "s,km/h,deg", ",,", *lines[1:]]


DIALECTS: dict[str, Callable[[], list[str]]] = {
    "milliseconds": lambda: table((T * 1000).round().astype(int)),
    "microseconds": lambda: table((T * 1e6).round().astype(int), "t"),
    "Unix milliseconds": lambda: table([round(1.73e12 + t * 1000) for t in T]),
    "days of a spreadsheet": lambda: table([f"{45000.5 + t / 86400:.10f}" for t in T], "t"),
    "12-hour clock": lambda: table(dates("%m/%d/%Y %I:%M:%S.%f %p")),
    "day.month.year": lambda: table(dates("%d.%m.%Y %H:%M:%S.%f"), delimiter=";", decimal=","),
    "ISO": lambda: table(dates("%Y-%m-%dT%H:%M:%S.%f")),
    "packed time of day over a full minute": lambda: table(dates("%H%M%S.%f")),
    "time of day": lambda: table(dates("%H:%M:%S.%f")),
    "decimal comma": lambda: table([f"{t:.3f}".replace(".", ",") for t in T], delimiter=";", decimal=","),
    "tabs": lambda: table([f"{t:.3f}" for t in T], delimiter="\t"),
    "MoTeC": motec,
    "Car Scanner": one_value_a_row,
    "TrackAddict": with_laps,
    "Torque": with_repeated_header,
    "AiM in a spreadsheet": padded_by_a_spreadsheet,
}


def proposed(path: Path) -> Recording:
    mapping = YAML(typ="safe").load(guess(path).text)
    return import_recording(path, mapping=mapping)


def assert_is_the_drive(recording: Recording) -> None:
    speed, steering = recording["vehicle/velocity"], recording["vehicle/steering"]
    assert speed.seconds == pytest.approx(T, abs=2e-4)
    assert speed.columns["linear"][:, 0] == pytest.approx(SPEED, abs=1e-5)
    assert steering.seconds == pytest.approx(T, abs=2e-4)
    assert steering.columns["position"][:, 0] == pytest.approx(STEERING, abs=1e-6)


@pytest.mark.parametrize("name", DIALECTS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
def test_what_is_proposed_for_a_dialect_reads_it_unedited(name: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(DIALECTS[name]()) + "\n", encoding=encoding)
    assert_is_the_drive(proposed(path))


def test_dates_keep_their_day(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(DIALECTS["12-hour clock"]()), encoding="utf-8")
    first = int(proposed(path)["vehicle/velocity"].stamp[0])
    assert first == pytest.approx(START.timestamp() * 1e9, abs=1e6)


def test_accelerations_in_g_and_in_metres_are_told_apart_by_the_speed_and_the_yaw_rate(tmp_path: Path) -> None:
    rate = 0.07 * np.sin(T)
    for unit, factor in (("g", 9.80665), ("m/s²", 1.0)):
        path = tmp_path / "drive.csv"
        side = SPEED * rate / factor
        rows = [f"{t:.2f},{v:.4f},{w:.6f},{a:.6f}" for t, v, w, a in zip(T, SPEED, rate, side, strict=True)]
        path.write_text("\n".join(["t,speed [m/s],yaw rate [rad/s],ay", *rows]), encoding="utf-8")
        found = YAML(typ="safe").load(guess(path).text)["topics"]["imu/data"]["linear_acceleration"][1]
        assert found["unit"] == ("g" if unit == "g" else "m/s²")


def test_a_text_without_a_table_is_refused_with_what_was_expected(tmp_path: Path) -> None:
    path = tmp_path / "letter.csv"
    path.write_text("Dear reader,\nthis is no table, but prose.\nYours, nobody\n", encoding="utf-8")
    with pytest.raises(InputError, match="no header above rows of numbers"):
        dialect_of(path)
