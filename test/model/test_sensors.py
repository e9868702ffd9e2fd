"""Sensor equations against a body that is moved along a path and differentiated numerically."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.kinematics import motion_of
from vsense_ros.model.coordinates import INPUTS
from vsense_ros.model.sensors import (
    GnssAttitude,
    GnssPosition,
    GnssVelocity,
    Imu,
    SensorBase,
    Steering,
    Suspension,
    WheelSpeeds,
    WheelTorques,
)

G = 9.80665
seeds = st.integers(0, 2**32 - 1)
relaxed = settings(deadline=None, max_examples=20)
Path = Callable[[float], np.ndarray]


def derivative(path: Path, order: int = 1, h: float = 2e-3) -> np.ndarray:
    """Derivative at time zero by central differences of sixth order."""
    ahead = np.array([path(k * h) for k in range(-3, 4)])
    weights = {
        1: np.array([-1, 9, -45, 0, 45, -9, 1]) / 60,
        2: np.array([2, -27, 270, -490, 270, -27, 2]) / 180,
    }[order]
    return np.tensordot(weights, ahead, 1) / h**order


class Flight:
    """A smooth random motion of a body; its state at time zero in the model's terms."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self._position = random.normal(size=(4, 3)) * np.array([[50], [20], [3], [1]])
        self._angles = random.normal(size=(4, 3)) * np.array([[0.3], [0.5], [0.5], [0.5]])

    def position(self, t: float) -> np.ndarray:
        return np.array([1, t, t**2, np.sin(3 * t)]) @ self._position

    def angles(self, t: float) -> np.ndarray:
        return np.array([1, t, t**2, np.sin(3 * t)]) @ self._angles

    def attitude(self, t: float) -> np.ndarray:
        return Rotation.from_euler("ZYX", self.angles(t)[::-1]).as_matrix()

    def point(self, arm: np.ndarray) -> Path:
        return lambda t: self.position(t) + self.attitude(t) @ arm

    def body_rates(self, t: float) -> np.ndarray:
        spin = self.attitude(t).T @ derivative(lambda s: self.attitude(t + s))
        return np.array([spin[2, 1], spin[0, 2], spin[1, 0]])

    def body_velocity(self, t: float) -> np.ndarray:
        return self.attitude(t).T @ derivative(lambda s: self.position(t + s))

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q, u, derivatives of u."""
        q, u, udot = np.zeros(14), np.zeros(14), np.zeros(14)
        q[:3], q[3:6] = self.position(0), self.angles(0)
        u[:3], u[3:6] = self.body_velocity(0), self.body_rates(0)
        udot[:3], udot[3:6] = derivative(self.body_velocity), derivative(self.body_rates)
        return q, u, udot


@pytest.fixture(scope="session")
def measure(car: Car) -> Callable[..., np.ndarray]:
    def value(
        sensor: SensorBase,
        state: tuple[np.ndarray, np.ndarray, np.ndarray],
        disturbances: tuple[float, ...] = (0,) * 7,
        biases: np.ndarray | None = None,
    ) -> np.ndarray:
        biases = np.zeros(len(sensor.biases())) if biases is None else biases
        motion = motion_of(*(ca.SX(x) for x in state), ca.SX(disturbances), ca.SX.zeros(len(INPUTS)))
        return np.asarray(ca.evalf(sensor.equation(motion, ca.SX(biases), ca.SX(sensor.mounting()))))[:, 0]

    return value


def test_an_imu_at_rest_on_level_ground_feels_gravity_upwards(measure):
    rest = (np.zeros(14), np.zeros(14), np.zeros(14))
    assert_allclose(measure(Imu(position=(1.0, 0.5, 0.3)), rest), [0, 0, 0, 0, 0, G], atol=1e-12)


def test_an_imu_that_stands_on_a_slope_feels_it(measure):
    rest = (np.zeros(14), np.zeros(14), np.zeros(14))
    uphill, left_up = measure(Imu(), rest, (0.1, *[0] * 6)), measure(Imu(), rest, (0, 0.05, *[0] * 5))
    assert_allclose(uphill[3:], [G * np.sin(0.1), 0, G * np.cos(0.1)])
    assert_allclose(left_up[3:], [0, G * np.sin(0.05), G * np.cos(0.05)])


@relaxed
@given(seed=seeds)
def test_an_imu_anywhere_on_the_body_measures_the_turning_and_the_acceleration_of_its_place(seed, measure):
    random = np.random.default_rng(seed)
    flight = Flight(seed)
    imu = Imu(position=tuple(random.normal(size=3)), attitude=tuple(random.uniform(-1.5, 1.5, 3)))
    mounting = Rotation.from_euler("ZYX", imu.attitude[::-1]).as_matrix()
    to_sensor = (flight.attitude(0) @ mounting).T
    acceleration = derivative(flight.point(np.array(imu.position)), 2)

    measured = measure(imu, flight.state)

    assert_allclose(measured[:3], mounting.T @ flight.body_rates(0), atol=1e-9)
    assert_allclose(measured[3:], to_sensor @ (acceleration + np.array([0, 0, G])), atol=1e-5)


@relaxed
@given(seed=seeds)
def test_an_imu_with_errors_of_scale_square_and_what_gyros_feel_reads_polynomials_of_the_true_one(seed, measure):
    """One accelerometer reads f + s f + k f² + c f |f|, one gyro w + g · f; f and w are those without errors."""
    random = np.random.default_rng(seed)
    state = Flight(seed).state
    scale, square, odd, felt = (random.normal(size=size) for size in (3, 3, 3, (3, 3)))
    errors = {"force_scale": scale, "force_square": square, "force_odd_square": odd, "rate_by_force": felt}
    true = measure(Imu(), state)
    read = measure(Imu(**{name: value.tolist() for name, value in errors.items()}), state)
    for axis in range(3):
        force = true[3 + axis]
        besides = odd[axis] * np.sign(force)
        assert read[3 + axis] == pytest.approx(np.polyval([square[axis] + besides, 1 + scale[axis], 0.0], force))
        assert read[axis] == pytest.approx(true[axis] + sum(g * f for g, f in zip(felt[axis], true[3:], strict=True)))


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, np.pi])
def test_an_imu_turned_on_its_mounting_leans_with_the_body(yaw, measure):
    """One that stays level on a body that rolls feels gravity upwards alone; one that leans by twice the body's roll
    feels the sine of that along the body's y."""
    q = np.zeros(14)
    q[3] = 0.1
    rolled = (q, np.zeros(14), np.zeros(14))
    levelled, twice = (measure(Imu(attitude=(0, 0, yaw), roll_gain=gain), rolled)[3:] for gain in (-1.0, 1.0))
    assert_allclose(levelled, [0, 0, G], atol=1e-12)
    lateral = G * np.sin(0.2)
    assert_allclose(twice, [lateral * np.sin(yaw), lateral * np.cos(yaw), G * np.cos(0.2)], atol=1e-12)


