"""Tyre radii beside a rigid body whose wheels roll where they point, and on drives of cars without a fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vsense_ros as vs
from vsense_ros.bag import datasets
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array
from vsense_ros.identification.tyre_radii import TyreRadii, radii_in
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.simulation.closed_loop import rolling_radii

BAGS = Path(__file__).parents[2] / "bags"
CAR = vs.load_vehicle("prototype_real")


def drive(errors: Array, seed: int, *, gnss: bool = True, seconds: float = 60.0) -> Recording:
    """A car that weaves gently about 20 m/s on wheels of other radii than the vehicle file says, with noisy sensors, a
    bias of the gyro, and slip of the rear tyres in proportion to the acceleration."""
    random, physics = np.random.default_rng(seed), CAR.physics
    t = np.arange(0.0, seconds, 0.02)
    phase = random.uniform(0, 6, 2)
    speed, push = 20 + 4 * np.sin(0.15 * t + phase[0]), 0.6 * np.cos(0.15 * t + phase[0])
    rate = 0.03 * np.sin(0.4 * t + phase[1])
    heading = np.cumsum(rate) * 0.02
    wheelbase = physics.chassis.cog_to_front_axle + physics.chassis.cog_to_rear_axle
    spin = []
    for axle, ahead, slip in ((physics.front, wheelbase, 0.0), (physics.rear, 0.0, 0.006)):
        for side in (1, -1):
            spin.append(np.hypot(speed - rate * side * axle.track / 2, rate * ahead) * (1 + slip * push))
    spin = np.array(spin).T / (rolling_radii(CAR) * (1 + errors))
    antenna = np.add(CAR.sensors["velocity"].position, (physics.chassis.cog_to_rear_axle, 0, 0))
    body = np.column_stack([speed - rate * antenna[1], rate * antenna[0]])
    c, s = np.cos(heading), np.sin(heading)
    over_ground = np.column_stack([c * body[:, 0] - s * body[:, 1], s * body[:, 0] + c * body[:, 1], 0 * t])
    stamp = np.array(t * 1e9, dtype=np.int64) + 10**18
    names = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    noise = random.normal
    flat = np.zeros((len(t), 3))
    rates, forces = flat + [0, 0, 1] * (rate + 0.01 + noise(size=len(t)) * 0.003)[:, None], flat.copy()
    forces[:, 0], forces[:, 2] = push + noise(size=len(t)) * 0.1, 9.81
    absent = np.full((len(t), 9), 0.0)
    imu = {"angular_velocity": rates, "linear_acceleration": forces, "orientation": np.full((len(t), 4), np.nan)}
    imu |= {f"{name}_covariance": absent for name in imu}
    velocity = {"linear": over_ground + noise(size=(len(t), 3)) * 0.05, "angular": flat}
    covariance = np.zeros((len(t), 36))
    covariance[:, [0, 7, 14]] = 0.05**2
    few = slice(None, None, 5)
    channels = [
        Channel("imu/data", "sensor_msgs/msg/Imu", stamp, stamp, imu, "imu_link"),
        Channel(
            "vehicle/wheel_speeds", "sensor_msgs/msg/JointState", stamp, stamp,
            {"velocity": spin + noise(size=spin.shape) * 0.05}, "", names,
        ),
        Channel(
            "gps/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped", stamp[few], stamp[few],
            {**{k: v[few] for k, v in velocity.items()}, "covariance": covariance[few]}, "map",
        ),
    ]  # fmt: skip
    return Recording({c.topic: c for c in channels if gnss or c.topic != "gps/velocity"}, name="weaving")


def test_radii_are_those_of_the_wheels_and_their_errors_as_large_as_stated() -> None:
    squared = []
    for seed in range(12):
        true = np.random.default_rng(100 + seed).normal(size=4) * 0.004
        radii = radii_in(drive(true, seed), CAR)
        assert radii is not None
        mean, covariance = radii.belief()
        error = mean - true
        squared.append(error @ np.linalg.solve(covariance, error))
        assert np.sqrt(covariance.diagonal()).max() < 0.002
    assert np.mean(squared) < 4 + 3 * np.sqrt(2 * 4 / 12)  # χ² of four radii; resistances here are none, so less


def test_a_tyre_that_is_one_percent_smaller_is_reported_and_others_are_not() -> None:
    radii = radii_in(drive(np.array([0, 0, 0, -0.015]), 1), CAR)
    assert radii is not None
    assert set(radii.low()) == {"rr"}
    line = radii.diagnostic()
    assert line.level == Level.WARN
    assert "rr by 1." in line.message
    assert np.argmax(radii.sample().values["effort"]) == 3


def test_without_gnss_wheels_are_compared_with_one_another_alone() -> None:
    radii = radii_in(drive(np.array([-0.015, 0, 0, 0]), 2, gnss=False), CAR)
    assert radii is not None
    assert set(radii.low()) == {"fl"}
    assert np.sqrt(np.mean(radii.belief().covariance)) > 0.008  # of what all wheels have in common


def test_radii_of_right_pressures_that_are_stored_show_a_loss_that_is_smaller_than_tyres_differ(tmp_path: Path) -> None:
    new, path = np.array([0.003, -0.002, 0.001, 0.0]), tmp_path / "radii.json"
    first = TyreRadii(CAR, path)
    for sample in drive(new, 3, seconds=120).samples():
        first.add(sample)
    first.save()
    later = TyreRadii(CAR, path)
    for sample in drive(new - [0.005, 0, 0, 0], 4, seconds=120).samples():
        later.add(sample)
    assert not first.low()
    assert set(later.low()) == {"fl"}
    with pytest.raises(InputError, match="with another vehicle file"):
        TyreRadii(vs.load_vehicle("rav4"), path)
    path.write_text("{}")
    with pytest.raises(InputError, match="expected radii"):
        TyreRadii(CAR, path)


@pytest.mark.parametrize("name", ["double_lane_change", "hills", "banked_oval"])
def test_drives_on_tyres_that_are_alike_raise_no_warning(name: str) -> None:
    radii = radii_in(vs.read(BAGS / name), CAR)
    assert radii is not None
    assert radii.used > 3
    assert not radii.low()
    assert np.all(np.abs(radii.belief().mean) < 3 * np.sqrt(radii.belief().covariance.diagonal()))


def test_a_car_without_wheel_speeds_has_no_tyre_radii() -> None:
    assert radii_in(vs.read(BAGS / "hills"), vs.load_vehicle("genesis")) is None
    with pytest.raises(InputError, match="wheel speeds, which no sensor"):
        TyreRadii(vs.load_vehicle("genesis"))


def test_a_real_car_on_a_motorway_has_tyres_that_are_alike() -> None:
    folder = datasets.find("comma2k19_rav4")
    if folder is None:
        pytest.skip("the drive of the RAV4 is not here")
    radii = radii_in(vs.read(folder), vs.load_vehicle("rav4"))
    assert radii is not None
    mean = radii.belief().mean
    assert not radii.low()
    assert np.abs(mean[[0, 2]] - mean[[1, 3]]).max() < 0.001
