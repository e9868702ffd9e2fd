"""Tables of numbers without a header, as data sets have them: each row has the same quantities in the same places."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from vsense_ros.bag.importers.build import Array
from vsense_ros.errors import InputError


def numbers(path: Path, width: int, delimiter: str | None = ",") -> Array:
    """The rows (n, width) of a file, without those that have another number of values, such as one that was cut.

    Raises `InputError` where no row has `width` numbers.
    """
    if not path.is_file():
        raise InputError(f"{path}: missing; the data set has it")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a short row is left out below, an empty file refused
        try:
            rows = np.genfromtxt(
                path, np.float64, delimiter=delimiter, usecols=range(width), invalid_raise=False, encoding="utf-8"
            )
        except (ValueError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: not a table of numbers: {error}") from None
    rows = np.atleast_2d(rows)
    if rows.shape[1] != width or not np.isfinite(rows[:, 0]).any():
        raise InputError(f"{path}: expected rows of {width} numbers, found none")
    return rows[np.isfinite(rows[:, 0])]