def test_a_bias_adds_to_what_an_imu_measures(measure):
    biases = np.arange(1.0, 7.0)
    state = Flight(1).state
    assert_allclose(measure(Imu(), state, biases=biases) - measure(Imu(), state), biases)


@relaxed
@given(seed=seeds)
def test_an_antenna_is_where_its_lever_arm_says_and_moves_as_that_place_does(seed, measure):
    arm = np.random.default_rng(seed).normal(size=3)
    flight = Flight(seed)
    place = flight.point(arm)
    position = measure(GnssPosition(position=tuple(arm)), flight.state)
    velocity = measure(GnssVelocity(position=tuple(arm)), flight.state)
    assert_allclose(position, place(0)[:2], atol=1e-9)
    assert_allclose(velocity, derivative(place)[:2], atol=1e-8)


def test_on_a_slope_the_map_sees_the_cosine_of_the_speed(measure):
    q, u = np.zeros(14), np.zeros(14)
    u[0] = 20.0
    assert_allclose(measure(GnssVelocity(), (q, u, u), (0.1, *[0] * 6)), [20 * np.cos(0.1), 0])


@relaxed
@given(seed=seeds)
def test_two_antennas_tell_the_direction_of_their_base_line(seed, measure):
    across = np.random.default_rng(seed).uniform(-3, 3)
    flight = Flight(seed)
    heading = flight.angles(0)[2] + across
    assert_allclose(measure(GnssAttitude(yaw=across), flight.state), [np.cos(heading), np.sin(heading)], atol=1e-12)


def test_wheels_and_suspension_are_measured_as_they_are(measure):
    q, u = np.arange(14.0), np.arange(14.0) * 2
    assert_allclose(measure(WheelSpeeds(), (q, u, u)), u[10:])
    assert_allclose(measure(Suspension(), (q, u, u)), q[6:10])


