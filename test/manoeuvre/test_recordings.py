"""Generated recordings: the same for the same seed, true to the vehicle file, small."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from marks import exam_except
from studies.bags import LARGEST, SEED
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import compare
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import ON_ROADS, STANDARD, generate
from vsense_ros.messages.recording import Recording
from vsense_ros.runner import run

BAGS = Path(__file__).resolve().parents[2] / "bags"
NAMES = [m.name for m in STANDARD]
# The car with all its bodies takes half a minute to drive one of these.
ROADS = [pytest.param(m.name, marks=pytest.mark.exam) for m in ON_ROADS]


@pytest.fixture(scope="module")
def lane_change(plant) -> Recording:
    return generate("double_lane_change", plant, SEED)


def assert_same(a: Recording, b: Recording) -> None:
    assert set(a.channels) == set(b.channels)
    for topic, channel in a.channels.items():
        assert np.array_equal(channel.stamp, b[topic].stamp)
        assert np.array_equal(channel.received, b[topic].received)
        for name, column in channel.columns.items():
            assert np.array_equal(column, b[topic].columns[name]), f"{topic} {name}"


@pytest.mark.parametrize("name", [*exam_except(NAMES, "step_steer"), *ROADS])
def test_the_bags_of_the_repository_are_what_their_seed_gives(name, plant):
    """Decoded, so that another version of zstd does not matter."""
    assert_same(generate(name, plant, SEED), read_bag(BAGS / name))


@pytest.mark.exam
def test_the_same_seed_gives_the_same_file(tmp_path, lane_change, plant):
    digests = []
    for folder, recording in (("a", lane_change), ("b", generate("double_lane_change", plant, SEED))):
        write_bag(tmp_path / folder / "bag", recording)
        digests.append(hashlib.sha256((tmp_path / folder / "bag" / "bag_0.mcap").read_bytes()).hexdigest())
    assert digests[0] == digests[1]


def test_another_seed_gives_other_noise_and_the_same_truth(lane_change, plant):
    other = generate("double_lane_change", plant, SEED + 1)
    imu = "imu/data", "angular_velocity"
    assert not np.array_equal(lane_change[imu[0]].columns[imu[1]], other[imu[0]].columns[imu[1]])
    for field in ("position", "linear"):
        assert np.array_equal(
            lane_change["reference/odometry"].columns[field], other["reference/odometry"].columns[field]
        )


def test_a_known_error_of_a_sensor_is_in_what_it_sends(lane_change, plant):
    """Reading takes it off again."""
    imu = plant.sensors["imu"].model_copy(update={"rate_offset": (0.0, 0.0, 0.1)})
    off = generate("double_lane_change", plant.model_copy(update={"sensors": {**plant.sensors, "imu": imu}}), SEED)
    rates, shifted = (r["imu/data"].columns["angular_velocity"] for r in (lane_change, off))
    np.testing.assert_allclose(shifted - rates, np.broadcast_to([0.0, 0.0, 0.1], rates.shape), atol=2**-12)


@pytest.mark.parametrize("name", [*NAMES, *(m.name for m in ON_ROADS)])
def test_a_bag_is_small_enough_for_a_repository(name):
    assert sum(f.stat().st_size for f in (BAGS / name).iterdir()) < LARGEST


def test_noise_is_what_the_vehicle_file_states(lane_change, plant):
    """Where the car runs straight, differences of successive values hold twice the variance and no motion."""
    rate = lane_change["imu/data"].columns["angular_velocity"][:500]
    assert np.std(np.diff(rate, axis=0)) / np.sqrt(2) == pytest.approx(plant.sensors["imu"].rate_noise[0], rel=0.1)
    spin = lane_change["vehicle/wheel_speeds"].columns["velocity"][:200]
    assert np.std(np.diff(spin, axis=0)) / np.sqrt(2) == pytest.approx(plant.sensors["wheel_speeds"].noise, rel=0.15)


def test_an_accelerometer_of_a_car_on_a_straight_feels_gravity_alone(lane_change, plant):
    force = lane_change["imu/data"].columns["linear_acceleration"][100:400]
    bias = 3 * plant.sensors["imu"].force_bias
    assert force.mean(axis=0) == pytest.approx([0, 0, 9.80665], abs=bias + 0.2)


def test_gnss_arrives_a_tenth_of_a_second_after_it_was_measured(lane_change):
    for topic in ("gps/fix", "gps/velocity"):
        assert np.all(lane_change[topic].received - lane_change[topic].stamp == 100_000_000)


def test_gnss_positions_scatter_about_the_antenna(lane_change, plant):
    import pymap3d

    from vsense_ros.manoeuvre.sensing import SENSING

    fix, truth = lane_change["gps/fix"], lane_change["reference/odometry"]
    east, north, _ = pymap3d.geodetic2enu(
        fix.columns["latitude"][:, 0], fix.columns["longitude"][:, 0], SENSING.origin[2], *SENSING.origin
    )
    rows = np.searchsorted(truth.stamp, fix.stamp)
    error = np.column_stack([east, north]) - truth.columns["position"][rows, :2]
    noise = plant.sensors["position"].noise
    assert error.mean(axis=0) == pytest.approx([-0.3, 0.0], abs=4 * noise / np.sqrt(len(error)))
    assert error.std(axis=0) == pytest.approx([noise, noise], rel=0.25)


def test_wheel_torques_are_not_told(lane_change):
    assert "vehicle/wheel_torques" not in lane_change


def test_an_unknown_manoeuvre_is_refused_with_the_known_ones(plant):
    with pytest.raises(InputError, match="double_lane_change"):
        generate("moose_test", plant)


@pytest.mark.parametrize("name", exam_except(NAMES, "double_lane_change"))
def test_the_observer_follows_every_manoeuvre_with_the_wrong_mass_and_friction(name, model):
    recording = read_bag(BAGS / name)
    result = run(recording, model)
    scores = compare(result.output, recording)
    assert scores["side_slip"].rmse < np.radians(0.6)
    assert scores["yaw_rate"].rmse < np.radians(0.5)
    assert scores["speed"].rmse < 0.1
    assert all(int(d.values.get("refused", 0)) == 0 for d in result.diagnostics)


def test_the_vertical_velocity_of_the_hills_is_what_their_height_changes_by() -> None:
    recording = read_bag(BAGS / "hills")
    reference, velocity = recording["reference/odometry"], recording["gps/velocity"]
    height = reference.columns["position"][:, 2]
    climb = np.gradient(height, reference.seconds)
    there = np.interp(velocity.stamp, reference.stamp, climb)
    error = velocity.columns["linear"][:, 2] - there
    stated = np.sqrt(velocity.columns["covariance"][0, 14])
    assert np.std(there) > 5 * stated
    assert abs(error.mean()) < 4 * stated / len(error) ** 0.5
    assert 0.8 * stated < error.std() < 1.5 * stated


def test_a_car_that_overturns_has_no_recording() -> None:
    tall = load_vehicle(vehicle_path("rav4")).with_parameters({"chassis.cog_height": 1.3})
    with pytest.raises(InputError, match=r"overturns at [0-9.]+ s of steady_state_circle: take a slower one"):
        generate("steady_state_circle", tall)
