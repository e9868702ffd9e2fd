"""The filter of a trailer behind a car that MuJoCo moves, with a body that rolls, tyres of another form, and loads and
sensors that are not those of the vehicle file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import vsense_ros as vs
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array
from vsense_ros.identification.combination import SingleTrack
from vsense_ros.identification.towing import OUTPUTS, Towing, towing_in
from vsense_ros.manoeuvre.driver import cornering_stiffness
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording, Sample
from vsense_ros.model.sensors import Articulation, Imu, Steering, WheelSpeeds
from vsense_ros.model.trailer import Trailer
from vsense_ros.model.vehicle import Vehicle

mujoco = pytest.importorskip("mujoco", reason="MuJoCo moves the plant: make venv installs it")

STEP, EVERY, GRAVITY = 0.004, 3, 9.81
HINGE, TRAILER_YAW, ROLL = 2, 4, 3  # places in MuJoCo's coordinates: x, y, ψ, roll of the body, γ


def vehicle(*, angle: bool, mass: float = 1400.0) -> Vehicle:
    car = vs.load_vehicle("rav4")
    sensors = {"imu": Imu(), "steering": Steering(ratio=16.0), "wheels": WheelSpeeds()}
    sensors |= {"hitch": Articulation()} if angle else {}
    physics = car.physics.model_copy(update={"trailer": Trailer(mass=mass)})
    return car.model_copy(update={"physics": physics, "sensors": sensors})


@dataclass
class Plant:
    """A car with a trailer, not as its file says; tyres after Pacejka's formula, of which the file knows nothing. The
    ball of the hitch, of 25 mm radius under 700 N, has a dry friction of 3 N m; the wind pushes aside with 150 and
    200 N (RMS), as gusts of 2 m/s do at 25 m/s."""

    random: np.random.Generator
    mass: float = 1400.0

    def __post_init__(self) -> None:
        car = vehicle(angle=False).physics
        share = lambda size: float(np.exp(size * self.random.normal()))  # noqa: E731
        chassis, file = car.chassis, Trailer(mass=self.mass)
        m = self.mass * share(0.1)
        self.arms = np.array([chassis.cog_to_front_axle, -chassis.cog_to_rear_axle])
        length, nose = file.length, m * (0.05 + 0.015 * self.random.normal())
        self.behind, e = chassis.cog_to_rear_axle + file.overhang, length * (1 - nose / m)
        loads = chassis.mass * GRAVITY * self.arms[::-1] * [-1, 1] / np.ptp(self.arms)
        stiff = [cornering_stiffness(axle, load / 2) for axle, load in zip((car.front, car.rear), loads, strict=True)]
        self.loads = np.array([*loads, (m - nose) * GRAVITY])
        self.stiff = np.array([c * share(0.1) for c in stiff] + [file.cornering_stiffness * share(0.2)])
        self.relaxation = np.array([0.5, 0.5, 0.6])
        self.drag, self.trailer_mass, self.length = 0.6 * file.drag_area, m, length
        inertia, sprung = file.yaw_inertia * share(0.15), 0.85 * chassis.mass
        self.model = mujoco.MjModel.from_xml_string(f"""
          <mujoco><option timestep="{STEP}" gravity="0 0 -{GRAVITY}" integrator="implicitfast"/><worldbody>
          <body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint axis="0 0 1"/>
            <inertial pos="0 0 0.3" mass="{chassis.mass - sprung}" diaginertia="100 500 {0.2 * chassis.yaw_inertia}"/>
            <body pos="0 0 0.15"><joint axis="1 0 0" stiffness="95000" damping="6000"/>
              <inertial pos="0 0 0.45" mass="{sprung}" diaginertia="500 2000 {0.8 * chassis.yaw_inertia}"/></body>
            <body pos="{-self.behind} 0 0"><joint axis="0 0 1" frictionloss="3"/>
              <inertial pos="{-e} 0 0.5" mass="{m}" diaginertia="{0.3 * inertia} {inertia} {inertia}"/></body>
          </body></worldbody></mujoco>""")

    def drive(
        self, seconds: float, speed: float, steer: Callable[[float], float], gusts: float = 1.0
    ) -> dict[str, Array]:
        """Courses at every `EVERY`th step; `steer(t)` is the road-wheel angle [rad]."""
        data, slips, wind = mujoco.MjData(self.model), np.zeros(3), np.zeros(2)
        data.qvel[0], rows = speed, []
        mujoco.mj_forward(self.model, data)
        last = data.xipos[3].copy(), np.array([speed, 0.0, 0.0])
        before = data.qvel.copy()
        for i in range(round(seconds / STEP)):
            t, psi, theta = i * STEP, data.qpos[HINGE], data.qpos[HINGE] + data.qpos[TRAILER_YAW]
            ahead, sideways = np.array([np.cos(psi), np.sin(psi), 0]), np.array([-np.sin(psi), np.cos(psi), 0])
            back, beside = np.array([np.cos(theta), np.sin(theta), 0]), np.array([-np.sin(theta), np.cos(theta), 0])
            place, velocity = np.array([*data.qpos[:2], 0]), np.array([*data.qvel[:2], 0])
            along, rate, spin = velocity @ ahead, data.qvel[HINGE], data.qvel[HINGE] + data.qvel[TRAILER_YAW]
            hitch = velocity @ sideways - self.behind * rate
            on_axle = hitch * np.cos(theta - psi) - along * np.sin(theta - psi) - self.length * spin
            delta = steer(t)
            aside = np.array([*(velocity @ sideways + self.arms * rate), on_axle])
            alpha = np.array([delta, 0, 0]) - np.arctan2(aside, along)
            slips += (1 - np.exp(-STEP * along / self.relaxation)) * (alpha - slips)
            top = 0.95 * self.loads
            force = top * np.sin(1.3 * np.arctan(self.stiff / (1.3 * top) * slips))
            wind += STEP * (-wind / 2.0) + gusts * np.sqrt(STEP) * self.random.normal(size=2) * [150.0, 200.0]
            resistance = self.drag * along**2 + 0.012 * self.loads[2]
            push = resistance + (speed - along) * 3000.0
            data.xfrc_applied[:] = 0
            points = [place + arm * ahead for arm in self.arms]
            for at, vector in zip(points, force[0] * (np.cos(delta) * sideways - np.sin(delta) * ahead) * [[1], [0]]
                                  + force[1] * sideways * [[0], [1]], strict=True):  # fmt: skip
                self._push(data, 1, at, vector)
            self._push(data, 1, place, push * ahead + wind[0] * sideways)
            axle = place - self.behind * ahead - self.length * back
            on_trailer = force[2] * beside - resistance * back
            self._push(data, 3, axle, on_trailer)
            self._push(data, 3, data.xipos[3], wind[1] * beside)
            mujoco.mj_step(self.model, data)
            mujoco.mj_kinematics(self.model, data)  # which places bodies where they are after the step
            moved = (data.xipos[3] - last[0]) / STEP
            if i % EVERY == 0:
                pull = self.trailer_mass * (moved - last[1]) / STEP - on_trailer - wind[1] * beside
                change = (data.qvel - before) / STEP
                roll, specific = data.qpos[ROLL], np.array([*change[:2], 0])
                lateral = specific @ sideways - 0.45 * change[ROLL]
                read = lateral * np.cos(roll) + GRAVITY * np.sin(roll)
                rows.append([t, delta, along, rate, specific @ ahead, read, theta - psi, spin - rate,
                             -pull @ ahead, -pull @ sideways])  # fmt: skip
            last, before = (data.xipos[3].copy(), moved), data.qvel.copy()
        names = ("t", "delta", "speed", "rate", "along", "aside", *OUTPUTS[:4])
        return dict(zip(names, np.array(rows).T, strict=True))

    def _push(self, data: Any, body: int, at: Array, force: Array) -> None:
        data.xfrc_applied[body, :3] += force
        data.xfrc_applied[body, 5] += np.cross(at - data.xipos[body], force)[2]

    def damping(self, speed: float) -> float:
        """Damping ratio by the decay after one small turn of the steering wheel, without wind."""
        self.model.dof_frictionloss[:] = 0
        course = self.drive(7.0, speed, lambda t: 0.005 * np.sin(2 * np.pi * t / 0.6) * (t < 0.6), gusts=0.0)
        angle = course["articulation"][round(1.5 / STEP / EVERY) :]
        turns = np.flatnonzero(np.diff(np.sign(np.diff(angle)))) + 1
        peaks = np.abs(np.diff(angle[turns]))[:3]  # from one extreme to the next: without what drifts
        decrement = -np.polyfit(np.arange(3), np.log(peaks), 1)[0]
        return float(decrement / np.hypot(decrement, np.pi))


def recording(course: dict[str, Array], random: np.random.Generator, *, angle: bool) -> Recording:
    """What sensors say of a drive."""
    n, normal, joints = len(course["t"]), random.normal, "sensor_msgs/msg/JointState"
    stamp = np.array(course["t"] * 1e9, dtype=np.int64) + 10**18
    rates, forces = np.zeros((n, 3)), np.zeros((n, 3))
    rates[:, 2] = course["rate"] + 0.005 * normal() + 0.003 * normal(size=n)
    forces[:, 0] = course["along"] + 0.1 * normal() + 0.1 * normal(size=n)
    forces[:, 1] = course["aside"] + 0.15 * normal() + 0.1 * normal(size=n)
    imu = {"angular_velocity": rates, "linear_acceleration": forces, "orientation": np.full((n, 4), np.nan)}
    imu |= {f"{name}_covariance": np.zeros((n, 9)) for name in imu}
    steering = (course["delta"] + 0.005 * normal() + 0.0005 * normal(size=n))[:, None]
    towing = Towing(vehicle(angle=False))
    spin = course["speed"][:, None] / towing._radii * (1 + 0.002 * normal(size=(n, 4)))
    wheels = tuple(f"wheel_{w}" for w in ("fl", "fr", "rl", "rr"))
    channels = [
        Channel("imu/data", "sensor_msgs/msg/Imu", stamp, stamp, imu, "imu_link"),
        Channel("vehicle/steering", joints, stamp, stamp, {"position": steering}, "", ("road_wheel_front",)),
        Channel("vehicle/wheel_speeds", joints, stamp, stamp, {"velocity": spin}, "", wheels),
    ]
    if angle:
        measured = (course["articulation"] + 0.007 * normal() + 0.003 * normal(size=n))[:, None]
        channels.append(Channel("vehicle/articulation", joints, stamp, stamp, {"position": measured}, "", ("hitch",)))
    return Recording({c.topic: c for c in channels})


def hands(random: np.random.Generator) -> Callable[[float], float]:
    """Gentle corrections, and now and then a lane change."""
    phases, lanes = random.uniform(0, 6, size=3), np.cumsum(random.uniform(6, 12, size=9))
    sizes = random.uniform(0.008, 0.02, size=9) * random.choice([-1, 1], size=9)

    def steer(t: float) -> float:
        small = sum(0.0012 * np.sin(w * t + p) for w, p in zip((0.5, 1.3, 2.9), phases, strict=True))
        lane = sum(a * np.sin(2 * np.pi * (t - b) / 2) for a, b in zip(sizes, lanes, strict=True) if 0 < t - b < 2)
        return small + lane

    return steer


@dataclass(frozen=True)
class Driven:
    course: dict[str, Array]
    damping: float  # of the plant at its last speed
    seed: int

    def followed(self, *, angle: bool) -> tuple[Towing, list[Sample]]:
        towing = Towing(vehicle(angle=angle))
        return towing, towing.take(recording(self.course, np.random.default_rng(self.seed), angle=angle))


@cache
def driven(seed: int, seconds: float = 30.0) -> Driven:
    random = np.random.default_rng(seed)
    plant, speed = Plant(random), random.uniform(19, 27)
    course = plant.drive(seconds, speed, hands(random))
    return Driven(course, plant.damping(course["speed"][-1]), seed)


def errors(samples: list[Sample], course: dict[str, Array], name: str, begin: float = 8.0) -> Array:
    """Errors over their standard deviations after a time [s], (n,)."""
    later = [one for one in samples if one.stamp > 10**18 + begin * 1e9]
    t = np.array([(one.stamp - 10**18) * 1e-9 for one in later])
    place = OUTPUTS.index(name)
    value, deviation = (np.array([one.values[k][place] for one in later]) for k in ("position", "velocity"))
    return (value - np.interp(t, course["t"], course[name])) / deviation


class Mean:
    """Random numbers that are all zero: a plant as the file has it."""

    def normal(self, size: int | None = None) -> Array | float:
        return 0.0 if size is None else np.zeros(size)


def test_the_single_track_moves_as_a_tree_of_bodies_with_a_hinge_in_mujoco() -> None:
    plant, single_track = Plant(Mean()), SingleTrack.of(vehicle(angle=False))  # type: ignore[arg-type]
    plant.relaxation = np.array([0.01, 0.01, 0.4])
    course = plant.drive(6.0, 24.0, lambda t: 0.01 * np.sin(np.pi * (t - 1)) * (1 < t < 3), gusts=0.0)
    x, u = ca.SX.sym("x", 5), ca.SX.sym("u", 3)
    rates = ca.Function("rates", [x, u], [single_track.rates(Trailer(mass=1400), x, u[0], u[1], u[2])])
    now, h, moved = np.zeros(5), STEP * EVERY / 4, []
    for given in np.column_stack([course[name] for name in ("delta", "speed", "along")]):
        moved.append(now)
        for _ in range(4):
            middle = now + h / 2 * np.array(rates(now, given))[:, 0]
            now = now + h * np.array(rates(middle, given))[:, 0]
    for name, place in (("rate", 1), ("articulation", 2)):
        # Steering is held for a step here: by half a step late.
        found = np.interp(course["t"] + STEP * EVERY / 2, course["t"], np.array(moved)[:, place])
        assert np.abs(found - course[name]).max() < 0.04 * np.abs(course[name]).max()


def test_articulation_pull_and_damping_are_those_of_the_plant_within_what_is_stated() -> None:
    drive = driven(1, 25.0)
    for angle in (False, True):
        towing, samples = drive.followed(angle=angle)
        assert len(samples) == pytest.approx(25 / 0.05, rel=0.25)
        for name in ("articulation", "articulation_rate", "hitch_force_x", "hitch_force_y"):
            assert np.mean(np.abs(errors(samples, drive.course, name)) < 3) > 0.97, name
        assert towing.damping is not None
        assert abs(towing.damping[0] - drive.damping) < 3 * towing.damping[1]
        assert towing.damping[1] < 0.05
        assert towing.diagnostic().level == (Level.WARN if towing.damping[0] < 0.1 else Level.OK)


@pytest.mark.exam
def test_standard_deviations_are_as_large_as_errors_in_many_drives() -> None:
    for angle in (False, True):
        runs = [(drive, *drive.followed(angle=angle)) for drive in map(driven, range(5))]
        print(f"articulation {'measured' if angle else 'not measured'}: share within 2 σ, NEES")
        for name in OUTPUTS[:4]:
            every = np.concatenate([errors(samples, drive.course, name) for drive, _, samples in runs])
            within, nees = np.mean(np.abs(every) < 2), np.mean(every**2)
            print(f"  {name:18s} {within:.3f} {nees:.2f}")
            assert within > 0.9, name
            assert nees < 1.5, name
        ratios = np.array([(*(towing.damping or (np.nan, np.nan)), drive.damping) for drive, towing, _ in runs])
        off = (ratios[:, 0] - ratios[:, 2]) / ratios[:, 1]
        print(f"  damping ratio      {np.mean(np.abs(off) < 2):.3f} {np.mean(off**2):.2f}")
        assert np.mean(off**2) < 1 + 3 * np.sqrt(2 / len(off))


def straight(speed: float) -> dict[str, Array]:
    """Three seconds straight ahead."""
    t = np.arange(0, 3, 0.01)
    return {"t": t, "speed": np.full(len(t), speed), **dict.fromkeys(("delta", "rate", "along", "aside"), 0 * t)}


def test_a_trailer_that_is_loaded_behind_its_axle_is_warned_of_and_a_slow_one_is_not_judged() -> None:
    car, random = vehicle(angle=False), np.random.default_rng(1)
    lifting = Trailer(mass=1400, nose_load=-60)
    car = car.model_copy(update={"physics": car.physics.model_copy(update={"trailer": lifting})})
    towing = towing_in(recording(straight(27.0), random, angle=False), car)
    assert towing is not None
    line = towing.diagnostic()
    assert line.level == Level.WARN
    assert "drive slower" in line.message
    assert {"damping_ratio", "critical_speed"} < set(towing.sample().names)
    slow = towing_in(recording(straight(3.0), random, angle=False), car)
    assert slow is not None
    assert "not known below" in slow.diagnostic().message


def test_a_car_without_a_trailer_or_what_its_filter_needs_is_a_sentence() -> None:
    car = vehicle(angle=False)
    alone = car.model_copy(update={"physics": car.physics.model_copy(update={"trailer": None})})
    with pytest.raises(InputError, match="tows no trailer"):
        Towing(alone)
    with pytest.raises(InputError, match="needs steering"):
        Towing(car.model_copy(update={"sensors": {k: v for k, v in car.sensors.items() if k != "steering"}}))
    assert towing_in(recording(straight(20.0), np.random.default_rng(1), angle=False), alone) is None
