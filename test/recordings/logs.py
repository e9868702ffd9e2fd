"""Tables and logs of one drive as the programs and devices write them that people measure cars with.

The headers, units, times and signs are those of the programs; the values are a generated drive's. Each log says what
must come of it: which signals, and when the drive begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from recordings import planted

G = 9.80665  # [m/s²]
BEGIN = datetime(2024, 10, 27, 14, 59, 54, tzinfo=UTC)
RATE = 50  # [Hz]
RADIUS = 0.32  # [m] that is assumed where a table has the speeds of wheels at their rims

Columns = Mapping[str, np.ndarray]
Cells = Sequence[object]


def drive(manoeuvre: str = "double_lane_change", vehicle: str = "prototype_real") -> dict[str, np.ndarray]:
    """A drive by what is measured, all at the same times, in SI units and the axes of ISO 8855."""
    recording = planted.drive(manoeuvre, vehicle, 0)
    begin = recording["imu/data"].stamp[0]
    t = np.arange(0.2, 11.5, 1 / RATE)

    def at(topic: str, field: str, column: int) -> np.ndarray:
        channel = recording[topic]
        return np.interp(t, (channel.stamp - begin) * 1e-9, channel.columns[field][:, column])

    east, north = (at("gps/velocity", "linear", axis) for axis in (0, 1))
    found = {
        "t": t - t[0],
        "speed": np.hypot(east, north),
        "course": np.degrees(np.arctan2(east, north)) % 360,
        "latitude": at("gps/fix", "latitude", 0),
        "longitude": at("gps/fix", "longitude", 0),
        "altitude": at("gps/fix", "altitude", 0),
        "steering": at("vehicle/steering", "position", 0),
    }
    found |= {f"w{axis}": at("imu/data", "angular_velocity", i) for i, axis in enumerate("xyz")}
    found |= {f"a{axis}": at("imu/data", "linear_acceleration", i) for i, axis in enumerate("xyz")}
    found |= {wheel: at("vehicle/wheel_speeds", "velocity", i) for i, wheel in enumerate(("fl", "fr", "rl", "rr"))}
    return found


@dataclass(frozen=True)
class Log:
    """A log: how it is written, which signals it has, and the Unix time at which it begins, None without a date.

    `signals` are names of `drive`; `dbc` is the database of a CAN log.
    """

    write: Callable[[Path, Columns], Path]
    signals: tuple[str, ...]
    begin: float | None = BEGIN.timestamp()
    dbc: str | None = None


def dates(d: Columns, form: str) -> list[str]:
    return [(BEGIN + timedelta(seconds=float(t))).strftime(form) for t in d["t"]]


def milliseconds(d: Columns, form: str) -> list[str]:
    """Dates whose seconds have three decimals."""
    return [text[:-3] for text in dates(d, form)]


def packed(d: Columns) -> list[str]:
    return [(BEGIN + timedelta(seconds=float(t))).strftime("%H%M%S.%f")[:9] for t in d["t"]]


def unix(d: Columns) -> np.ndarray:
    return BEGIN.timestamp() + d["t"]


def number(value: object, decimals: int, decimal: str = ".") -> str:
    return value if isinstance(value, str) else f"{value:.{decimals}f}".replace(".", decimal)


def text_table(
    name: str,
    columns: Callable[[Columns], Mapping[str, Cells | tuple[str, Cells]]],
    *,
    above: Sequence[str] = (),
    units: bool = False,
    blank: bool = False,
    delimiter: str = ",",
    decimal: str = ".",
    quoted: bool = False,
    decimals: int = 7,
    encoding: str = "utf-8",
    then: Callable[[list[str]], list[str]] = lambda lines: lines,
) -> Callable[[Path, Columns], Path]:
    """A writer of a table: names, with `units` in a line below them, and rows; `then` changes the lines of it.

    A column may be a name and its values, where a name stands more than once or in other words.
    """

    def write(folder: Path, d: Columns) -> Path:
        own = columns(d)
        names = [value[0] if isinstance(value, tuple) else key for key, value in own.items()]
        cells = [value[1] if isinstance(value, tuple) else value for value in own.values()]
        heads = [name.partition("|")[0] for name in names]
        first = [*above, _row(heads, delimiter, quoted)]
        if units:
            first.append(_row([name.partition("|")[2] for name in names], delimiter, quoted))
        first += [""] * blank
        rows = [
            _row([number(value, decimals, decimal) for value in row], delimiter, quoted)
            for row in zip(*cells, strict=True)
        ]
        path = folder / name
        path.write_text("\n".join(then([*first, *rows])) + "\n", encoding=encoding)
        return path

    return write


def _row(cells: Sequence[str], delimiter: str, quoted: bool) -> str:
    return delimiter.join(f'"{cell}"' if quoted else cell for cell in cells)


def kmh(d: Columns) -> np.ndarray:
    return d["speed"] * 3.6


def rim(d: Columns, wheel: str) -> np.ndarray:
    """Speed of a wheel at its rim [km/h]."""
    return d[wheel] * RADIUS * 3.6


def held(values: np.ndarray, rows: int) -> np.ndarray:
    """Values that a slower source brings every few rows."""
    return np.repeat(values[::rows], rows)[: len(values)]


def degrees(d: Columns, name: str) -> np.ndarray:
    return np.degrees(d[name])


def constant(d: Columns, value: float) -> np.ndarray:
    return np.full(len(d["t"]), value)


def counted(d: Columns) -> list[str]:
    return [str(i) for i in range(len(d["t"]))]


def vbo(names: Sequence[str], columns: Callable[[Columns], Sequence[Cells]]) -> Callable[[Path, Columns], Path]:
    """A writer of a VBO file with columns of these names besides the usual ones."""

    def write(folder: Path, d: Columns) -> Path:
        long = "lng" if "x-rotation-gyroscope" in names else "long"
        head = [
            "File created on 27/10/2024 at 14:59:54",
            "",
            "[header]",
            "time",
            "latitude",
            "longitude",
            "",
            "[comments]",
        ]
        every = f"time lat {long} velocity heading height {' '.join(names)}"
        head += ["Log Rate (Hz) : 50.00", "", "[column names]", every, "", "[data]"]
        own = [packed(d), d["latitude"] * 60, -d["longitude"] * 60, kmh(d), d["course"], d["altitude"], *columns(d)]
        rows = (
            " ".join(cell if isinstance(cell, str) else f"{cell:+.6f}" for cell in row)
            for row in zip(*own, strict=True)
        )
        path = folder / "lap.vbo"
        path.write_text("\r\n".join([*head, *rows]) + "\r\n", encoding="ascii", newline="")
        return path

    return write


def one_value_a_row(folder: Path, d: Columns) -> Path:
    """Car Scanner."""
    lines = ['"SECONDS";"PID";"VALUE";"UNITS"']
    for t, speed, turned in zip(d["t"], kmh(d), degrees(d, "steering"), strict=True):
        lines += [
            f'"{t:.3f}";"Vehicle speed";"{speed:.6f}";"km/h"',
            f'"{t:.3f}";"Engine RPM";"{2000 + speed:.1f}";"rpm"',
        ]
        lines.append(f'"{t:.3f}";"Steering wheel angle";"{turned:.6f}";"°"')
    path = folder / "carscanner.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def repeated_header(lines: list[str]) -> list[str]:
    return [*lines[:200], lines[0], *lines[200:]]


def laps(lines: list[str]) -> list[str]:
    return [*lines[:100], "# Lap 0: 00:01:02.345", *lines[100:]]


def spreadsheet(lines: list[str]) -> list[str]:
    width = max(line.count(",") for line in lines)
    return [line + "," * (width - line.count(",")) for line in lines]
