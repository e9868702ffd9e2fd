"""Requests for the kernels: from the cars of the project, random, and with every special number."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.kernels import Kernel
from vsense_ros.accelerator.kernels.suspension_motion import table
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import DISTURBANCES
from vsense_ros.model.vehicle import Vehicle

Words = NDArray[np.uint32]
SPECIAL = np.array(
    [
        0, 0x80000000, 0x7F800000, 0xFF800000, 0x7FC00000, 0xFFC00001, 0x7F800001, 0x3F800000, 0xBF800000, 0x00800000,
        0x80800000, 0x7F7FFFFF, 0xFF7FFFFF, 1, 0x807FFFFF, 0x3F7FFFFF, 0x00FFFFFF, 0x3F000001, 0x34000000,
    ],
    np.uint32,
)  # fmt: skip


@cache
def prototype() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_model"))


@cache
def _mass_matrix() -> ca.Function:
    car = car_of(prototype())
    acceleration = ca.SX.sym("a", 14)
    matrix = ca.jacobian(car.inertia_times(acceleration), acceleration)
    return ca.Function("mass", [car.q, car.inputs, car.disturbances, car.p, car.internal_state], [matrix])


def mass_matrices(count: int, seed: int) -> NDArray[np.float64]:
    """Mass matrices of the prototype in random positions, (count, 14, 14)."""
    random, vehicle = np.random.default_rng(seed), prototype()
    found = []
    for _ in range(count):
        q = np.concatenate([[0, 0, 0.3], random.normal(0, 0.05, 3), random.normal(0, 0.03, 4), random.normal(0, 9, 4)])
        inputs = np.concatenate([random.normal(0, 0.2, 1), np.zeros(5)])
        found.append(
            np.array(_mass_matrix()(q, inputs, np.zeros(len(DISTURBANCES)), vehicle.parameter_vector(), np.zeros(0)))
        )
    return np.array(found)


def positive_definite(random: np.random.Generator, n: int, count: int) -> NDArray[np.float64]:
    """Symmetric, with condition numbers from 1 to 1e6 and rows of other sizes in every second one, (count, n, n)."""
    q = np.linalg.qr(random.standard_normal((count, n, n)))[0]
    w = 10 ** -(random.uniform(0, 6, (count, 1)) * random.uniform(0, 1, (count, n)))
    a = (q * w[:, None, :]) @ q.transpose(0, 2, 1) * 1500
    scale = np.where(np.arange(count)[:, None] % 2, 10 ** random.uniform(-1, 1, (count, n)), 1.0)
    a = a * scale[:, :, None] * scale[:, None, :]
    return (a + a.transpose(0, 2, 1)) / 2


def with_specials(random: np.random.Generator, words: Words, share: float) -> Words:
    """Requests in which one or two words are special numbers, as a share of all."""
    words = words.copy()
    for i in np.flatnonzero(random.random(len(words)) < share):
        for _ in range(random.integers(1, 3)):
            words[i, random.integers(words.shape[1])] = random.choice(SPECIAL)
    return words


def requests(kernel: Kernel, count: int, seed: int = 0, specials: float = 0.15) -> Words:
    """Requests of a kernel (count, words_in)."""
    random = np.random.default_rng(seed)
    if kernel.size:
        n = kernel.size
        a = positive_definite(random, n, count)
        if n == 14:
            known = mass_matrices(min(40, count // 4), seed)
            a[: len(known)] = known
        b = random.standard_normal((count, n, 1)) * 10 ** random.uniform(-3, 4, (count, 1, 1))
        words = np.concatenate([a, b], axis=2).astype(np.float32).view(np.uint32).reshape(count, -1)
    elif kernel.name == "body_mass":
        j = random.standard_normal((count, 3, 3))
        j = np.einsum("kij,klj->kil", j, j) * 10 ** random.uniform(-2, 3, (count, 1, 1))
        r = np.linalg.qr(random.standard_normal((count, 3, 3)))[0]
        flat = [r.reshape(count, 9), j[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]]
        flat += [random.normal(0, 1, (count, 3)), 10 ** random.uniform(0, 3, (count, 1))]
        words = np.concatenate(flat, axis=1).astype(np.float32).view(np.uint32)
    else:
        given = np.stack([*random.uniform(-1, 1, (2, count, 4)), random.normal(0, 5, (count, 4))], axis=-1)
        words = given.astype(np.float32).reshape(count, 12).view(np.uint32)
    return with_specials(random, words, specials)


def tables() -> Words:
    """Coefficients of the prototype's suspensions."""
    suspension = prototype().suspension
    assert suspension is not None
    return table(dict(suspension.front), dict(suspension.rear))
