"""The observer with what was found, against the observer with the file as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from hidden import driven, having, prototype
from synthetic_findings import finding
from vsense_ros.evaluate.reference import ODOMETRY, at_reference
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.mismatch.answer_schema import ObserverComparison, ObserverError, ObserverFigures, SensorFigures
from vsense_ros.mismatch.observed import _judged, comparison, fitted_place, noise_levels
from vsense_ros.mismatch.page import write_report
from vsense_ros.mismatch.tables import observer_rows
from vsense_ros.mismatch.terminal import printed
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.vehicle import Vehicle


def figures(log_likelihood: float, side_slip: float) -> ObserverFigures:
    return ObserverFigures(
        log_likelihood=log_likelihood,
        sensors={"imu": SensorFigures(messages=100, log_likelihood=log_likelihood, innovation=0.8, nis=1.1)},
        errors={"side_slip": ObserverError(unit="rad", rmse=2 * side_slip, without_constant=side_slip)},
        reference=None,
    )


def compared(*, improved: bool) -> ObserverComparison:
    return ObserverComparison(
        recordings=("lap 3",), held_out=True, messages=100, improved=improved, sentence="The observer was watched.",
        as_it_was=figures(1.0, 0.01), retuned=figures(1.1, 0.01), extended=figures(1.5, 0.005),
    )  # fmt: skip


def test_a_reference_is_found_where_it_was_mounted():
    """Velocities that a system at a known place, with axes turned by a known angle, would have."""

    @given(x=st.floats(-1.5, 1.5), y=st.floats(-0.6, 0.6), yaw=st.floats(-0.03, 0.03))
    def found(x: float, y: float, yaw: float) -> None:
        t = np.arange(0.0, 20.0, 0.1)
        zero = np.zeros_like(t)
        columns = {
            "position": np.zeros((len(t), 3)),
            "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)),
            "linear": np.column_stack([15 + np.sin(0.3 * t), 0.3 * np.sin(t), zero]),
            "angular": np.column_stack([zero, zero, 0.4 * np.sin(0.7 * t)]),
        }
        stamp = np.round(t * 1e9).astype(np.int64)
        own = Channel(ODOMETRY, "nav_msgs/msg/Odometry", stamp, stamp, columns)
        mounted = prototype().reference.model_copy(update={"position": (x, y, 0.0), "yaw": yaw})
        moved = at_reference(Recording({ODOMETRY: own}), prototype().model_copy(update={"reference": mounted}))
        truth = replace(moved[ODOMETRY], topic="reference/odometry")
        place = fitted_place([Recording({ODOMETRY: own})], [Recording({"reference/odometry": truth})], prototype())
        assert place is not None
        assert (place.x, place.y) == pytest.approx((x, y), abs=1e-6)
        assert place.yaw == pytest.approx(yaw, abs=1e-6)

    found()


def test_a_drive_without_bends_puts_no_reference_beside_its_car():
    """A speed that is a little off at a small yaw rate looks like a large distance to the side."""
    t = np.arange(0.0, 20.0, 0.1)
    zero = np.zeros_like(t)
    stamp = np.round(t * 1e9).astype(np.int64)

    def driven(topic: str, speed: float) -> Recording:
        columns = {
            "position": np.zeros((len(t), 3)),
            "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)),
            "linear": np.column_stack([speed + zero, zero, zero]),
            "angular": np.column_stack([zero, zero, zero + 0.01]),
        }
        return Recording({topic: Channel(topic, "nav_msgs/msg/Odometry", stamp, stamp, columns)})

    place = fitted_place([driven(ODOMETRY, 15.0)], [driven("reference/odometry", 15.05)], prototype())
    assert place is not None
    assert abs(place.y) <= 1.0


def test_the_noise_of_sensors_is_left_alone_and_what_acts_along_the_car_where_its_torques_are_unknown():
    known = prototype()
    unknown = known.model_copy(update={"sensors": {n: s for n, s in known.sensors.items() if n != "torques"}})
    with_torques, without = noise_levels(known), noise_levels(unknown)
    assert not any(name.startswith("sensors.") for name in with_torques)
    assert set(with_torques) - set(without) >= {"observer.force_errors.longitudinal", "observer.surroundings.grade"}
    assert "observer.force_errors.lateral" in without


def judged(start: Vehicle, extended: Vehicle, true: Vehicle) -> ObserverComparison:
    """On recordings of the car as it truly is."""
    fitted, unseen = driven(true, "slalom"), driven(true, "sweep", seed=1)
    found, tuned = comparison([fitted], [unseen], build_dataset([fitted], start), start, extended)
    assert tuned.physics == extended.physics
    assert tuned.sensors == extended.sensors
    assert found.recordings == ("sweep",)
    return found


@pytest.mark.exam
def test_the_true_car_makes_the_observer_better_and_a_wrong_one_does_not():
    """Wheels that turn by a fifth more than is measured, known; and the same with its sign turned round."""
    true, opposite = (having(prototype(), steering_ratio={"relative": size}) for size in (0.2, -0.2))
    better = judged(prototype(), true, true)
    assert better.improved, better.sentence
    assert better.extended.log_likelihood > better.as_it_was.log_likelihood
    assert better.extended.errors["side_slip"].without_constant < better.as_it_was.errors["side_slip"].without_constant
    worse = judged(prototype(), opposite, true)
    assert not worse.improved
    assert worse.sentence.startswith("The observer is not better")


@pytest.mark.parametrize(("retuned", "better"), [(0.0029, True), (0.00279, True), (0.0027, False)])
def test_a_model_is_no_better_where_noise_levels_alone_bring_the_side_slip_nearer_to_a_reference(retuned, better):
    extended = 0.0028
    found = compared(improved=False).with_(retuned=figures(1.1, retuned), extended=figures(1.5, extended))
    assert _judged(found)[0] == better


def test_where_noise_levels_alone_bring_the_side_slip_further_off_the_file_keeps_its_own():
    """And the extended car, which has them, is compared with the car as it was."""
    found = compared(improved=False).with_(retuned=figures(1.6, 0.012), extended=figures(1.5, 0.005))
    better, said = _judged(found)
    assert better
    assert "by 0.688°, and so the file keeps its own" in said


@pytest.mark.parametrize("improved", [True, False])
def test_where_the_observer_does_not_improve_page_and_terminal_say_so_before_all_else(improved, tmp_path: Path):
    answer = finding("named", observer=compared(improved=improved))
    write_report(answer, [], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    before_figures = page.split('class="figures"')[0]
    assert ("The observer was watched." in before_figures) == (not improved)
    assert page.count("The observer was watched.") == (1 if improved else 2)
    console = Console(record=True, width=140)
    printed(answer, console)
    assert "The observer was watched." in console.export_text()


def test_the_table_tells_errors_in_degrees_and_innovations_as_multiples():
    rows = {row.what: row.cells for row in observer_rows(compared(improved=True))}
    assert rows["IMU: size of the innovations"] == ("1", "0.80 ×", "0.80 ×")
    assert rows["side slip: error, constant fitted"][2] == "0.286°"
