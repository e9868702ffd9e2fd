"""Parts of a car that an accelerator computes in binary32: of the simplified one suspension tables and inertias of the
wheels, of the full one the matrices of all bodies.

Every result is checked by what it costs little to know of it: the columns of the tables by their sum, which is a
polynomial, too (Huang & Abraham 1984); the inertia of a wheel by its trace, its size, and that its axle is a principal
axis. What fails the check, or does not come in time, is computed by the processor in double precision.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.accelerator.client import Client
from vsense_ros.accelerator.kernels import BODY_MASS, SUSPENSION_MOTION
from vsense_ros.accelerator.kernels.suspension_motion import table
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.model.car.parts import CarInParts
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.multibody.outside import turned
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

PARTS = ("suspension_motion", "body_mass")
ROUNDING = 2.0**-19  # of a sum of the tables' columns, relative to the sizes of its terms: 32 units in the last place
MATCHING = 1e-5  # of an inertia with what is known of it


@dataclass(frozen=True)
class Parts:
    """Which of `PARTS` a client has computed for a car. Raises `InputError` for others."""

    client: Client
    names: Collection[str] = PARTS

    def __post_init__(self) -> None:
        if unknown := [name for name in self.names if name not in PARTS]:
            raise InputError(f"no part {', '.join(unknown)} of a car is computed elsewhere; there are {PARTS}")


def turned_by(client: Client) -> Callable[[Array], Array]:
    """`model.multibody.outside.turned` by an accelerator, one body after the other."""

    def turn(bodies: Array) -> Array:
        results, requests = np.zeros((len(bodies), BODY_MASS.words_out)), bodies.astype(np.float32).view(np.uint32)
        for i, body in enumerate(bodies):
            result = client.request(BODY_MASS, requests[i], partial(_is_of_body, body))
            results[i] = turned(bodies[i : i + 1])[0] if result is None else result
        return results

    return turn


def _is_of_body(body: Array, result: NDArray[np.float32]) -> bool:
    """True if R J Rᵀ and m R s (9,) may be those of a body (19,): turned, they keep trace and size."""
    xx, xy, xz, yy, yz, zz, *moment = result.astype(float).tolist()
    moments, size = body[9:12], float((body[9:12] ** 2).sum() + 2 * (body[12:15] ** 2).sum())
    squares = xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)
    length = float(body[18] * np.sqrt((body[15:18] ** 2).sum()))
    return bool(
        abs(xx + yy + zz - moments.sum()) <= MATCHING * moments.sum()
        and abs(squares - size) <= MATCHING * size
        and abs(np.sqrt(sum(x * x for x in moment)) - length) <= MATCHING * length
    )


class OffloadedParts:
    """The parts of one vehicle's car at the place of some arrays: q, u (14), disturbances, inputs, parameters, internal
    state. `update` writes `columns` (18×4) and `inertias` (6×4) of `CarInParts`, to whose arrays, `memory`, a `Kernel`
    of its functions may be bound."""

    def __init__(self, car: CarInParts, vehicle: Vehicle, parts: Parts, arguments: list[Array]) -> None:
        self._client, self._names = parts.client, frozenset(parts.names)
        q, u, *around = arguments
        functions = [car.places_function(), car.columns_function(), car.axes_function(), car.inertias_function()]
        places, columns, axes, inertias = codegen.compiled("parts", functions)
        self.columns, self.inertias = np.zeros(3 * 6 * len(WHEELS)), np.zeros(6 * len(WHEELS))
        self.memory = [self.columns, self.inertias]
        self._places = Kernel(places, [q, u, *around])
        self._columns = Kernel(columns, [q, *around])
        self._axes = Kernel(axes, [q, *around, self.columns])
        self._inertias = Kernel(inertias, [q, *around, self.columns])
        tables = vehicle.suspension
        assert tables is not None  # or there would be no car in parts
        if "suspension_motion" in self._names:
            parts.client.set_table("suspension_motion", table(dict(tables.front), dict(tables.rear)))
        self._sums = [_Sum(dict(axle)) for axle in (tables.front, tables.rear)]
        names = ("wheel_diametral_inertia", "wheel_spin_inertia", "hub_mass", "wheel_mass")
        of_wheels = [[f"{axle}.{name}" for name in names] for axle in ("front", "front", "rear", "rear")]
        self._numbers = np.array([[car.parameter_names.index(name) for name in names] for names in of_wheels])
        self._parameters = around[2]
        self._request = np.zeros((len(WHEELS), BODY_MASS.words_in), np.float32)

    def update(self) -> None:
        """The parts where the arrays have the car."""
        columns = self._moved() if "suspension_motion" in self._names else None
        if columns is None:
            self._columns.call()
            columns = self._columns.results[0].reshape(-1, order="F")
        self.columns[:] = columns
        turned = self._turned() if "body_mass" in self._names else None
        if turned is None:
            self._inertias.call()
            turned = self._inertias.results[0].reshape(-1, order="F")
        self.inertias[:] = turned

    def _moved(self) -> Array | None:
        """The `columns` as the accelerator computes them; None if it does not answer."""
        self._places.call()
        places = self._places.results[0]

        def check(result: NDArray[np.float32]) -> bool:
            received = result.reshape(len(WHEELS), 6, 4)[:, :, :3].sum(axis=1, dtype=float)
            return all(self._sums[i // 2].agrees(received[i], places[0, i], places[1, i]) for i in range(len(WHEELS)))

        words = places.reshape(-1, order="F").astype(np.float32).view(np.uint32)
        answer = self._client.request(SUSPENSION_MOTION, words, check)
        return None if answer is None else answer.reshape(len(WHEELS), 6, 4)[:, :, :3].astype(float).reshape(-1)

    def _turned(self) -> Array | None:
        """`inertias` by the accelerator, one request for each wheel."""
        self._axes.call()
        turns = self._axes.results[0]
        inertias = np.zeros((len(WHEELS), 6))
        for i, (across, along, hub, wheel) in enumerate(self._parameters[self._numbers].tolist()):
            turn = turns[:, i].reshape(3, 3)

            def check(result: NDArray[np.float32], turn: Array = turn, a: float = across, b: float = along) -> bool:
                return _is_inertia(result, turn, a, b)

            request = self._request[i]
            request[:9], request[9:12], request[18] = turns[:, i], (across, along, across), hub + wheel
            result = self._client.request(BODY_MASS, request.view(np.uint32), check)
            if result is None:
                return None
            inertias[i] = result[:6]
        return inertias.reshape(-1)


class _Sum:
    """The sum of an axle's columns, and by how much single precision may miss it."""

    def __init__(self, columns: dict[str, tuple[tuple[float, ...], ...]]) -> None:
        shape = [max(np.shape(c)[axis] for c in columns.values()) for axis in (0, 1)]
        padded = [
            np.pad(np.asarray(c, float), [(0, n - k) for n, k in zip(shape, np.shape(c), strict=True)])
            for c in columns.values()
        ]
        self._sum = np.sum(padded, axis=0)
        sizes = np.abs(padded).sum(axis=(0, 2))
        order = np.arange(len(sizes))
        self._allowed = ROUNDING * np.array([sizes @ w for w in (np.ones(len(sizes)), order, order * (order - 1) / 2)])

    def agrees(self, received: Array, along: float, across: float) -> bool:
        """True if value, slope and half curvature (3,) are those of the sum at ξ and η."""
        rows = self._sum @ across ** np.arange(self._sum.shape[1])
        value, slope, half = rows[-1], 0.0, 0.0
        for row in rows[-2::-1]:
            half, slope, value = half * along + slope, slope * along + value, value * along + row
        # What single precision makes of ξ and η counts, too.
        return bool((np.abs(received - (value, slope, half)) <= self._allowed + 1e-12).all())


def _is_inertia(result: NDArray[np.float32], turn: Array, across: float, along: float) -> bool:
    """True if xx xy xz yy yz zz and m R s (9,) belong to a wheel with axes `turn` (3×3) and its centre of gravity in
    its middle."""
    xx, xy, xz, yy, yz, zz = result[:6].astype(float)
    matrix, axle = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), turn[:, 1]
    size = 2 * across**2 + along**2
    return bool(
        abs(xx + yy + zz - 2 * across - along) <= MATCHING * (2 * across + along)
        and abs(float((matrix**2).sum()) - size) <= MATCHING * size
        and np.abs(matrix @ axle - along * axle).max() <= MATCHING * (across + along)
        and not result[6:].any()
    )
