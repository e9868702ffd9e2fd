"""Held-out recordings in which an effect would leave no trace say nothing for or against it."""

from __future__ import annotations

import pytest

from hidden import driven, having, prototype
from vsense_ros.identification.least_squares import fit
from vsense_ros.mismatch.candidates import candidates
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.windows import build_dataset

pytestmark = pytest.mark.slow

SCALE = 0.1  # of a gyro, which a straight tells nothing of


@pytest.mark.parametrize("held_out", ["straight", "slalom"])
def test_a_gyro_scale_is_proven_by_bends_alone(held_out: str) -> None:
    car, vehicle = having(prototype(), gyro_scale={"z": SCALE}), prototype()
    dataset = build_dataset([driven(car, "sweep")], vehicle)
    unseen = build_dataset([driven(car, held_out, seed=1)], vehicle, dataset)
    residuals = Residuals(Predictor(vehicle, dataset))
    base = fit(residuals, residuals.predictor.start, ())
    (offered,) = (c for c in candidates() if c.name == "gyro_scale z")
    (scale,) = Search(residuals, residuals.predictor.start, base, [offered]).single()
    validation = Validation(unseen, vehicle, residuals, base)
    assert scale.sizes["effects.gyro_scale.z"] == pytest.approx(SCALE, rel=0.1)
    assert validation.leaves_a_trace(scale) == (held_out == "slalom")
    assert (validation.gain(scale) is None) == (held_out == "straight")
    assert validation.proven(scale) > 0.5 * scale.gain


def test_what_drives_leave_open_of_a_size_is_in_its_interval() -> None:
    vehicle, parameter = prototype(), "effects.gnss_lever_arm.x"
    (offered,) = (c for c in candidates() if c.name == "gnss_lever_arm x")
    found = {}
    for manoeuvre in ("straight", "slalom"):
        dataset = build_dataset([driven(having(vehicle, gnss_lever_arm={"x": -0.7}), manoeuvre)], vehicle)
        residuals = Residuals(Predictor(vehicle, dataset))
        base = fit(residuals, residuals.predictor.start, ())
        (found[manoeuvre],) = Search(residuals, residuals.predictor.start, base, [offered]).together([offered])
    size, deviation = found["straight"].sizes[parameter], found["straight"].deviations[parameter]
    assert size == pytest.approx(0.0, abs=0.05)
    assert deviation == pytest.approx(0.5, rel=0.1)  # as likely as before
    size, deviation = found["slalom"].sizes[parameter], found["slalom"].deviations[parameter]
    assert size == pytest.approx(-0.7, abs=0.1)
    assert deviation < 0.1
