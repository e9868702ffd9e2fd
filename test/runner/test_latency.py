"""Sensors whose stamps are late by a known time: found by their readings alone, said, and used at their time."""

from __future__ import annotations

import tracemalloc
from functools import cache

import numpy as np
import pytest

from drives import messages
from vsense_ros.estimation.timeline import Event
from vsense_ros.evaluate.faults import IMU, Fault, stamped
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner
from vsense_ros.runner.latency import Latencies
from vsense_ros.runner.place_lag import PlaceLag

SECOND = 1_000_000_000
SPEED = 15.0  # [m/s]
SEED = 5


@cache
def car() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_model"))


def turning(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Yaw rate [rad/s] and heading [rad] of a drive on a winding road."""
    waves = ((0.12, 0.23, 0.0), (0.06, 0.71, 1.0), (0.03, 1.9, 2.0))  # amplitude, angular frequency, phase
    rate = sum(a * np.sin(w * times + p) for a, w, p in waves)
    heading = sum(-a / w * np.cos(w * times + p) for a, w, p in waves)
    return np.asarray(rate), np.asarray(heading)


def driven(late: dict[str, float], seconds: float = 30.0, wheels_until: float = np.inf) -> Latencies:
    """What is found on that road, without side slip, where some sensors are late [s]: gyro and wheels at 100 Hz, these
    until they fall silent [s], the course of an antenna above the rear axle at 10 Hz, all with noise."""
    vehicle = car()
    sensors = vehicle.sensing()
    antenna = sensors["velocity"].model_copy(update={"position": (-car_numbers(vehicle)["to_rear"], 0.0, 1.0)})
    sensors = {**sensors, "velocity": antenna}
    latencies, numbers, names = Latencies(vehicle, sensors), car_numbers(vehicle), list(sensors)
    slip = (
        numbers["mass"] * numbers["to_front"] / (numbers["to_front"] + numbers["to_rear"]) / numbers["rear_stiffness"]
    )
    rng = np.random.default_rng(SEED)
    for k in range(round(100 * seconds)):
        stamp = 100 * SECOND + k * SECOND // 100

        def made(name: str, k: int = k) -> float:
            return k / 100 - late.get(name, 0.0)  # when the reading was made that has this stamp

        rate, _ = turning(np.array(made("imu")))
        imu = [0.0, 0.0, rate, 0.0, SPEED * rate, 9.8] + 0.01 * rng.standard_normal(6)
        rate, _ = turning(np.array(made("wheel_speeds")))
        outward = numbers["rear_half_track"] * rate
        wheels = (SPEED + np.array([-outward, outward, -outward, outward])) / numbers["rear_radius"]
        readings = [("imu", imu)]
        if k / 100 < wheels_until:
            readings.append(("wheel_speeds", wheels + 0.02 * rng.standard_normal(4)))
        if k % 10 == 0:
            rate, heading = turning(np.array(made("velocity")))
            course = heading - slip * SPEED * rate  # the rear axle slips outwards
            velocity = SPEED * np.array([np.cos(course), np.sin(course)])
            readings.append(("velocity", velocity + 0.03 * rng.standard_normal(2)))
        for name, value in readings:
            latencies.hear(Event(names.index(name), stamp, value, np.ones(len(value))))
        latencies.look(stamp)
    return latencies


@pytest.mark.parametrize(
    "late", [{}, {"imu": 0.35}, {"imu": 1.0}, {"velocity": 0.5}, {"wheel_speeds": 0.2}, {"imu": -0.4}]
)
def test_the_sensor_that_is_late_is_found_with_its_lag(late: dict[str, float]) -> None:
    latencies, names = driven(late), list(car().sensing())
    assert {names[i] for i in latencies.late} == set(late)
    for i, found in latencies.by_sensor.items():
        true = late.get(names[i], 0.0)
        assert abs(found.seconds - true) < min(0.03, 3 * found.deviation)


def test_lags_of_the_others_are_found_after_a_sensor_fell_silent() -> None:
    latencies, names = driven({"velocity": 0.5}, seconds=45.0, wheels_until=3.0), list(car().sensing())
    assert set(latencies.late) == {names.index("velocity")}


@pytest.mark.parametrize("sits", [1.7, -1.3])
@pytest.mark.parametrize("late", [0.0, 0.6])
def test_an_antenna_that_sits_elsewhere_makes_no_lag_of_a_course_alone(sits: float, late: float) -> None:
    """By the file it is 1.7 m ahead of the rear axle; without wheels, while the car gains and loses speed."""
    vehicle, ahead = car(), 1.7
    sensors = vehicle.sensing()
    names, to_rear = list(sensors), car_numbers(vehicle)["to_rear"]
    sensors = {
        **sensors,
        "velocity": sensors["velocity"].model_copy(update={"position": (ahead - to_rear, 0.0, 1.0)}),
    }
    latencies, rng = Latencies(vehicle, sensors), np.random.default_rng(SEED)
    for k in range(4000):
        stamp = 100 * SECOND + k * SECOND // 100
        rate, _ = turning(np.array(k / 100))
        imu = np.array([0.0, 0.0, rate, 1.2 * np.cos(0.4 * k / 100), 0.0, 9.8])
        readings = [("imu", imu + 0.01 * rng.standard_normal(6))]
        if k % 10 == 0:
            rate, heading = turning(np.array(k / 100 - late))
            speed = 7.0 + 3.0 * np.sin(0.4 * (k / 100 - late))
            course = heading + np.arctan(sits * rate / speed)
            velocity = speed * np.array([np.cos(course), np.sin(course)])
            readings.append(("velocity", velocity + 0.01 * rng.standard_normal(2)))
        for name, value in readings:
            latencies.hear(Event(names.index(name), stamp, value, np.ones(len(value))))
        latencies.look(stamp)
    assert latencies.by_sensor[names.index("velocity")].seconds == pytest.approx(late, abs=0.1)
    assert bool(latencies.late) == (late > 0)


def test_a_car_that_goes_straight_shows_no_lag() -> None:
    latencies = Latencies(car(), car().sensing())
    rng, names = np.random.default_rng(SEED), list(car().sensing())
    for k in range(2000):
        value = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8]) + 0.01 * rng.standard_normal(6)
        latencies.hear(Event(names.index("imu"), k * SECOND // 100, value, np.ones(6)))
        latencies.hear(Event(names.index("wheel_speeds"), k * SECOND // 100, np.full(4, 50.0), np.ones(4)))
        latencies.look(k * SECOND // 100)
    assert not latencies.by_sensor


def test_an_inertial_sensor_that_is_late_is_said_and_used_at_its_time(lane_change: Recording, vehicle: Vehicle) -> None:
    """Once the first bend has shown that something is late errors are within what is said of them, and once it is known
    how late they are small."""
    late = 0.3
    recording = Fault("late", (IMU,), stamped(late), 0.0).of(lane_change)
    runner = Runner(vehicle, recording.map_origin)
    rows, due = [], lane_change.start + 2 * SECOND
    truth = lane_change["reference/odometry"]
    for sample in messages(recording):
        runner.add(sample)
        if runner.started and runner.stamp > due:
            due = runner.stamp + SECOND // 20
            values = runner.estimate()[0].values
            variances = values["twist_covariance"].reshape(6, 6).diagonal()
            true = [
                np.interp(runner.stamp, truth.stamp, truth.columns[name][:, axis])
                for name, axis in (("linear", 1), ("angular", 2))
            ]
            errors = np.array([values["linear"][1], values["angular"][2]]) - true
            rows.append((runner.stamp, *errors, *np.sqrt(variances[[1, 5]])))
    line = next(line for line in runner.diagnostics() if line.name == "observer")
    assert "imu is" in line.message
    assert "ms late" in line.message
    found = runner.latency.latencies.late[runner.names.index("imu")]
    assert found.seconds == pytest.approx(late, abs=3 * found.deviation)
    stamps, *columns = np.array(rows).T
    errors, deviations = np.abs(columns[:2]), np.array(columns[2:])
    shown = stamps > lane_change.start + 5 * SECOND
    assert np.mean((errors < 3 * deviations)[:, shown], axis=1) == pytest.approx(1.0, abs=0.01)
    assert errors[0, stamps > lane_change.start + 11 * SECOND].max() < 0.3


def test_a_lag_is_doubted_until_readings_show_that_there_is_none_or_it_is_taken_off() -> None:
    assert driven({"imu": 0.15}, seconds=0.2).doubt.lags[0] < 0.03
    assert driven({}, seconds=12.0).doubt.lags[0] < 0.03 < driven({"imu": 0.15}, seconds=12.0).doubt.lags[0]
    for late in ({}, {"imu": 0.15}):
        assert driven(late, seconds=20.0).doubt.lags[0] < 0.05


@pytest.mark.parametrize("rate", [np.nan, np.inf, 1e300])
def test_a_yaw_rate_that_no_car_has_leaves_the_doubt_as_it_was(rate: float) -> None:
    doubt = driven({}, seconds=0.2).doubt
    doubt.feel(100 * SECOND, 0.01, (0.1, 0.1), SPEED)
    before = doubt.apart
    doubt.feel(101 * SECOND, 0.01, (rate, 0.1), SPEED)
    assert doubt.apart == before


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_the_lag_of_fixes_is_found_beside_velocities_that_have_a_bias(late: float) -> None:
    fixes, rng = PlaceLag(), np.random.default_rng(SEED)

    def velocity(t: np.ndarray) -> np.ndarray:
        _, heading = turning(t)
        return np.column_stack([SPEED * np.cos(heading), SPEED * np.sin(heading)])

    fine = np.arange(-1.0, 40.0, 0.001)
    way = np.cumsum(velocity(fine) * 0.001, axis=0)
    for k, t in enumerate(np.arange(0.0, 40.0, 0.1)):
        place = [np.interp(t - late, fine, axis) for axis in way.T] + 0.3 * rng.standard_normal(2)
        seen = velocity(np.array([t]))[0] + 0.03 * rng.standard_normal(2) + 0.05
        fixes.hear(Event(0, 100 * SECOND + k * SECOND // 10, place, np.ones(2)), is_place=True)
        fixes.hear(Event(0, 100 * SECOND + k * SECOND // 10, seen, np.ones(2)), is_place=False)
    found = fixes.lag()
    assert found is not None
    assert found[0] == pytest.approx(late, abs=3 * found[1])
    assert found[1] < 0.03


def test_readings_that_nobody_looks_at_are_not_kept_for_ever() -> None:
    vehicle = car()
    latencies = Latencies(vehicle, vehicle.sensing())
    value, variance = np.zeros(6), np.ones(6)
    imu = list(vehicle.sensing()).index("imu")
    tracemalloc.start()
    for k in range(30_000):  # five minutes at 100 Hz, in which no receiver has a fix
        latencies.hear(Event(imu, k * SECOND // 100, value.copy(), variance))
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 3e6
