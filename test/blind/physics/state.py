"""States that are no rigid body's: lags, temperatures, liquids, the driver's arms. Rows of one array (n, lanes)."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

_ROWS = (
    ("slip_angle", 4),  # lagged [rad]
    ("warmth", 4),  # of the treads over ambient [K]
    ("bush", 4),  # toe from bushings [rad]
    ("twist", 1),  # of the steering column, at the road wheels [rad]
    ("hands", 1),  # steering-wheel angle held by the driver [rad]
    ("slack", 1),  # steering-wheel angle behind a free play [rad]
    ("slosh", 2),  # place across of moving liquid and its speed [m, m/s]
    ("cargo", 2),  # place across of loose cargo and its speed [m, m/s]
    ("hitch", 2),  # angle of a trailer and its rate [rad, rad/s]
    ("shaft", 2),  # drive torque behind the shafts and its rate, over the demanded [N m, N m/s]
    ("brake_heat", 1),  # [MJ]
)

PLACES: dict[str, slice] = {}
_at = 0
for _name, _count in _ROWS:
    PLACES[_name] = slice(_at, _at + _count)
    _at += _count
SIZE = _at


def split(array: np.ndarray) -> SimpleNamespace:
    """Views of the rows by name; a single row has the shape (lanes,)."""
    return SimpleNamespace(**{name: array[p] if p.stop - p.start > 1 else array[p.start] for name, p in PLACES.items()})


def zeros(lanes: int) -> np.ndarray:
    return np.zeros((SIZE, lanes))
