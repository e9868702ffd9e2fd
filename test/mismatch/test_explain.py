"""The search for missing physics on recordings of our own model: that it finds its way, and knows when it cannot.

How well it does on cars that our model did not make is what `make blind` examines.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from hidden import driven, having, prototype, without, wrong
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.mismatch.answer_schema import Answer, read_answer
from vsense_ros.mismatch.candidates import candidates
from vsense_ros.mismatch.design import NEXT
from vsense_ros.mismatch.explain import EXTENDED, ROAD, Explanation, explain_recordings
from vsense_ros.mismatch.remarks import NO_COURSE
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.effects import BY_ID


def answered(*arguments: Any, **options: Any) -> Answer:
    return explain_recordings(*arguments, **options).answer


def test_an_effect_that_the_library_does_not_have_is_refused():
    with pytest.raises(InputError, match=r"no effect ghost; the library has .*aero_drag"):
        explain_recordings([], prototype(), assume=["ghost"])


@pytest.mark.slow
def test_with_nothing_hidden_wrong_mass_and_tyres_are_fitted_and_nothing_is_named():
    found = explain_recordings(
        [driven(prototype(), m) for m in ("sweep", "slalom", "brake")], wrong(prototype())
    ).answer
    assert found.verdict == "no_mismatch"
    assert all(effect.gain_held_out is None for effect in found.effects)
    assert found.base["mass"].value == pytest.approx(1 / 1.08 - 1, abs=0.01)
    assert found.base["cornering stiffness, front"].value == pytest.approx(1 / 0.9 - 1, abs=0.03)


@pytest.mark.slow
def test_what_every_car_has_a_little_of_is_looked_at_alone_where_a_car_has_much_of_it():
    """Rolling resistance of 0.012 more than the file, seventeen times what it may be wrong by, which a slope resembles:
    nothing was found on two drives, and a term without known physics on three."""
    true = having(prototype(), rolling_resistance={"coefficient": 0.012})
    found = explain_recordings([driven(true, m) for m in ("sweep", "slalom", "brake")], wrong(prototype())).answer
    assert (found.verdict, {"rolling_resistance", "road_grade"} <= set(found.answer_set)) == ("ambiguous", True)


@cache
def of_dragging_brake() -> Explanation:
    """The answer for a car one of whose brakes drags, fitted to two drives and proven by a third."""
    true = having(prototype(), brake_drag={"fl": 30.0})
    train = [driven(true, "sweep"), driven(true, "slalom")]
    return explain_recordings(train, wrong(prototype()), [driven(true, "brake")])


@pytest.mark.slow
def test_a_brake_that_drags_is_named_with_its_wheel_and_torque_and_proven_elsewhere(tmp_path):
    found = of_dragging_brake().answer
    assert found.verdict == "named"
    best = found.effects[0]
    assert (best.id, best.wheel) == ("brake_drag", "fl")
    (torque,) = best.parameters
    assert torque.value == pytest.approx(30.0, rel=0.07)
    assert best.gain_held_out > 0.9
    assert 0.5 < best.gain_left_out <= 1.0
    assert all(effect.gain_left_out <= 1.0 for effect in found.effects)

    of_dragging_brake().write(tmp_path)
    assert read_answer(tmp_path) == found
    extended = load_vehicle(tmp_path / "vehicle.extended.yaml")
    assert extended.physics.effects.brake_drag.fl == pytest.approx(torque.value)


@pytest.mark.exam
def test_with_the_effect_that_was_named_in_its_file_nothing_is_missing(tmp_path):
    of_dragging_brake().write(tmp_path)
    true = having(prototype(), brake_drag={"fl": 30.0})
    train = [driven(true, "sweep"), driven(true, "slalom")]
    again = answered(train, load_vehicle(tmp_path / "vehicle.extended.yaml"))
    assert again.verdict == "no_mismatch"
    assert np.isfinite(again.misfit)


@pytest.mark.exam
def test_two_effects_at_once_are_both_named():
    true = having(prototype(), brake_drag={"rr": 40.0}, imu_roll_misalignment={"angle": 0.1})
    found = explain_recordings(
        [driven(true, m) for m in ("sweep", "slalom")], wrong(prototype()), [driven(true, "brake")]
    ).answer
    assert found.verdict == "named"
    named = {effect.id: effect.parameters[0].value for effect in found.effects if effect.accepted}
    assert named == {"brake_drag": pytest.approx(40.0, rel=0.1), "imu_roll_misalignment": pytest.approx(0.1, rel=0.1)}
    assert set(found.answer_set) == set(named)


@pytest.mark.slow
def test_what_is_off_only_where_nothing_was_fitted_is_unknown_and_said_to_be_there():
    worn = prototype().with_parameters({"front.cornering_scale": 0.6})
    train = [driven(prototype(), m) for m in ("sweep", "brake")]
    found = answered(train, prototype(), [driven(worn, "slalom")])
    assert found.verdict == "unknown"
    assert "on what was held out" in found.sentence
    assert found.located.region.description in found.sentence
    worst = found.located.signals[0].name
    assert f"the error of the {worst.replace('_', ' ')} on what was held out" in found.sentence


@pytest.mark.exam
def test_torque_steered_to_the_outer_wheel_is_described_and_not_called_a_differential():
    true = having(prototype(), unmodelled={"torque_across_rear_steering": -3000.0})
    found = explain_recordings(
        [driven(true, m) for m in ("sweep", "slalom")], wrong(prototype()), [driven(true, "brake")]
    ).answer
    assert (found.verdict, found.answer_set) == ("unknown", ())
    assert "from the left to the right rear wheel that follows the steering angle" in found.sentence
    assert "% on recordings it was not fitted to" in found.sentence
    (size,) = found.located.force.sizes
    assert size.value == pytest.approx(-3000.0, rel=0.05)


@pytest.mark.exam
@pytest.mark.parametrize("part", ["no_refit", "no_projection"])
def test_without_a_part_of_the_method_there_is_an_answer_all_the_same(part):
    true = having(prototype(), brake_drag={"fl": 30.0})
    found = explain_recordings(
        [driven(true, "sweep")], wrong(prototype()), [driven(true, "brake")], ablation=part
    ).answer
    assert found.effects
    assert found.sentence


@pytest.mark.exam
@pytest.mark.parametrize(
    ("kind", "effect", "alike"),
    [
        ("wheel_speeds", {"brake_drag": {"fl": 30.0}}, {"limited_slip_differential", "tyre_underinflation"}),
        # The accelerometer tells gravity from what slows the car, whose torques make up for it.
        ("wheel_torques", {"road_grade": {"grade": 0.03}}, set()),
    ],
)
def test_what_looks_like_the_answer_and_needs_a_sensor_that_is_not_there_is_told(kind, effect, alike):
    deaf = without(prototype(), kind)
    train = [driven(having(deaf, **effect), m) for m in ("sweep", "slalom")]
    found = answered(train, deaf, assume=list(effect))
    remarks = [r for r in found.remarks if "not excluded" in r]
    assert {r.split(" may look")[0] for r in remarks} == {BY_ID[id].sentence for id in alike}
    assert all(r.endswith("it needs wheel speeds, which these recordings do not have") for r in remarks)


@pytest.mark.exam
def test_without_gnss_a_wind_is_told_with_directions_from_where_the_recordings_set_out():
    blind = without(prototype(), "gnss_velocity")
    windy = having(blind, crosswind={"east": 0.0, "north": 8.0})
    found = explain_recordings(
        [driven(windy, m) for m in ("sweep", "slalom")], wrong(blind), [driven(windy, "brake")]
    ).answer
    assert [effect.id for effect in found.effects if effect.accepted] == ["crosswind"]
    across = next(p for p in found.effects[0].parameters if p.name == "north")
    assert across.value == pytest.approx(8.0, rel=0.2)
    assert NO_COURSE in found.remarks


@pytest.mark.exam
def test_one_stretch_of_driving_alone_is_proven_on_parts_of_itself_and_the_answer_says_so():
    found = explain_recordings(
        [driven(having(prototype(), brake_drag={"fl": 30.0}), "sweep")], wrong(prototype())
    ).answer
    assert found.verdict == "named"
    (named,) = [effect for effect in found.effects if effect.accepted]
    assert named.id == "brake_drag"
    assert named.gain_left_out != named.gain_training
    assert "where it was left out of the fit" in found.sentence
    assert "one stretch of driving" in found.remarks[-1]


@pytest.mark.exam
def test_what_was_held_out_and_could_not_be_used_is_told_by_name():
    train = driven(having(prototype(), brake_drag={"fl": 30.0}), "sweep")
    short = [driven(prototype(), "brake", 4.0), replace(driven(prototype(), "slalom", 4.0), name="")]
    found = answered([train], prototype(), short, assume=["brake_drag"])
    assert (found.held_out, found.held_out_unused) == ((), ("brake", "recording 2"))
    assert {remark.partition(":")[0] for remark in found.remarks} >= {"brake", "recording 2"}


def test_a_new_answer_takes_away_what_an_earlier_one_has_left(tmp_path):
    for name in (EXTENDED, ROAD, NEXT):
        (tmp_path / name).write_text("of another car", encoding="utf-8")
    explain_recordings([], prototype()).write(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["explain.json", "report.html"]


def test_a_size_that_the_vehicle_file_has_may_shrink_to_nothing_and_grow_to_its_bound():
    values = having(prototype(), brake_drag={"rl": 100.0}).values()
    (drag,) = next(c for c in candidates((), values) if c.name == "brake_drag rl").free_parameters
    (fresh,) = next(c for c in candidates() if c.name == "brake_drag rl").free_parameters
    assert (drag.low, drag.high) == (-100.0, fresh.high - 100.0)
    assert drag.apply(values, drag.low) == {drag.name: 0.0}


def test_what_a_vehicle_file_knows_of_its_sensors_counts_once():
    known = {
        "gyro_bias": {"z": 0.05}, "accelerometer_bias": {"x": 0.3}, "imu_roll_misalignment": {"angle": 0.1},
        "imu_lever_arm": {"x": 0.5}, "sensor_delay": {"imu": 0.05}, "body_roll_in_accelerometer": {"gain": 0.8},
    }  # fmt: skip
    car = having(prototype(), **known)
    recording = driven(car, "slalom")
    levels = []
    for vehicle in (car, prototype()):
        residuals = Residuals(Predictor(vehicle, build_dataset([recording], vehicle)))
        levels.append(residuals.level(residuals(residuals.predictor.start)))
    assert levels[0] < 0.5 < 2.0 < levels[1]


def test_an_unknown_part_of_the_method_cannot_be_left_out():
    with pytest.raises(InputError, match="no ablation luck; there are no_refit, no_projection, chi2_thresholds"):
        explain_recordings([], prototype(), ablation="luck")
