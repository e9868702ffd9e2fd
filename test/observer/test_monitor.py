"""The watch over the model during a drive: quiet where nothing is hidden, and naming what no longer fits."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drives import messages
from monitored import altered, driven, prototype
from vsense_ros.bag import write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording
from vsense_ros.observer.monitor import WINDOW, Limits, Range, load_limits, save_limits
from vsense_ros.runner import Runner
from vsense_ros.runner.calibration import Watch, calibrate, watch

BEGIN = 18.0  # [s] when something goes wrong


@cache
def limits() -> Limits:
    normal = [driven(name, seed) for name in ("slalom", "traffic") for seed in (0, 1)]
    return calibrate([watch(recording, prototype()) for recording in normal], prototype()).limits


def beyond(recording: Recording) -> dict[str, float]:
    return watch(recording, prototype(), limits()).beyond


@pytest.mark.exam
@pytest.mark.parametrize("name", ["slalom", "traffic"])
def test_with_nothing_hidden_it_is_quiet_for_minutes(name: str) -> None:
    assert beyond(driven(name, 20, duration=130.0)) == {}


@pytest.mark.exam
def test_a_brake_that_begins_to_drag_is_named_with_its_wheel_before_all_else_and_within_a_window() -> None:
    found = beyond(driven("slalom", 21, drag=50.0, begin=BEGIN))
    assert next(iter(found)) == "torque of wheel fl"
    assert BEGIN < found["torque of wheel fl"] < BEGIN + WINDOW


@pytest.mark.exam
def test_a_wind_from_the_side_is_named_as_a_lateral_force_and_a_yaw_moment_to_its_side() -> None:
    """16 m/s to the north act on the left of a car that goes east, ahead of its centre of gravity."""
    seen = watch(driven("traffic", 30, effect="crosswind.north", size=16.0, begin=BEGIN), prototype(), limits())
    assert set(list(seen.beyond)[:2]) == {"lateral force", "yaw moment"}
    assert BEGIN < seen.beyond["yaw moment"] < BEGIN + WINDOW
    assert BEGIN < seen.beyond["lateral force"] < BEGIN + WINDOW
    assert "longitudinal force" not in seen.beyond
    assert strongest(seen, "lateral force") > 0
    assert strongest(seen, "yaw moment") > 0


@pytest.mark.exam
def test_more_air_drag_is_named_as_a_longitudinal_force_before_all_else() -> None:
    seen = watch(driven("traffic", 30, effect="aero_drag.area", size=1.6, begin=BEGIN), prototype(), limits())
    assert next(iter(seen.beyond)) == "longitudinal force"
    assert BEGIN < seen.beyond["longitudinal force"] < BEGIN + WINDOW
    assert not {"lateral force", "yaw moment"} & set(seen.beyond)
    assert strongest(seen, "longitudinal force") < 0


@pytest.mark.exam
def test_a_hill_is_named_as_a_slope_and_not_as_a_force() -> None:
    """The accelerometer tells them apart."""
    seen = watch(driven("traffic", 30, grade=0.05, begin=BEGIN), prototype(), limits())
    assert next(iter(seen.beyond)) == "estimated grade"
    assert BEGIN < seen.beyond["estimated grade"] < BEGIN + WINDOW
    assert "longitudinal force" not in seen.beyond
    assert strongest(seen, "estimated grade") == pytest.approx(0.05, abs=0.02)


def strongest(seen: Watch, name: str) -> float:
    """The mean of a quantity over a window that is largest in magnitude, once something is wrong."""
    column = [quantity.name for quantity in seen.quantities].index(name)
    means = seen.statistics[seen.t > BEGIN, 0, column]
    return float(means[np.abs(means).argmax()])


def turned(recording: Recording, begin: float) -> Recording:
    """With a gyro that tells 0.03 rad/s too much from a time [s] on."""
    return altered(recording, "imu/data", "angular_velocity", begin, lambda rates: rates + np.array([0.0, 0.0, 0.03]))


@pytest.mark.exam
def test_a_hidden_gyro_bias_is_named() -> None:
    assert "estimated imu.gyro bias z" in beyond(turned(driven("slalom", 22), 0.0))


@pytest.mark.exam
def test_a_gyro_that_jumps_on_the_way_is_noticed_within_a_window() -> None:
    """As the gyro's: the filter does not believe it, so that nobody else is at odds with anybody."""
    found = beyond(turned(driven("traffic", 22), BEGIN))
    assert BEGIN < min(found.values()) < BEGIN + WINDOW
    assert "imu yaw rate innovation" in found
    assert "velocity innovation squared" not in found


