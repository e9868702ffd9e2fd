"""Base parameters that stand in for effects, and what bends to the other side would tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hidden import driven, prototype, unheard
from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.normal_equations import NormalEquations
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.stand_ins import (
    is_symmetric,
    least_with,
    seen_of_banks,
    separated_by_other_side,
    side_of_bends,
)
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.effects import BY_ID
from vsense_ros.model.effects.base import CORNERS, role


def residuals(*manoeuvres: str) -> Residuals:
    recordings = [driven(prototype(), name) for name in manoeuvres]
    return Residuals(Predictor(prototype(), build_dataset(recordings, prototype())))


@pytest.mark.parametrize(
    ("manoeuvres", "side"),
    [(("bend",), "left"), (("slalom",), ""), (("bend", "slalom"), ""), (("straight",), "")],
)
def test_bends_to_one_side_alone_are_recognised(manoeuvres, side):
    assert side_of_bends(residuals(*manoeuvres)) == side


@pytest.mark.parametrize(("bank", "said"), [(-0.3, True), (0.0, False)])
def test_of_a_car_without_a_lateral_accelerometer_its_gyro_shows_how_far_a_bend_is_banked(bank, said):
    of_flat = residuals("bend")
    on_bank = of_flat.predictor.start.changed({"effects.road_bank.bank": bank})
    measured = [dict(signals) for signals in of_flat.predictor.simulated(on_bank)]
    of_flat.predictor.measured = measured
    assert not seen_of_banks(of_flat)
    for signals in measured:
        del signals["lateral_acceleration"]
    remark = seen_of_banks(of_flat)
    assert bool(remark) == said
    if said:
        degrees = float(remark.split("a bank of ")[1].split("°")[0])
        assert degrees == pytest.approx(-np.degrees(bank), abs=2.0)


@pytest.mark.filterwarnings("error")
def test_windows_of_a_second_are_too_short_to_compare_how_a_gyro_and_the_course_turn():
    dataset = residuals("bend").predictor.dataset
    first = dataset.windows[0]
    short = first.part(first.begin + 3.0, first.begin + 4.9, run_in=0.5, yaw_rate=0.0, lateral_velocity=0.0)
    predictor = Predictor(prototype(), replace(dataset, windows=(short,)))
    predictor.measured = [{name: signals[name] for name in ("yaw_rate", "course")} for signals in predictor.measured]
    assert not seen_of_banks(Residuals(predictor))


def test_an_antenna_beside_the_middle_and_a_tyre_radius_are_separated_by_bends_to_the_other_side():
    assert separated_by_other_side(("tyre radius", "effects.gnss_lever_arm.y"))
    assert separated_by_other_side(("tyre radius", "effects.wheel_radius.rr"))
    assert not separated_by_other_side(("tyre radius", "effects.gnss_lever_arm.x"))
    assert not separated_by_other_side(("effects.accelerometer_bias.y", "effects.road_bank.bank"))


SIZES = [
    f"effects.{id}.{name}"
    for id, effect in BY_ID.items()
    for name, field in effect.model_fields.items()
    if role(field) == "size" and name not in CORNERS and not effect.on_map
]


def exchanged(recording: Recording) -> Recording:
    """The recording of the same drive in a mirror: left and right are exchanged."""
    signs = {"angular_velocity": (-1, 1, -1), "linear_acceleration": (1, -1, 1), "linear": (1, -1, 1)}
    channels = {}
    for topic, channel in recording.channels.items():
        columns = dict(channel.columns)
        for field, sign in signs.items():
            if field in columns:
                columns[field] = columns[field] * np.array(sign)
        if topic == "vehicle/steering":
            columns["position"] = -columns["position"]
        for field in ("velocity", "effort"):  # of the wheels, front left, front right, rear left, rear right
            if topic.startswith("vehicle/wheel"):
                columns[field] = columns[field][:, [1, 0, 3, 2] if columns[field].shape[1] else []]
        channels[topic] = replace(channel, columns=columns)
    return replace(recording, channels=channels)


@pytest.fixture(scope="module")
def left_and_right() -> list[Predictor]:
    """Predictors of a bend to the left, and of the same one in a mirror."""
    car = prototype()
    bend = unheard(driven(car, "bend"), "gps/fix")
    return [Predictor(car, build_dataset([one], car)) for one in (bend, exchanged(bend))]


@pytest.mark.slow
@pytest.mark.parametrize("name", SIZES)
def test_exchanging_left_and_right_changes_the_sign_of_just_those_sizes_that_are_not_symmetric(left_and_right, name):
    """By the symmetry of mechanics: a car in a mirror obeys the same equations."""
    _, id, field = name.split(".")
    size = 0.2 * float(BY_ID[id].model_fields[field].json_schema_extra["typical"])
    changes, motions = [], []
    for predictor, sign in zip(left_and_right, (1, 1 if is_symmetric(name) else -1), strict=True):
        ((with_it,), (without,)) = (
            predictor.simulated(predictor.start.changed({name: value})) for value in (sign * size, 0.0)
        )
        changes.append({signal: with_it[signal] - without[signal] for signal in without})
        motions.append(without)
    assert changes[0].keys() == changes[1].keys() > {"yaw_rate", "lateral_acceleration", "longitudinal_acceleration"}
    for signal, change in changes[0].items():
        turns = np.sign(motions[0][signal] @ motions[1][signal])  # −1 for signals that a mirror reverses
        np.testing.assert_allclose(change, turns * changes[1][signal], atol=1e-6 + 1e-2 * np.abs(change).max())


@given(seed=st.integers(0, 10_000))
def test_what_a_held_parameter_costs_is_what_a_constrained_least_squares_solution_costs(seed):
    """The oracle solves the stacked problem by its residuals, without products."""
    random = np.random.default_rng(seed)
    slopes, residual, offsets = random.normal(size=(30, 5)), random.normal(size=30), random.normal(size=5)
    free = [FreeParameter(f"p{i}", "-", 1.0, -9.0, 9.0, added(f"p{i}")) for i in range(5)]
    weight = 0.7
    equations = NormalEquations(
        tuple(free), offsets, weight, (slopes.T @ slopes)[None], (slopes.T @ residual)[None],
        np.array([residual @ residual]), np.array([30]),
    )  # fmt: skip
    stacked = np.vstack([slopes, np.sqrt(weight) * np.eye(5)])
    present = np.append(residual, np.sqrt(weight) * offsets)
    moved = present - stacked[:, 0] * offsets[0]  # the first at the file, of the others two are free
    change, *_ = np.linalg.lstsq(stacked[:, [1, 3]], -moved, rcond=None)
    expected = float(np.sum(np.square(moved + stacked[:, [1, 3]] @ change)) - present @ present)
    value, found = least_with([1, 3], equations, held=0)
    assert value == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(found, change, atol=1e-9)
