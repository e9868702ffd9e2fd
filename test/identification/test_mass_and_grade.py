"""Mass and grade beside a point mass with wind, on hills, whose equations are those of this file alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import vsense_ros as vs
from vsense_ros.estimation.filter import Array
from vsense_ros.identification.mass_and_grade import MassAndGrade, mass_in
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.sensors import WheelTorques
from vsense_ros.model.vehicle import Vehicle

PERIOD = 0.1  # [s] of the sensors


def vehicle(mass: float, radius: float, drag_area: float) -> Vehicle:
    """A vehicle file with wheel torques."""
    car = vs.load_vehicle("prototype_real")
    physics = car.physics
    axle = {"unloaded_radius": radius, "tyre_stiffness": 60 * mass / radius, "dynamic_radius_factor": 1.0}
    physics = physics.model_copy(
        update={
            "chassis": physics.chassis.model_copy(update={"mass": mass}),
            "front": physics.front.model_copy(update=axle),
            "rear": physics.rear.model_copy(update=axle),
            "aerodynamics": physics.aerodynamics.model_copy(update={"drag_area": drag_area}),
        }
    )
    sensors = {**car.sensors, "torques": WheelTorques(noise=0.01 * mass)}
    return car.model_copy(update={"physics": physics, "sensors": sensors})


CARS = {"car": vehicle(1500.0, 0.32, 0.7), "truck": vehicle(12000.0, 0.5, 6.0)}


@dataclass
class Driven:
    """A drive of a point mass: what its sensors say, and the truth."""

    recording: Recording
    mass: float
    grade: float  # at the end [rad]


def drive(car: Vehicle, seed: int, *, seconds: float = 240.0, steady: bool = False, torques: bool = True) -> Driven:
    """A driver changes speed on hills and flats, in gusts; the body pitches on its springs; sensors err."""
    random = np.random.default_rng(seed)
    normal = random.normal
    nominal, axle = car.physics.chassis.mass, car.physics.rear
    mass = nominal * (1.0 if steady else random.uniform(0.8, 1.6))
    drag = 0.6 * car.physics.aerodynamics.drag_area * (1 + 0.2 * normal())
    rolling, scale, bias, pitch = 0.013 + 0.002 * normal(), 1 + 0.03 * normal(), 0.1 * normal(), 0.02 + 0.01 * normal()
    hills = [] if steady else [(0.02, 400.0, random.uniform(0, 6)), (0.015, 900.0, random.uniform(0, 6))]

    def sine(way: Array | float) -> Array | float:
        return sum(a * np.sin(2 * np.pi * way / length + phase) for a, length, phase in hills) + 0 * way

    def wanted(t: float) -> float:
        return 15.0 if steady else 15.0 + 5.0 * np.sin(0.12 * t) + 2.0 * np.sin(0.31 * t + 1)

    gusts = normal(size=int(seconds) + 3).cumsum() * 0.6

    def forces(t: float, v: float, way: float) -> tuple[float, float]:
        push = mass * (0.8 * (wanted(t) - v)) + mass * 9.81 * (0.013 + sine(way)) + drag * v**2
        air = drag * (v + (gusts[int(t)] * 0.3 if not steady else 0.0)) ** 2
        return push, push - air - mass * 9.81 * (rolling * (1 + (v / 80) ** 2) + sine(way))

    inertia = mass + 2 * (car.physics.front.wheel_spin_inertia + axle.wheel_spin_inertia) / axle.unloaded_radius**2
    t = np.arange(0.0, seconds, PERIOD)
    found = solve_ivp(
        lambda s, y: [y[1], forces(s, y[1], y[0])[1] / inertia], (0, seconds), [0.0, 15.0], t_eval=t, max_step=0.5
    )
    way, v = found.y
    push, net = np.array([forces(*one) for one in zip(t, v, way, strict=True)]).T
    along = net / inertia
    stamp = np.array(t * 1e9, dtype=np.int64) + 10**18
    flat, n = np.zeros((len(t), 3)), len(t)
    force = flat.copy()
    force[:, 0] = along * (1 + pitch) + 9.81 * np.asarray(sine(way)) + bias + 0.15 * normal(size=n)
    spin = (v / axle.unloaded_radius)[:, None] + 0.05 * normal(size=(n, 4))
    torque = np.zeros((n, 4))
    torque[:, 2:] = (push * axle.unloaded_radius / scale / 2)[:, None]
    up = v * np.asarray(sine(way)) + 0.1 * normal(size=n)
    over_ground = np.column_stack([v + 0.05 * normal(size=n), 0.05 * normal(size=n), up])
    few, covariance = slice(None, None, 2), np.zeros((n, 36))
    covariance[:, [0, 7, 14]] = 0.05**2, 0.05**2, 0.1**2
    absent = np.zeros((n, 9))
    imu = {"angular_velocity": flat, "linear_acceleration": force, "orientation": np.full((n, 4), np.nan)}
    imu |= {f"{name}_covariance": absent for name in imu}
    names, joints = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"), "sensor_msgs/msg/JointState"
    twist = {"linear": over_ground[few], "angular": flat[few], "covariance": covariance[few]}
    channels = [
        Channel("imu/data", "sensor_msgs/msg/Imu", stamp, stamp, imu, "imu_link"),
        Channel("vehicle/wheel_speeds", joints, stamp, stamp, {"velocity": spin}, "", names),
        Channel("gps/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped", stamp[few], stamp[few], twist, "map"),
    ]
    if torques:
        channels.append(Channel("vehicle/wheel_torques", joints, stamp, stamp, {"effort": torque}, "", names))
    return Driven(Recording({c.topic: c for c in channels}), mass, float(np.arcsin(sine(way[-1]))))


@pytest.mark.parametrize("name", CARS)
def test_the_mass_is_that_of_the_plant_and_its_error_as_large_as_stated(name: str) -> None:
    errors = []
    for seed in range(8):
        driven = drive(CARS[name], seed)
        found = mass_in(driven.recording, CARS[name])
        assert found is not None
        mass = found.mass()
        assert mass is not None
        assert mass[1] < 0.06 * mass[0]
        errors.append((mass[0] - driven.mass) / mass[1])
        grade, deviation = found.grade()
        assert abs(grade - driven.grade) < 4 * deviation
        assert deviation < 0.01
    assert np.mean(np.square(errors)) < 1 + 3 * np.sqrt(2 / 8)


def test_a_steady_drive_on_a_level_road_says_no_mass() -> None:
    found = mass_in(drive(CARS["car"], 3, steady=True).recording, CARS["car"])
    assert found is not None
    assert found.mass() is None
    assert found.sample().names == ("grade",)
    assert "not determined yet" in found.diagnostic().message


def test_without_torques_there_is_a_grade_and_no_mass() -> None:
    car = CARS["truck"]
    driven = drive(car, 5, torques=False)
    assert mass_in(driven.recording, car) is None
    found = MassAndGrade(car)
    for sample in driven.recording.samples():
        found.add(sample)
    assert found.mass() is None
    grade, deviation = found.grade()
    assert abs(grade - driven.grade) < 3 * deviation
