"""Cars that tell the speed of their wheels but not the torques: the model follows the speed."""

from __future__ import annotations

import pytest

from hidden import driven, prototype
from vsense_ros.mismatch.evidence import gather
from vsense_ros.mismatch.fit import Residuals, fit
from vsense_ros.mismatch.knobs import TORQUE_SHARES, UNKNOWN_TORQUES, base_knobs
from vsense_ros.mismatch.prediction import Predictor


def untold(front: float, manoeuvre: str = "brake") -> Residuals:
    """Of a car without a word of its torques, of which the front wheels have this share."""
    car = prototype()
    known = {name: sensor for name, sensor in car.sensors.items() if sensor.kind != "wheel_torques"}
    vehicle = car.model_copy(update={"sensors": known})
    return Residuals(Predictor(vehicle, gather([driven(car, manoeuvre, front=front)], vehicle)))


@pytest.mark.parametrize("front", [0.0, 0.5, 1.0])
def test_which_wheels_drive_is_found_and_leaves_nothing_over(front):
    residuals = untold(front)
    found = fit(residuals, residuals.predictor.start, UNKNOWN_TORQUES)
    assert found.setting.values["torque.driving_front"] == pytest.approx(front, abs=0.1)
    assert found.setting.values["torque.braking_front"] == pytest.approx(front, abs=0.1)
    assert residuals.worst(found.residuals) < 1.0


def test_a_car_accelerates_as_its_wheels_do_less_their_slip():
    residuals = untold(0.5, "brake again")
    off = residuals.deviations(residuals(residuals.predictor.start.changed(dict.fromkeys(TORQUE_SHARES, 0.5))))
    assert off["longitudinal_acceleration"] < 1.0
    assert off["pitch_rate"] < 1.0


def test_shares_are_fitted_only_where_torques_are_unknown():
    names = {knob.name for knob in UNKNOWN_TORQUES}
    assert names <= {knob.name for knob in base_knobs(prototype(), torques=False)}
    assert not names & {knob.name for knob in base_knobs(prototype(), torques=True)}