@pytest.mark.exam
def test_a_wheel_speed_whose_scale_fails_is_named() -> None:
    wrong = altered(
        driven("slalom", 23), "vehicle/wheel_speeds", "velocity", BEGIN, lambda speeds: speeds * [1, 1, 0.97, 1]
    )
    found = beyond(wrong)
    assert "wheel_speeds rl innovation" in found
    assert BEGIN < found["wheel_speeds rl innovation"] < BEGIN + WINDOW


def model_of(observer: Runner) -> Diagnostic:
    (line,) = (line for line in observer.diagnostics() if line.name == "model")
    return line


@cache
def limits_by_slalom() -> Limits:
    """The limits of two drives."""
    normal = [watch(driven("slalom", seed, duration=24.0), prototype()) for seed in (0, 1)]
    return calibrate(normal, prototype()).limits


@pytest.mark.slow
def test_diagnostics_say_what_no_longer_fits_and_since_when() -> None:
    drive = driven("slalom", 23, duration=31.0)
    wrong = altered(drive, "vehicle/wheel_speeds", "velocity", BEGIN, lambda speeds: speeds * [1, 1, 0.97, 1])
    observer = Runner(prototype(), drive.map_origin)
    observer.watch(limits_by_slalom())
    said: dict[float, Diagnostic] = {}
    for sample in messages(wrong):
        observer.add(sample)
        if (second := round((sample.stamp - drive.start) * 1e-9)) not in said:
            said[second] = model_of(observer)
    assert said[5].message.startswith("not judged yet")
    assert (said[17].level, said[17].message) == (Level.OK, "fits")
    assert said[30].level == Level.WARN
    assert "no longer fits since 00:00:" in said[30].message
    assert "wheel_speeds rl innovation" in said[30].values
    assert "limits" in said[30].values["wheel_speeds rl innovation"]


@pytest.mark.exam
def test_watching_changes_nothing_of_the_estimate() -> None:
    plain, watched = (Runner(prototype(), driven("slalom", 0).map_origin) for _ in range(2))
    watched.watch(limits())
    for sample in messages(driven("slalom", 0), until=15.0):
        plain.add(sample)
        watched.add(sample)
    np.testing.assert_array_equal(plain.filter.memory, watched.filter.memory)


@pytest.mark.slow
def test_limits_are_made_and_used_by_a_command(tmp_path: Path) -> None:
    save_vehicle(tmp_path / "car.yaml", prototype())
    for seed in (0, 1):
        write_bag(tmp_path / f"normal_{seed}", driven("slalom", seed, duration=24.0))
    write_bag(tmp_path / "dragging", driven("slalom", 21, duration=24.0, drag=80.0))
    bags = [str(tmp_path / f"normal_{seed}") for seed in (0, 1)]
    of_car = ["--vehicle", str(tmp_path / "car.yaml")]
    made = CliRunner().invoke(main, ["monitor", *bags, *of_car, "--calibrate", str(tmp_path / "limits.yaml")])
    assert made.exit_code == 0, made.output
    assert "torque of wheel fl" in made.output
    assert "same drive" not in made.output
    assert re.findall("No limits for (.*)", made.output) == [
        "position east innovation, position north innovation, velocity east innovation, velocity north innovation: "
        "not known in any recording, absent or late: what comes late is not looked at by component."
    ]
    judged = CliRunner().invoke(
        main, ["monitor", str(tmp_path / "dragging"), bags[0], *of_car, "--limits", str(tmp_path / "limits.yaml")]
    )
    assert judged.exit_code == 0, judged.output
    assert "torque of wheel fl" in judged.output
    assert "nothing" in judged.output


