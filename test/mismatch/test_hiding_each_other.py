"""An accelerometer that has an offset and is turned as well may read right on the whole: only both together show."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.least_squares import fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.search import Search
from vsense_ros.model.constants import GRAVITY

TURNED = 0.05  # [rad] about y: the x axis feels so much less of gravity, which the offset gives back
OFFSET = TURNED * GRAVITY  # [m/s²]
LEAST = 0.03  # gain of an effect
NOISE = {"acceleration": 0.05, "roll_rate": 0.004, "yaw_rate": 0.002}  # m/s², rad/s, rad/s
DRIVES = 2


def candidate(effect: str, axis: str, likely: float) -> Candidate:
    parameter = FreeParameter(f"effects.{effect}.{axis}", "", likely, -1.0, 1.0, added(f"effects.{effect}.{axis}"))
    return Candidate(effect, axis, (parameter,), effect)


CANDIDATES = {
    "offset": candidate("accelerometer_bias", "x", 0.3),
    "turned": candidate("imu_pitch_misalignment", "angle", 0.03),
    "scale": candidate("gyro_scale", "z", 0.03),
}
NAMES = {key: one.free_parameters[0].name for key, one in CANDIDATES.items()}
START = ParameterSet({"mass": 0.0, **dict.fromkeys(NAMES.values(), 0.0)})


class Readings:
    """What an inertial sensor reads in slaloms, in closed form: small angles, at one speed."""

    at_once = 2
    layout = [list(NOISE)] * DRIVES

    def __init__(self, **hidden: float) -> None:
        random = np.random.default_rng(2)
        self._yaw_rates = [0.1 * np.sin(np.linspace(0, 20, 300) + start) for start in range(DRIVES)]
        self._noise = [random.standard_normal(300 * len(NOISE)) for _ in range(DRIVES)]
        self._hidden = START.changed({NAMES[key]: size for key, size in hidden.items()})
        windows = [SimpleNamespace(begin=0.0, end=60.0, run_in=0.0)] * DRIVES
        dataset = SimpleNamespace(windows=windows, places_by_recording=lambda: [[drive] for drive in range(DRIVES)])
        self.predictor = SimpleNamespace(dataset=dataset, lost=lambda _: [False] * DRIVES)

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        assert len(parameter_sets) <= self.at_once

    def diverged(self, parameter_set: ParameterSet) -> list[bool]:
        return [False] * DRIVES

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        pairs = zip(self._read(self._hidden), self._read(parameter_set), self._noise, strict=True)
        return [real - simulated + noise for real, simulated, noise in pairs]

    def _read(self, car: ParameterSet) -> list[np.ndarray]:
        """In standard deviations, by drive."""
        mass, offset, turned, scale = (car.values[name] for name in ("mass", *NAMES.values()))
        return [
            np.concatenate(
                [
                    np.full(len(rate), offset - GRAVITY * turned) / NOISE["acceleration"],
                    turned * rate / NOISE["roll_rate"],
                    (1 + scale) * (1 - 0.1 * mass) * rate / NOISE["yaw_rate"],
                ]
            )
            for rate in self._yaw_rates
        ]


def searching(**hidden: float) -> Search:
    residuals = Readings(**hidden)
    base = fit(residuals, START, [FreeParameter("mass", "-", 0.01, -0.6, 0.6, added("mass"))])
    search = Search(residuals, START, base, list(CANDIDATES.values()))
    search.validation.is_validated_by_pieces_alone = False
    return search


@pytest.mark.parametrize("besides", [{}, {"scale": 0.08}], ids=["alone", "besides another effect"])
def test_two_effects_of_which_neither_shows_alone_are_found_together(besides: dict[str, float]):
    search = searching(offset=OFFSET, turned=TURNED, **besides)
    alone = search.single()
    assert all(e.score < LEAST for e in alone if e.effects != ("gyro_scale",))
    best, *_ = search.proposed()
    assert set(best.effects) == {CANDIDATES[key].effect for key in ("offset", "turned", *besides)}
    sizes = search.fitting.unshrunk(best).sizes
    # The roll rate alone tells the two apart: by least squares, with this standard deviation.
    rates = np.concatenate(search.residuals._yaw_rates)
    turned = NOISE["roll_rate"] / float(np.linalg.norm(rates))
    assert sizes[NAMES["turned"]] == pytest.approx(TURNED, abs=3 * turned)
    assert sizes[NAMES["offset"]] == pytest.approx(OFFSET, abs=3 * turned * GRAVITY)


def test_where_one_of_the_two_is_there_alone_it_is_proposed_alone():
    best, *_ = searching(turned=TURNED).proposed()
    assert best.effects == (CANDIDATES["turned"].effect,)
