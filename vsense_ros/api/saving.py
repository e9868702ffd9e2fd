"""Tables into files of other programs: CSV, Parquet, MATLAB, MDF 4; and recordings into MCAP.

Names carry units (`side_slip [rad]`) where a format has no place for them. Times are written twice: `time [s]` since
the first row, and `stamp [ns]` since the Unix epoch (or as the recording counts), which loses nothing.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from vsense_ros.bag import write_bag
from vsense_ros.errors import InputError
from vsense_ros.extras import explained
from vsense_ros.files.atomic import atomic_write, in_place_of
from vsense_ros.messages.recording import Recording
from vsense_ros.messages.table import STAMP, TIME, Table, merged

_LONGEST_NAME = 63  # of a MATLAB variable


def save(path: str | Path, recording: Recording, tables: Sequence[Table]) -> None:
    """Write tables of one time or several, or as .mcap the recording that they come from.

    A CSV and a Parquet file have all times in one table, with empty places where a signal was not measured. A MATLAB
    file has a struct for each of several tables, an MDF file a group of channels. A file is there whole or not at all.

    Raises `InputError` for an ending that is not known, `MissingExtra` if the library of a format is not installed.
    """
    target = Path(path)
    check_target(target)
    if target.suffix.lower() == ".mcap":
        _save_mcap(target, recording)
        return
    writer = _WRITERS[target.suffix.lower()]
    with explained():
        writer(target, tables)


def check_target(path: Path) -> None:
    """Raises `InputError` for a file that `save` could not write: an ending that is not known, or no folder for it."""
    endings = [*_WRITERS, ".mcap"]
    if path.suffix.lower() not in endings:
        raise InputError(f"{path}: no format has the ending {path.suffix!r}; there are {', '.join(endings)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")


def _save_csv(target: Path, tables: Sequence[Table]) -> None:
    """Commas, a point in numbers, UTF-8; numbers have as many digits as they need to be read back as they were."""
    table = merged(tables)
    columns = [_texts(column.value) for column in table.columns]
    with atomic_write(target) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([TIME, STAMP, *(column.heading for column in table.columns)])
        writer.writerows(zip(map(repr, table.seconds().tolist()), table.stamp.tolist(), *columns, strict=True))


def _texts(values: np.ndarray[Any, Any]) -> list[str]:
    return ["" if value != value else repr(value) for value in values.tolist()]


def _save_parquet(target: Path, tables: Sequence[Table]) -> None:
    """Columns named with their units, which also stand in the metadata of each field; nulls where absent."""
    import pyarrow as pa
    from pyarrow import parquet

    table = merged(tables)
    arrays = [pa.array(table.seconds()), pa.array(table.stamp)]
    fields = [
        pa.field(TIME, pa.float64(), metadata={"unit": "s"}),
        pa.field(STAMP, pa.int64(), metadata={"unit": "ns"}),
    ]
    for column in table.columns:
        arrays.append(pa.array(column.value, from_pandas=True))
        fields.append(pa.field(column.heading, pa.float64(), metadata={"unit": column.unit}))
    with in_place_of(target) as fresh:
        parquet.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), fresh)


def _save_mat(target: Path, tables: Sequence[Table]) -> None:
    """Version 5: `time`, `stamp`, a variable for each signal, and `units`, a struct of the same names; of several
    tables each in a struct of its own."""
    from scipy.io import savemat

    start = min(int(table.stamp[0]) for table in tables)
    structs = [_struct(table, start) for table in tables]
    if len(tables) > 1:
        names = _variables([table.name for table in tables])
        content: Mapping[str, Any] = dict(zip(names, structs, strict=True))
    else:
        content = structs[0]
    with in_place_of(target) as fresh:
        savemat(fresh, dict(content), appendmat=False, long_field_names=True, do_compression=True, oned_as="column")


def _struct(table: Table, start: int) -> dict[str, Any]:
    names = _variables([column.name.removeprefix(f"{table.name}/") for column in table.columns])
    values = {name: column.value for name, column in zip(names, table.columns, strict=True)}
    units = {name: column.unit for name, column in zip(names, table.columns, strict=True)}
    return {
        "time": table.seconds(start),
        "stamp": table.stamp,
        **values,
        "units": {"time": "s", "stamp": "ns", **units},
    }


def _variables(names: Sequence[str]) -> list[str]:
    """Names that MATLAB takes: letters, digits and underscores, no longer than it allows, and each once."""
    variables: list[str] = []
    for name in names:
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:_LONGEST_NAME]
        plain = plain if plain[:1].isalpha() else f"x{plain}"[:_LONGEST_NAME]
        number = 1
        while plain in variables or plain in ("time", "stamp", "units"):
            number += 1
            ending = f"_{number}"
            plain = plain.removesuffix(f"_{number - 1}")[: _LONGEST_NAME - len(ending)] + ending
        variables.append(plain)
    return variables


def _save_mf4(target: Path, tables: Sequence[Table]) -> None:
    """A group of channels for each table, with units; times count from the start of the measurement in the header."""
    from asammdf import MDF, Signal

    start = min(int(table.stamp[0]) for table in tables)
    # The library gives files the ending that it knows: one of that ending is written, and then takes its place.
    with TemporaryDirectory(dir=target.resolve().parent) as temporary, MDF(version="4.10") as file:
        file.header.start_time = datetime.fromtimestamp(start * 1e-9, UTC)
        for table in tables:
            seconds = table.seconds(start)
            signals = [
                Signal(samples=column.value, timestamps=seconds, name=column.name, unit=column.unit)
                for column in table.columns
            ]
            file.append(signals, acq_name=table.name, comment=table.name, common_timebase=True)
        Path(file.save(Path(temporary) / "measurement.mf4")).replace(target)


def _save_mcap(target: Path, recording: Recording) -> None:
    """One file, without the `metadata.yaml` that a bag folder has beside it."""
    with TemporaryDirectory(dir=target.resolve().parent) as temporary:
        folder = Path(temporary) / target.stem
        write_bag(folder, recording)
        (file,) = folder.glob("*.mcap")
        file.replace(target)


_WRITERS: dict[str, Callable[[Path, Sequence[Table]], None]] = {
    ".csv": _save_csv,
    ".parquet": _save_parquet,
    ".mat": _save_mat,
    ".mf4": _save_mf4,
}