def read(sensor: SensorBase, names: tuple[str, ...] = (), **values: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Measurement and variance that a message gives; the variance is -1 where the message does not say."""
    size = len(sensor.deviations())
    out, variance = np.full(size, 99.0), np.full(size, -1.0)
    sensor.read(names, {key: np.array(value, dtype=float) for key, value in values.items()}, out, variance)
    return out, variance


def covariance(*diagonal: float) -> list[float]:
    return np.diag(diagonal).ravel().tolist()


def test_an_imu_message_gives_values_and_variances():
    out, variance = read(
        Imu(),
        angular_velocity=[1, 2, 3],
        linear_acceleration=[4, 5, 6],
        angular_velocity_covariance=covariance(0.1, 0.2, 0.3),
        linear_acceleration_covariance=[0.0] * 9,
    )
    assert_allclose(out, [1, 2, 3, 4, 5, 6])
    assert_allclose(variance, [0.1, 0.2, 0.3, -1, -1, -1])


def test_a_part_of_an_imu_message_that_is_marked_absent_is_not_used():
    out, _ = read(
        Imu(),
        angular_velocity=[1, 2, 3],
        linear_acceleration=[0, 0, 0],
        linear_acceleration_covariance=[-1.0] + [0.0] * 8,
    )
    assert_allclose(out, [1, 2, 3, np.nan, np.nan, np.nan])


def test_a_gnss_receiver_without_fix_gives_no_position():
    good = read(GnssPosition(), east=[3], north=[4], status=[0], position_covariance=covariance(4, 9, 16))
    lost = read(GnssPosition(), east=[3], north=[4], status=[-1])
    assert_allclose(good, [[3, 4], [4, 9]])
    assert np.all(np.isnan(lost[0]))


def test_the_noise_of_a_message_can_be_overruled_by_the_vehicle_file():
    sensor = GnssVelocity(noise_from_message=False)
    _, variance = read(sensor, linear=[1, 2, 0], covariance=covariance(1, 2, 3, 4, 5, 6))
    assert_allclose(variance, -1)
    imu = {"angular_velocity": [1, 2, 3], "linear_acceleration": [4, 5, 6]}
    stated = {"angular_velocity_covariance": covariance(1, 2, 3), "linear_acceleration_covariance": covariance(4, 5, 6)}
    out, variance = read(Imu(noise_from_message=False), **imu, **stated)
    assert_allclose(out, [1, 2, 3, 4, 5, 6])
    assert_allclose(variance, -1)
    heading = Rotation.identity().as_quat()
    attitude = GnssAttitude(noise_from_message=False)
    _, variance = read(attitude, orientation=heading, orientation_covariance=covariance(9, 9, 0.01))
    assert_allclose(variance, -1)


@pytest.mark.parametrize("heading", [-3.0, -0.4, 0.0, 1.2, 3.1])
def test_a_heading_is_read_from_a_quaternion_even_on_a_tilted_car(heading):
    orientation = Rotation.from_euler("ZYX", [heading, 0.1, -0.05]).as_quat()
    out, variance = read(GnssAttitude(), orientation=orientation, orientation_covariance=covariance(9, 9, 0.01))
    assert_allclose(out, [np.cos(heading), np.sin(heading)], atol=1e-12)
    assert_allclose(variance, 0.01)


@pytest.mark.parametrize("orientation", [[0, 0, 0, 0], [0, 0, 0.3, 0.2], [0, 0, 0, 1e3], [np.nan, 0, 0, 1]])
def test_a_quaternion_that_is_no_rotation_is_no_heading(orientation):
    out, _ = read(GnssAttitude(), orientation=orientation)
    assert np.isnan(out).all()


def test_joints_are_found_by_name_and_missing_ones_are_absent():
    out, _ = read(WheelSpeeds(), ("wheel_rr", "wheel_fl"), velocity=[4, 1])
    assert_allclose(out, [1, np.nan, np.nan, 4])
    out, _ = read(Suspension(), ("suspension_fl",), position=[])
    assert np.all(np.isnan(out))
    out, _ = read(WheelTorques(), ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"), effort=[1, 2, 3, 4])
    assert_allclose(out, [1, 2, 3, 4])


def test_a_wheel_that_reads_zero_may_turn_as_fast_as_its_sensor_does_not_measure():
    sensor, names = WheelSpeeds(lowest=1.5), ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    speeds = np.array([[0.0, -0.0, 3.0, np.nan], [1.6, 0.0, 2.0, 3.0]])
    values, variances = np.empty((2, 4)), np.full((2, 4), 0.01)
    sensor.read_rows(names, {"velocity": speeds}, values, variances)
    assert_allclose(variances, np.where(speeds == 0, 0.01 + 1.5**2, 0.01))
    for row, variance in zip(speeds, variances, strict=True):
        out, alone = np.empty(4), np.full(4, 0.01)
        sensor.read(names, {"velocity": row}, out, alone)
        assert_allclose(out, row)
        assert_allclose(alone, variance)


@pytest.mark.parametrize(
    ("sensor", "names", "position", "expected"),
    [
        (Steering(), ("road_wheel_front",), [0.1], 0.1),
        (Steering(ratio=16.0), ("steering_wheel",), [1.6], 0.1),
        (Steering(ratio=16.0), ("steering_wheel", "road_wheel_front"), [1.6, 0.2], 0.2),
        (Steering(ratio=16.0, gain=1.1), ("steering_wheel",), [1.6], 0.11),
        (Steering(), ("steering_wheel",), [1.6], np.nan),  # nobody knows the ratio
        (Steering(), ("road_wheel_front",), [2.0], np.nan),  # beyond the limit
        (Steering(), ("road_wheel_front",), [], np.nan),
    ],
)
def test_a_steering_message_gives_the_road_wheel_angle(sensor, names, position, expected):
    out, _ = read(sensor, names, position=position)
    assert_allclose(out, [expected])


@given(speed=st.floats(1.0, 60.0), wheel=st.integers(0, 3), reads=st.floats(-1e3, 1e3) | st.just(float("nan")))
def test_the_speed_at_start_is_that_of_three_wheels_whatever_the_fourth_reads(
    speed: float, wheel: int, reads: float
) -> None:
    physics = load_vehicle(vehicle_path("prototype_model")).physics
    spins = np.full(4, speed / physics.rear.unloaded_radius)
    spins[wheel] = reads
    assert_allclose(WheelSpeeds().first_speed(spins, physics), speed, rtol=0.03)
