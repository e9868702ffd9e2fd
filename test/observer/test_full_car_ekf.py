"""The errorEKF on the car with all its bodies."""

from __future__ import annotations

import numpy as np
import pytest

from drives import feed, follow, messages
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording
from vsense_ros.model.effects import Effects
from vsense_ros.model.effects.tyre_relaxation import TyreRelaxation
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.runner import Runner

pytestmark = pytest.mark.exam


def on_known_tyres(vehicle: Vehicle) -> Vehicle:
    around = vehicle.observer.surroundings.model_copy(update={"radius_error": 0.0, "radius_error_drift": 0.0})
    return vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update={"surroundings": around})})


def full(vehicle: Vehicle) -> CarFilter:
    """The errorEKF on the full car."""
    return FILTERS["full_error_ekf"].make(vehicle, sensors_of(vehicle))


@pytest.fixture(scope="module")
def known(vehicle: Vehicle) -> Vehicle:
    return on_known_tyres(vehicle)


def test_a_car_at_rest_stays_where_it_is(known: Vehicle) -> None:
    f = full(known)
    f.start_rolling(0.0)
    for _ in range(200):
        f.linearize()
        f.predict(0.01)
    assert np.abs(f.car.mean[:10] - [0, 0, known.physics.chassis.cog_height, *[0.0] * 7]).max() < 1e-3
    assert np.abs(f.car.mean[14:28]).max() < 1e-3


@pytest.mark.parametrize("element", ["x_force", "y_force", "z_force", "yaw_force", "travel_rl_force", "spin_fr_force"])
def test_a_missing_force_moves_it_about_as_it_moves_the_simplified_car(known: Vehicle, element: str) -> None:
    """So the Jacobians of the one may stand for those of the other."""
    moved = []
    for name in ("error_ekf", "full_error_ekf"):
        f, ends = FILTERS[name].make(known, sensors_of(known)), []
        index = f.names.index(element)
        for force in (0.0, 100.0):
            f.start_rolling(15.0)
            for _ in range(2):
                f.car.mean[index] = force
                f.linearize()
                f.predict(0.004)
            ends.append(f.car.mean[14:28].copy())
        moved.append(ends[1] - ends[0])
    simplified, full = moved
    largest = np.abs(simplified[:3]).max(), np.abs(simplified[3:6]).max(), np.abs(simplified[6:]).max()
    unit = np.repeat(np.maximum(largest, 0.1 * max(largest)), [3, 3, 8])
    assert np.abs((full - simplified) / unit).max() < 0.15


def test_it_follows_a_drive_and_goes_back_for_what_comes_late(known: Vehicle, lane_change: Recording) -> None:
    """GNSS in the recording is 0.1 s late."""
    samples = messages(lane_change, until=4.0)
    observer = Runner(known, lane_change.map_origin, FILTERS["full_error_ekf"].make)
    speed, lateral, yaw_rate = follow(observer, samples, lane_change).largest()
    assert speed < 0.15
    assert lateral < 0.15
    assert yaw_rate < 0.03
    assert observer.diagnostics()[0].values["faults"] == "0"
    assert sum(health.late for health in observer.health) > 50


def test_memory_is_all_of_it(known: Vehicle, lane_change: Recording) -> None:
    observer = feed(
        Runner(known, lane_change.map_origin, FILTERS["full_error_ekf"].make), messages(lane_change, until=1.0)
    )
    f, ends = observer.filter, []
    kept = f.memory.copy()
    for _ in range(2):
        f.memory[:] = kept
        for _ in range(5):
            f.predict(0.004)
        ends.append(f.memory.copy())
        f.car.present()
    assert np.array_equal(*ends)


def test_wheels_may_be_steered_by_degrees_from_one_message_to_the_next(known: Vehicle) -> None:
    f = full(known)
    f.start_rolling(8.0)
    for angle in (0.08, -0.08, 0.08):
        f.inputs[0] = angle
        for _ in range(20):
            f.linearize()
            f.predict(0.01)
        assert f.car.mean[19] == pytest.approx(8.0 * angle / 2.2, rel=0.2)


def test_noise_of_the_steering_sensor_does_not_shake_the_car(known: Vehicle) -> None:
    """Accelerations at the ends of steps, with which the IMU is compared, are those that velocities change by."""
    f, random = full(known), np.random.default_rng(0)
    f.start_rolling(3.0)
    f.linearize()
    felt, velocities = [], []
    for _ in range(500):
        f.inputs[0] = random.normal(scale=1.2e-3)
        f.predict(0.004)
        felt.append(f.car.udot[:10, 0].copy())
        velocities.append(f.car.mean[14:24].copy())
    mean, change = np.mean(felt[250:], axis=0), (velocities[499] - velocities[249]) / (250 * 0.004)
    assert np.abs(mean - change).max() < 1e-3


def test_effects_that_the_full_car_lacks_are_refused(known: Vehicle) -> None:
    effects = Effects(tyre_relaxation=TyreRelaxation(front=0.4, rear=0.4))
    lagging = known.model_copy(update={"physics": known.physics.model_copy(update={"effects": effects})})
    with pytest.raises(InputError, match=r"no physics\.effects"):
        full(lagging)
