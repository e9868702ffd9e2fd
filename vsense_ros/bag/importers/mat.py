"""MATLAB files by a column mapping (see `mapping.py`): version 5 by SciPy, version 7.3 (HDF5) by h5py.

A `column` of the mapping is a variable, or a field of a structure: `imu.yaw_rate`. The time column is one of them.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.columns import recording_from
from vsense_ros.bag.importers.mapping import Column, Ref, unit_in_name
from vsense_ros.errors import InputError
from vsense_ros.messages import units
from vsense_ros.messages.recording import Recording

NAME = "mat"
DESCRIPTION = "MATLAB file with a column mapping (.mat, version 5 or 7.3)"

_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class MatLimits:
    """Bounds on what a MATLAB file may make its reader allocate: decisions of this project."""

    inflation: int = 64  # [-] times the size of the file that a variable may have
    ordinary: int = 1 << 28  # [byte] that any variable may have
    deepest: int = 8  # structures in structures


LIMITS = MatLimits()


def matches(path: Path) -> bool:
    """True if `path` is named like a MATLAB file."""
    return path.is_file() and path.suffix.lower() == ".mat"


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """The topics that the mapping makes of the variables; by default the mapping is the YAML file of the same name."""
    wanted = mapping_file.load(mapping_file.default_mapping(path, mapping), path)
    name, unit = wanted.time.column, wanted.time.unit
    variables_of_file = variables(path)
    if wanted.time.rate is not None:
        name = f"of {wanted.time.rate:g} rows a second"
        longest = max((len(_variable(path, variables_of_file, str(ref.name))) for ref in wanted.columns()), default=0)
        variables_of_file[name] = np.arange(longest) / (wanted.time.rate * units.to_si(unit))
    if not isinstance(name, str):
        raise InputError(
            f"{path}: the mapping names no time variable; expected time: {{column: …, unit: s}}, or {{rate: …}} where "
            "there is none"
        )
    if units.quantity_of(unit) != "time":
        raise InputError(
            f"mapping: time: unit {unit!r} is no unit of time; known: {', '.join(units.QUANTITIES['time'])}"
        )
    time = _variable(path, variables_of_file, name) * units.to_si(unit)
    if not np.isfinite(time).all() or not len(time):
        raise InputError(f"{path}: {int((~np.isfinite(time)).sum())} of the times in {name!r} are no numbers")

    def column(ref: Ref) -> Column:
        values = _variable(path, variables_of_file, str(ref.name))
        if len(values) != len(time):
            raise InputError(f"{path}: {ref.name!r} has {len(values)} values, its time {name!r} has {len(time)}")
        return Column(time, values, unit_in_name(str(ref.name)))

    return recording_from(wanted, column, path.stem, NAME)


def variables(path: Path) -> dict[str, Array]:
    """All variables of numbers with more than one value, (n,), by name; fields of structures behind dots."""
    with path.open("rb") as file:
        head = file.read(1024)
    if not head:
        raise InputError(f"{path}: the file is empty; expected a MATLAB file")
    return dict(_hdf5(path)) if _HDF5 in (head[:8], head[512:520]) else dict(_version5(path))


def _variable(path: Path, variables: Mapping[str, Array], name: str) -> Array:
    if name not in variables:
        raise InputError(
            f"{path}: no variable {name!r} of numbers; found: {', '.join(sorted(variables)[:40]) or 'none'}"
        )
    return variables[name]


def _version5(path: Path) -> Iterator[tuple[str, Array]]:
    import scipy.io

    try:
        content = scipy.io.loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
    except MemoryError:
        raise
    except (
        ValueError,
        TypeError,
        LookupError,
        NotImplementedError,
        OSError,
        EOFError,
        zlib.error,
        OverflowError,
    ) as error:
        raise InputError(f"{path}: not a MATLAB file that can be read: {error}") from None
    except Exception as error:
        if type(error).__module__.partition(".")[0] != "scipy":
            raise
        raise InputError(f"{path}: not a MATLAB file that can be read: {error}") from None
    yield from _flat("", content, 0)


def _flat(prefix: str, content: Any, depth: int) -> Iterator[tuple[str, Array]]:
    if depth > LIMITS.deepest:
        return
    if isinstance(content, Mapping):
        for name, value in content.items():
            if not str(name).startswith("__"):
                yield from _flat(f"{prefix}.{name}" if prefix else str(name), value, depth + 1)
        return
    if not isinstance(content, np.ndarray) or content.dtype.kind not in "biuf" or content.size < 2:
        return
    if content.ndim == 2 and 1 < min(content.shape) <= 32:  # a column each
        table = content if content.shape[0] >= content.shape[1] else content.T
        for index in range(table.shape[1]):
            yield f"{prefix}({index + 1})", table[:, index].astype(np.float64)
    elif max(content.shape) == content.size:
        yield prefix, content.ravel().astype(np.float64)


def _hdf5(path: Path) -> Iterator[tuple[str, Array]]:
    import h5py

    bound = max(LIMITS.inflation * path.stat().st_size, LIMITS.ordinary)
    try:
        with h5py.File(path, "r") as file:
            yield from _group(path, "", file, bound, 0)
    except MemoryError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        raise InputError(f"{path}: not a MATLAB file of version 7.3 that can be read: {error}") from None


def _group(path: Path, prefix: str, group: Any, bound: int, depth: int) -> Iterator[tuple[str, Array]]:
    import h5py

    for name in group:
        if name.startswith("#") or depth > LIMITS.deepest:
            continue
        full = f"{prefix}.{name}" if prefix else name
        if isinstance(group.get(name, getlink=True), h5py.ExternalLink | h5py.SoftLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _group(path, full, item, bound, depth + 1)
            continue
        if item.external or item.is_virtual:
            raise InputError(
                f"{path}: {full!r} is in another file, which is not read; expected data in the file itself"
            )
        if item.dtype.kind not in "biuf" or item.size < 2 or item.ndim > 2 or item.attrs.get("MATLAB_empty"):
            continue
        if item.nbytes > bound:
            raise InputError(f"{path}: {full!r} promises {item.nbytes} bytes, which a file of this size cannot hold")
        yield from _flat(full, np.asarray(item[()]).T, 0)