@pytest.mark.exam
def test_what_a_drive_lacks_and_a_copy_of_another_are_told_by_the_command(tmp_path: Path) -> None:
    save_vehicle(tmp_path / "car.yaml", prototype())
    whole, lacking = (driven("slalom", seed, duration=20.0) for seed in (0, 1))
    channels = {topic: channel for topic, channel in lacking.channels.items() if topic != "gps/velocity"}
    for place, recording in (
        ("monday/lap", whole),
        ("tuesday/lap", replace(lacking, channels=channels)),
        ("copy", whole),
    ):
        write_bag(tmp_path / place, recording)
    places = [str(tmp_path / place) for place in ("monday/lap", "tuesday/lap", "copy")]
    of_car = ["--vehicle", str(tmp_path / "car.yaml"), "--calibrate", str(tmp_path / "limits.yaml")]
    made = CliRunner().invoke(main, ["monitor", *places, *of_car])
    assert made.exit_code == 0, made.output
    assert "The same drive, which counts once: monday/lap, copy.\n" in made.output
    assert "No limits for velocity innovation squared: not known in tuesday/lap.\n" in made.output
    assert load_limits(tmp_path / "limits.yaml").recordings == ["monday/lap", "tuesday/lap"]


# Limits


@pytest.mark.exam
def test_a_copy_is_known_by_what_the_observer_hears_and_another_drive_is_not_taken_for_one() -> None:
    drive = driven("slalom", 0, duration=20.0)
    unheard = {**drive.channels, "reference/odometry": replace(drive["imu/data"], topic="reference/odometry")}
    copy = replace(drive, channels=unheard, name="copy")
    other = altered(drive, "imu/data", "angular_velocity", 0.0, lambda rates: rates + 1e-9)
    one, same, another = (watch(recording, prototype()).content for recording in (drive, copy, other))
    assert one == same
    assert one != another


def test_a_standing_car_gives_no_limits() -> None:
    recording = driven("slalom", 0, duration=5.0)
    with pytest.raises(InputError, match="nowhere 10 s of driving"):
        watch(recording, prototype())


def some_limits(**changes: object) -> Limits:
    quantities = {"yaw moment": Range(unit="N m", low=-1.0, high=2.0, rms=3.0, margin=1.5)}
    return Limits(
        vehicle=prototype().name, recordings=["a"], seconds=60.0, window=10.0, quantities=quantities
    ).model_copy(update=changes)


def test_limits_are_read_as_they_were_written(tmp_path: Path) -> None:
    save_limits(tmp_path / "limits.yaml", some_limits())
    assert load_limits(tmp_path / "limits.yaml") == some_limits()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file; vsense monitor --calibrate"),
        ("quantities: [", "not valid YAML"),
        ("vehicle: x", "recordings: Field required"),
        ("- 1", "file: "),
    ],
)
def test_a_file_that_holds_no_limits_is_refused_with_what_to_do(tmp_path: Path, content, message) -> None:
    path = tmp_path / "limits.yaml"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_limits(path)


def test_limits_of_another_vehicle_or_of_other_sensors_are_refused() -> None:
    observer = Runner(prototype())
    with pytest.raises(InputError, match="those of the vehicle 'another'"):
        observer.watch(some_limits(vehicle="another"))
    with pytest.raises(InputError, match="lidar range innovation does not exist here"):
        observer.watch(some_limits(quantities={"lidar range innovation": Range(unit="", low=0, high=1, margin=1)}))
