"""Recordings that were spoilt on purpose: the reason is the right one, and what is sound is compared all the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hidden import driven, prototype
from vsense_ros.checks.finding import Scale
from vsense_ros.checks.subject import Subject
from vsense_ros.checks.units import rolling
from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.mismatch.candidates import BASE
from vsense_ros.mismatch.comparable import Comparable, comparable, without_components
from vsense_ros.mismatch.data_quality import hindrance, misfit, steps_in_words
from vsense_ros.mismatch.explain import explain_recordings
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.spoilt import without_spoilt
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

RATES, FORCES = "angular_velocity", "linear_acceleration"


def reason(*recordings: Recording, held_out: tuple[Recording, ...] = (), vehicle: Vehicle | None = None) -> str:
    vehicle = vehicle or prototype()
    every = [*recordings, *held_out]
    found = hindrance(every, build_dataset(recordings, vehicle), build_dataset(held_out, vehicle), vehicle)
    return "" if found is None else found.reason


def without(*topics: str) -> Callable[[Recording], Recording]:
    return lambda r: replace(r, channels={k: c for k, c in r.channels.items() if k not in topics})


def with_channel(recording: Recording, channel: Channel) -> Recording:
    return replace(recording, channels={**recording.channels, channel.topic: channel})


def changed(topic: str, field: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Recording], Recording]:
    def apply(recording: Recording) -> Recording:
        channel = recording[topic]
        columns = {**channel.columns, field: change(channel.columns[field].copy())}
        return with_channel(recording, replace(channel, columns=columns))

    return apply


def held(column: int | slice, first: int, last: int) -> Callable[[np.ndarray], np.ndarray]:
    """The value of row `first` until row `last`."""

    def change(values: np.ndarray) -> np.ndarray:
        values[first:last, column] = values[first, column]
        return values

    return change


def scaled(column: int | slice, factor: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[:, column] *= factor
        return values

    return change


def later(topic: str, seconds: float) -> Callable[[Recording], Recording]:
    return lambda r: with_channel(r, replace(r[topic], stamp=r[topic].stamp + round(seconds * 1e9)))


def in_frame(topic: str, frame: str) -> Callable[[Recording], Recording]:
    return lambda r: with_channel(r, replace(r[topic], frame_id=frame))


def all_of(*changes: Callable[[Recording], Recording]) -> Callable[[Recording], Recording]:
    def apply(recording: Recording) -> Recording:
        for change in changes:
            recording = change(recording)
        return recording

    return apply


TOPICS = ("gps/fix", "gps/velocity", "imu/data", "vehicle/steering", "vehicle/wheel_speeds", "vehicle/wheel_torques")
NO_GNSS = without("gps/fix", "gps/velocity")


@pytest.mark.parametrize("manoeuvre", ["sweep", "slalom", "brake", "brake again"])
@pytest.mark.parametrize("change", [lambda r: r, NO_GNSS, without("vehicle/wheel_speeds")])
def test_a_drive_with_all_sensors_right_passes(manoeuvre, change):
    assert reason(change(driven(prototype(), manoeuvre))) == ""


def test_a_driver_may_hold_the_wheel_at_one_angle():
    assert reason(driven(prototype(), "bend")) == ""


def test_the_same_measurements_twice_prove_nothing():
    recording = driven(prototype(), "slalom")
    assert "slalom and copy hold the same measurements" in reason(
        recording, held_out=(replace(recording, name="copy"),)
    )


@pytest.mark.parametrize(
    "angles",
    [
        pytest.param((0.0,), marks=pytest.mark.exam),
        (0.0, 0.001),
        pytest.param((-0.001, 0.0, 0.001), marks=pytest.mark.exam),
    ],
)
def test_a_driver_may_go_straight_on_with_a_steering_angle_of_few_values(angles):
    recording = driven(prototype(), "straight", duration=80.0)
    rows = len(recording["vehicle/steering"])
    held = np.repeat(np.resize(angles, rows // 50 + 1), 50)[:rows, None]
    assert "end of its range" not in reason(changed("vehicle/steering", "position", lambda _: held)(recording))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
@pytest.mark.parametrize("topic", TOPICS)
def test_a_sensor_without_one_sound_value_is_no_error(topic, value):
    recording = driven(prototype(), "slalom")
    for field in recording[topic].columns:
        recording = changed(topic, field, lambda v: np.full_like(v, value))(recording)
    assert reason(recording) or topic not in ("imu/data", "vehicle/steering")


def test_an_origin_of_the_map_that_is_no_number_is_none():
    recording = driven(prototype(), "slalom")
    assert recording.map_origin is not None
    origin = {key: "north" for key in recording.metadata if key.startswith("origin_")}
    assert replace(recording, metadata={**recording.metadata, **origin}).map_origin is None


def test_a_coarse_gyro_that_keeps_its_value_on_a_straight_passes():
    coarse = changed("imu/data", RATES, lambda w: np.round(w / 0.006) * 0.006)
    assert reason(coarse(driven(prototype(), "brake"))) == ""


def test_a_recording_shorter_than_a_manoeuvre_is_refused():
    assert "nowhere 6 s of driving" in reason(driven(prototype(), "slalom", duration=4.0))


def test_one_manoeuvre_is_too_little():
    assert "only 7.1 s of driving can be used, 10 s are needed" in reason(driven(prototype(), "slalom", duration=7.2))


def test_a_car_that_goes_straight_on_at_one_speed_tells_nothing():
    assert "straight ahead at constant speed (at most 0.01 m/s² lateral" in reason(driven(prototype(), "straight"))


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (without("vehicle/steering"), "no steering angle"),
        (without("vehicle/wheel_speeds", "gps/velocity"), "neither wheel speeds nor GNSS"),
        (without("imu/data"), "no inertial measurements"),
        (in_frame("imu/data", "imu_rear"), "frame_id 'imu_rear', expected 'imu_link'"),
        (changed("imu/data", RATES, held(2, 0, 100_000)), "the yaw rate is frozen"),
        (changed("imu/data", RATES, held(2, 1000, 1400)), "the yaw rate is frozen for 1.6 s"),
        (changed("imu/data", FORCES, held(0, 1000, 1400)), "the longitudinal acceleration is frozen"),
        (changed("vehicle/wheel_speeds", "velocity", held(3, 500, 800)), "the speed of the wheel rr is frozen"),
        (changed("vehicle/wheel_speeds", "velocity", held(slice(None), 500, 800)), "the speed of the wheel fl is"),
        (changed("vehicle/steering", "position", held(0, 400, 800)), "the steering angle is frozen for 4.0 s"),
        (changed("vehicle/steering", "position", lambda p: np.clip(p, -0.52, 0.51)), "of its range, 0.0"),
        (changed("vehicle/wheel_torques", "effort", held(slice(None), 300, 800)), "the wheel torques are frozen"),
        (changed("gps/velocity", "linear", held(slice(None), 40, 90)), "GNSS velocity to the east is frozen"),
        (changed("imu/data", RATES, lambda w: np.clip(w, -0.12, 0.12)), "the yaw rate is at the end of its range"),
        (changed("imu/data", FORCES, lambda f: np.clip(f, -2.0, 20)), "acceleration is at the end of its range"),
        (changed("imu/data", RATES, scaled(2, 10)), "the car spins"),
        (changed("imu/data", RATES, scaled(slice(None), 180 / np.pi)), "the car spins in slalom, or the unit"),
        (changed("imu/data", FORCES, scaled(slice(None), 1 / 9.81)), "specific force looks like g"),
        (changed("imu/data", FORCES, scaled(1, -1)), "the lateral acceleration is against speed times yaw rate"),
        (changed("imu/data", FORCES, scaled(1, 1 / 9.81)), "is its unit wrong?"),
        (changed("vehicle/wheel_speeds", "velocity", scaled(slice(None), 0.27)), "look like m/s, expected rad/s"),
        (changed("vehicle/steering", "position", scaled(0, 0.07)), "steering_wheel would turn a usual car"),
        (changed("vehicle/steering", "position", scaled(0, -1)), "expected positive to the left"),
        (changed("vehicle/wheel_torques", "effort", scaled(slice(None), 1e-3)), "the wheel torque over radius"),
        (all_of(NO_GNSS, changed("vehicle/wheel_speeds", "velocity", scaled(slice(None), 3.6))), "yaw rate or speed"),
        (all_of(NO_GNSS, changed("vehicle/steering", "position", scaled(0, -1))), "the road-wheel angle has the sign"),
        (all_of(NO_GNSS, later("vehicle/steering", 1.2)), "the road-wheel angle"),
    ],
)  # fmt: skip
def test_a_spoilt_recording_is_refused_for_what_was_done_to_it(change, found):
    manoeuvre = "brake" if found.startswith("the wheel torque") else "slalom"
    assert found in reason(change(driven(prototype(), manoeuvre)))


def compared(*recordings: Recording, held_out: tuple[Recording, ...] = ()) -> Comparable:
    return comparable(recordings, held_out, prototype())


def signals_of(found: Comparable) -> list[set[str]]:
    """The names of the signals that are compared in each recording."""
    predictor = Predictor(found.vehicle, found.fitted)
    return [set(predictor.measured[rows[0]]) for rows in found.fitted.places_by_recording()]


REVERSED = changed("imu/data", FORCES, scaled(1, -1))
FROZEN_GYRO = changed("imu/data", RATES, held(2, 0, 100_000))


@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (lambda r: r, set()),
        (REVERSED, {"lateral_acceleration"}),
        pytest.param(
            changed("imu/data", FORCES, scaled(1, 1 / 9.81)), {"lateral_acceleration"}, marks=pytest.mark.exam
        ),
        pytest.param(FROZEN_GYRO, {"yaw_rate"}, marks=pytest.mark.exam),
        (changed("gps/velocity", "linear", held(slice(None), 0, 10_000)), {"course", "ground_speed"}),
    ],
)
def test_a_signal_that_contradicts_the_others_is_left_out_and_the_rest_is_compared(change, lost):
    sound, found = compared(driven(prototype(), "sweep")), compared(change(driven(prototype(), "sweep")))
    assert found.refused == ""
    assert len(found.left_out) == bool(lost)
    assert signals_of(sound)[0] - signals_of(found)[0] >= lost
    assert len(signals_of(sound)[0] - signals_of(found)[0]) <= 2 * len(lost)


def test_a_sign_is_wrong_in_all_recordings_and_what_is_frozen_in_one_of_them():
    one, other = driven(prototype(), "sweep"), driven(prototype(), "slalom")
    by_sign = signals_of(compared(REVERSED(one), other))
    assert all("lateral_acceleration" not in of for of in by_sign)
    by_frozen = signals_of(compared(FROZEN_GYRO(one), other))
    assert ["yaw_rate" in of for of in by_frozen] == [False, True]


def test_nothing_is_compared_without_a_steering_angle_that_is_right():
    found = compared(changed("vehicle/steering", "position", scaled(0, -1))(driven(prototype(), "slalom")))
    assert "expected positive to the left" in found.refused
    assert not found.left_out


def test_of_a_sensor_that_lies_otherwise_the_axis_that_is_wrong_in_the_car_is_left_out():
    imu = prototype().sensors["imu"].model_copy(update={"attitude": (0.0, 0.0, np.pi / 2)})  # forward is to the left
    lacking = without_components(driven(prototype(), "slalom"), imu, (2, 4))["imu/data"].columns
    assert np.isnan(lacking[FORCES]).all(axis=0).tolist() == [True, False, False]
    assert np.isnan(lacking[RATES]).all(axis=0).tolist() == [False, False, True]


def test_coarse_steps_are_said():
    coarse = changed("imu/data", RATES, lambda w: np.round(w / 0.0223) * 0.0223)
    said = " ".join(steps_in_words([coarse(driven(prototype(), "slalom"))], prototype()))
    assert "has steps of 0.0223 rad/s" in said
    assert "angular_velocity.z" in said
    assert not steps_in_words([driven(prototype(), "slalom")], prototype())


def test_one_spoilt_recording_among_good_ones_is_refused_by_name_held_out_or_not():
    good, bad = driven(prototype(), "sweep"), changed("imu/data", RATES, scaled(2, 10))(driven(prototype(), "slalom"))
    assert "the car spins in slalom" in reason(good, bad)
    assert "the car spins in slalom" in reason(good, held_out=(bad,))


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda r: replace(r, metadata={**r.metadata, "vehicle": "van"}), "the vehicle is 'Prototype"),
        (changed("vehicle/wheel_speeds", "velocity", scaled(slice(None), 0.93)), "% larger than those of"),
        (changed("imu/data", FORCES, lambda f: np.add(f, [0.0, 2.0, 0.0])), "lateral accelerometer has shifted by 2.0"),
    ],
)
def test_recordings_of_different_cars_or_mountings_are_refused(change, found):
    other = change(driven(prototype(), "slalom"))
    assert found in reason(driven(prototype(), "sweep"), other)
    assert found in reason(driven(prototype(), "sweep"), held_out=(other,))


def test_sensors_of_one_topic_in_two_places_are_refused():
    sensors = prototype().sensors
    anywhere = prototype().model_copy(
        update={"sensors": {**sensors, "imu": sensors["imu"].model_copy(update={"frame_id": ""})}}
    )
    moved = in_frame("imu/data", "imu_rear")(driven(prototype(), "slalom"))
    assert "frame of imu/data is 'imu_link' in one and 'imu_rear'" in reason(
        driven(prototype(), "sweep"), moved, vehicle=anywhere
    )


def test_an_upside_down_sensor_that_the_file_knows_of_passes():
    sensors = prototype().sensors
    turned = sensors["imu"].model_copy(update={"attitude": (np.pi, 0.0, 0.0)})
    vehicle = prototype().model_copy(update={"sensors": {**sensors, "imu": turned}})
    flip = all_of(*(changed("imu/data", field, lambda v: v * [1.0, -1.0, -1.0]) for field in (RATES, FORCES)))
    recording = driven(prototype(), "slalom")
    assert reason(flip(recording), vehicle=vehicle) == ""
    assert "gravity is on -z" in reason(flip(recording))


def test_two_sensors_of_one_kind_are_refused():
    sensors = prototype().sensors
    second = sensors["imu"].model_copy(update={"topic": "imu/second"})
    vehicle = prototype().model_copy(update={"sensors": {**sensors, "second": second}})
    recording = driven(prototype(), "slalom")
    assert reason(recording, vehicle=vehicle) == ""
    twice = with_channel(recording, replace(recording["imu/data"], topic="imu/second"))
    assert "2 sensors of the kind imu with measurements (imu, second)" in reason(twice, vehicle=vehicle)


def test_an_effect_that_needs_an_absent_signal_is_not_assessable():
    found = explain_recordings(
        [without("vehicle/wheel_torques")(driven(prototype(), "slalom"))], prototype(), assume=["aero_drag"]
    )
    assert found.answer.verdict == "not_assessable"
    assert "aero_drag: it needs wheel torques, which these recordings do not have" in found.answer.sentence


def test_what_is_refused_is_not_assessable_and_nothing_is_named(tmp_path):
    result = explain_recordings([changed("imu/data", RATES, scaled(2, 10))(driven(prototype(), "slalom"))], prototype())
    assert result.answer.verdict == "not_assessable"
    assert result.answer.effects == ()
    assert "the car spins" in result.answer.sentence
    result.write(tmp_path)
    assert not (tmp_path / "vehicle.extended.yaml").exists()


@pytest.mark.exam
def test_recordings_of_cars_that_no_parameters_fit_alike_are_refused():
    van = prototype().with_parameters(
        {"chassis.mass": 1000.0, "front.unloaded_radius": 0.262, "rear.unloaded_radius": 0.262}
    )
    result = explain_recordings([driven(prototype(), "brake"), NO_GNSS(driven(van, "brake"))], prototype())
    found = result.answer
    assert found.verdict == "not_assessable"
    assert "are they recordings of one car?" in found.sentence
    # What was fitted is shown: errors, the parameters that do not fit, and the curves of both recordings.
    assert {signal.name for signal in found.located.signals} == set(found.fit)
    assert found.fit["speed"].training.before == found.fit["speed"].training.after > 0
    assert abs(found.base["mass"].value) > 0.1
    assert {trace.recording for trace in result.traces} == {window.recording for window in found.located.segments}
    assert not found.effects


def test_a_fit_that_is_still_changing_is_none_to_start_from():
    restless = Fit(ParameterSet({}), (), np.zeros(0), [np.full(10, 1.5)], [np.zeros((10, 0))], 0.0, converged=False)
    assert "the base parameters do not settle: after 8 steps" in misfit(
        restless, SimpleNamespace(level=Residuals.level)
    )
    near = replace(restless, residuals=[np.full(10, 0.9)])
    assert misfit(near, SimpleNamespace(level=Residuals.level)) == ""


@pytest.mark.exam
def test_a_file_of_another_car_that_leaves_the_road_with_the_recorded_inputs_is_asked_about():
    ice = prototype().with_parameters({"front.grip_scale": 0.05, "rear.grip_scale": 0.02})
    found = explain_recordings([driven(prototype(), "slalom")], ice).answer
    assert found.verdict in ("not_assessable", "unknown")
    assert not [effect for effect in found.effects if effect.accepted]


def test_a_fit_of_no_parameters_is_none_of_another_car():
    base = Fit(ParameterSet({}), (), np.zeros(0), [np.full(10, 9.0)], [np.zeros((10, 0))], 0.0)
    assert not misfit(base, SimpleNamespace(level=Residuals.level))


@pytest.mark.parametrize("radius", [0.27, 0.2778, 0.285])
def test_small_wheels_that_the_file_knows_of_are_not_taken_for_kilometres_per_hour(radius):
    recording = driven(prototype(), "brake", 20.0)
    wheels = recording["vehicle/wheel_speeds"]
    by = float(np.mean(rolling_radii(prototype()))) / radius
    turning = changed(wheels.topic, "velocity", lambda values: by * values)(recording)
    for known, expected in ((None, True), (radius, False), (0.34, True)):
        found = [f.mend for f in rolling(Subject(turning, radius=known), ()) if isinstance(f.mend, Scale)]
        assert [mend.given for mend in found] == ["km/h"] * expected


@pytest.mark.parametrize(
    ("outside", "refused"),
    [
        ({}, False),
        ({"roll stiffness, rear": -0.6}, False),
        ({"mass": 1.5}, True),
        ({"roll stiffness, rear": -0.6, "grip, front": 1.5}, True),
    ],
)
def test_a_mass_or_several_parameters_out_of_bounds_are_of_another_car_and_one_stiffness_may_be_physics(
    outside, refused
):
    offsets = np.array([outside.get(parameter.name, 0.0) for parameter in BASE])
    base = Fit(ParameterSet({}), BASE, offsets, [np.full(10, 0.5)], [], 0.0)
    found = misfit(base, SimpleNamespace(level=Residuals.level))
    assert bool(found) == refused
    assert all(name in found for name in outside) or not refused


def spoilt_for_a_while(recording: Recording) -> Recording:
    """The yaw rate at the end of its range for a second and a half, and a car that is thrown about for one."""
    columns = recording["imu/data"].columns
    t = recording["imu/data"].seconds
    rates = columns[RATES].copy()
    end = rates[:, 2].max()
    rates[:, 2] = np.where((t > 14.0) & (t < 15.5), end, rates[:, 2])
    rates[:, 2] = np.where((t > 30.0) & (t < 31.0), 0.99 * end, rates[:, 2])  # not at the end, and keeps changing
    return changed("imu/data", RATES, lambda _: rates)(recording)


def test_a_stretch_that_is_spoilt_is_cut_out_and_told_and_the_rest_is_looked_at():
    recording = spoilt_for_a_while(driven(prototype(), "sweep", duration=40.0))
    whole, kept = build_dataset([recording], prototype()), without_spoilt([recording], prototype())
    assert all(w.end < 14.0 or w.begin > 15.4 for w in kept.windows)
    assert 0.5 * whole.driven < kept.driven < whole.driven - 1.4
    (told,) = (remark for remark in kept.remarks if remark.startswith("cut out: the yaw rate is at the end"))
    assert "13.5 to 16.0 s" in told
    assert hindrance([recording], kept, build_dataset([], prototype()), prototype()) is None


def test_a_recording_of_which_little_would_be_left_is_kept_whole_and_refused():
    frozen = changed("imu/data", RATES, held(2, 0, 100_000))(driven(prototype(), "slalom"))
    kept = without_spoilt([frozen], prototype())
    found = hindrance([frozen], kept, build_dataset([], prototype()), prototype())
    assert found is not None
    assert "the yaw rate is frozen" in found.reason


def beside(metres: float, recording: Recording) -> Recording:
    """With the velocities of an antenna so far to the left of where it was."""
    velocity, imu = recording["gps/velocity"], recording["imu/data"]
    east, north = velocity.columns["linear"][:, :2].T
    course = np.arctan2(north, east)
    rate = np.interp(velocity.stamp, imu.stamp, imu.columns[RATES][:, 2])
    slower = -metres * rate[:, None] * np.column_stack([np.cos(course), np.sin(course), np.zeros(len(course))])
    return changed("gps/velocity", "linear", lambda v: v + slower)(recording)


def test_an_antenna_beside_the_middle_of_a_car_in_a_bend_is_no_other_car():
    straight, bend = driven(prototype(), "slalom"), beside(2.0, driven(prototype(), "bend"))
    assert "larger than those of" not in reason(straight, bend)
    assert "look like" not in reason(straight, bend)


def test_a_recording_of_which_nothing_is_compared_takes_no_signal_from_the_others():
    doubtful = changed("vehicle/wheel_speeds", "velocity", scaled(slice(None), 1.5))(driven(prototype(), "brake"))
    good = driven(prototype(), "slalom")
    for compared, expected in (([good, doubtful], ""), ([good], "brake")):
        dataset = build_dataset(compared, prototype())
        found = hindrance([good, doubtful], dataset, build_dataset([], prototype()), prototype())
        assert found is not None
        assert (found.topic, found.recording) == ("vehicle/wheel_speeds", expected)


def test_a_recording_of_another_car_among_several_is_left_out_and_named():
    big = prototype().with_parameters(
        {
            f"{axle}.unloaded_radius": 1.06 * prototype().values()[f"{axle}.unloaded_radius"]
            for axle in ("front", "rear")
        }
    )
    recordings = [driven(prototype(), "sweep"), driven(big, "brake"), driven(prototype(), "slalom")]
    found = comparable(recordings, (), prototype())
    assert not found.refused
    assert [one.name for one in found.recordings] == ["sweep", "slalom"]
    (said,) = found.left_out
    assert "is brake of another car than the others?" in said
