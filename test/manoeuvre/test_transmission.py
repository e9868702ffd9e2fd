"""What a bus and a receiver do to the values of a simulated sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.receivers import RECEIVERS, with_receiver
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors.base import Transmission
from vsense_ros.model.sensors.gnss_attitude import GnssAttitude
from vsense_ros.model.sensors.gnss_tilt import GnssTilt
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle


@pytest.fixture(scope="module")
def saloon() -> Vehicle:
    return load_vehicle(Path(__file__).resolve().parents[2] / "config" / "vehicles" / "jaguar_saloon.yaml")


@pytest.fixture(scope="module")
def turn(saloon: Vehicle) -> Trajectory:
    q, u = rolling_straight(saloon, 10.0)
    return simulate(saloon, lambda t, q, u: np.array([0.06, 0, 0, 40, 40]), 3.0, q=q, u=u)


def recorded(turn: Trajectory, car: Vehicle) -> Recording:
    return record(turn, car, 1, name="turn")


def with_transmission(car: Vehicle, sensor: str, **bus: object) -> Vehicle:
    changed = car.sensors[sensor].model_copy(update={"transmission": Transmission.model_validate(bus)})
    return car.model_copy(update={"sensors": car.sensors | {sensor: changed}})


def test_a_bus_quantizes_limits_thins_and_delays(saloon: Vehicle, turn: Trajectory) -> None:
    step = np.radians(0.25)
    car = with_transmission(
        saloon, "imu", period=0.02, delay=0.013, range=(0.1,) * 3 + (2.0,) * 3, resolution=(step,) * 3 + (0.05,) * 3
    )
    plain, bus = (recorded(turn, one).channels["imu/data"] for one in (saloon, car))
    yaw_rate = bus.columns["angular_velocity"][:, 2]
    assert np.diff(bus.stamp) == pytest.approx(20_000_000)
    assert bus.received - bus.stamp == pytest.approx(13_000_000)
    assert yaw_rate / step == pytest.approx(np.rint(yaw_rate / step), abs=1e-9)
    assert plain.columns["angular_velocity"][-50:, 2].mean() > 0.15  # it turns faster than the bus can say
    assert yaw_rate.max() == pytest.approx(0.1, abs=step / 2)
    assert np.abs(bus.columns["linear_acceleration"]).max() <= 2.0 + 0.025


def test_without_a_bus_nothing_changes(saloon: Vehicle, turn: Trajectory) -> None:
    plain, bus = (recorded(turn, car) for car in (saloon, with_transmission(saloon, "imu")))
    for topic, channel in plain.channels.items():
        for name, column in channel.columns.items():
            assert np.array_equal(column, bus.channels[topic].columns[name], equal_nan=True)


@pytest.mark.parametrize("name", RECEIVERS)
def test_a_receiver_has_the_noise_of_the_table(name: str, saloon: Vehicle, turn: Trajectory) -> None:
    channel = recorded(turn, with_receiver(saloon, name, 100.0)).channels["gps/velocity"]
    assert np.diff(channel.stamp) == pytest.approx(10_000_000)
    heading, u = turn.q[::10, 5], turn.u[::10]
    east = u[:, 0] * np.cos(heading) - u[:, 1] * np.sin(heading)
    # 300 values tell a standard deviation to 4 %.
    assert np.std(channel.columns["linear"][:, 0] - east) == pytest.approx(RECEIVERS[name].velocity, rel=0.2)


def test_a_receiver_of_one_hertz_gives_a_fix_a_second(saloon: Vehicle, turn: Trajectory) -> None:
    found = recorded(turn, with_receiver(saloon, rate=1.0))
    assert len(found.channels["gps/velocity"]) == len(found.channels["gps/fix"]) == 4
    assert with_receiver(saloon, rate=1.0).sensors["velocity"].timeout >= 2.5


def test_a_car_without_gnss_gets_one(saloon: Vehicle) -> None:
    bare = saloon.model_copy(update={"sensors": {}})
    assert set(with_receiver(bare, "survey").sensors) == {"position", "velocity"}


def test_unknown_receivers_and_rates_are_refused(saloon: Vehicle) -> None:
    with pytest.raises(InputError, match=r"no receiver 'military'; known are survey"):
        with_receiver(saloon, "military")
    with pytest.raises(InputError, match=r"0\.1 to 100 fixes a second, not 0"):
        with_receiver(saloon, rate=0.0)


def test_a_resolution_that_fits_no_message_is_told(saloon: Vehicle, turn: Trajectory) -> None:
    with pytest.raises(InputError, match="resolution of 2 numbers for messages of 6 values"):
        recorded(turn, with_transmission(saloon, "imu", resolution=(0.1, 0.1)))


def test_the_errors_of_the_steering_sensor_are_those_of_its_file(saloon: Vehicle, turn: Trajectory) -> None:
    known = {"simulated_noise": 0.003, "simulated_bias": 0.0}
    changed = saloon.sensors["steering"].model_copy(update=known)
    car = saloon.model_copy(update={"sensors": saloon.sensors | {"steering": changed}})
    error = recorded(turn, car).channels["vehicle/steering"].columns["position"][:, 0] - 17.58 * 0.06
    assert abs(error.mean()) < 5 * 0.003 / np.sqrt(len(error))
    assert np.std(error) == pytest.approx(0.003, rel=0.15)


def test_two_antennas_give_the_direction_of_their_base_line_with_the_noise_of_the_file(
    saloon: Vehicle, turn: Trajectory
) -> None:
    bus = Transmission(period=0.01)
    antennas = GnssAttitude(yaw=1.2, noise=0.02, transmission=bus)
    channel = recorded(turn, saloon.model_copy(update={"sensors": saloon.sensors | {"antennas": antennas}})).channels[
        "gps/attitude"
    ]
    seen = Rotation.from_quat(channel.columns["orientation"]).as_euler("ZYX")[:, 0]
    error = np.angle(np.exp(1j * (seen - turn.q[::10, 5] - 1.2)))
    assert np.std(error) == pytest.approx(0.02, rel=0.2)  # of 300 values
    assert abs(np.mean(error)) < 0.005
    assert channel.columns["orientation_covariance"][0, 8] == pytest.approx(0.02**2)


def test_two_sensors_of_one_topic_are_refused_and_not_lost(saloon: Vehicle, turn: Trajectory) -> None:
    antennas = {"heading": GnssAttitude(), "tilt": GnssTilt()}
    car = saloon.model_copy(update={"sensors": saloon.sensors | antennas})
    with pytest.raises(InputError, match="would send on gps/attitude in a simulation: give the gnss_tilt a topic"):
        recorded(turn, car)
