"""Direct witnesses: who is wrong where sensors contradict each other, without a filter."""

from __future__ import annotations

from functools import cache
from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.estimation.timeline import Event
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.driver import understeer_gradient, wheelbase
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.velocity_witnesses import VelocityWitnesses
from vsense_ros.runner.yaw_witnesses import WITNESSES, YawWitnesses

SECOND = 1_000_000_000
START = 10 * SECOND


@cache
def car() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_model"))


def steady_yaw_rate(angle: float, speed: float) -> float:
    """Return the yaw rate of the linear single-track model in a steady turn (Mitschke 1990)."""
    return speed * angle / (wheelbase(car()) + understeer_gradient(car()) * speed**2)


def bend(angle: float, speed: float, seconds: float, wrong: dict[str, float], since: float = 2.0) -> YawWitnesses:
    """The witnesses after a steady turn in which what is `wrong` adds to gyro, lateral acceleration, the yaw rate of
    the wheels or the steering angle after some time."""
    witnesses, sensors = YawWitnesses(car(), car().sensing()), list(car().sensing())
    steering, wheels = sensors.index("steering"), sensors.index("wheel_speeds")
    numbers, rate = car_numbers(car()), steady_yaw_rate(angle, speed)
    for i in range(round(seconds / 0.01)):
        stamp, now = START + i * SECOND // 100, wrong if i * 0.01 >= since else {}
        turn = (rate + now.get("wheels", 0.0)) * numbers["rear_half_track"]
        spins = (np.array([0.0, 0.0, -turn, turn]) + speed) / numbers["rear_radius"]
        felt = [0, 0, rate + now.get("gyro", 0.0), 0, rate * speed + now.get("acceleration", 0.0), 9.81]
        for index, value in ((steering, np.array([angle + now.get("steering", 0.0)])), (wheels, spins)):
            witnesses.hear(Event(index, stamp, value, np.zeros(len(value))))
        witnesses.feel(stamp, 0.01, felt, speed, 0.0)
        if witnesses.wrong:
            break
    return witnesses


@settings(max_examples=15, deadline=None)
@given(st.floats(5.0, 35.0), st.floats(-3.5, 3.5))
def test_in_a_steady_turn_nobody_contradicts_the_steering(speed: float, acceleration: float) -> None:
    angle = acceleration * (wheelbase(car()) / speed**2 + understeer_gradient(car()))
    witnesses = bend(angle, speed, 2.0, {})
    assert not witnesses.since
    assert witnesses.agreed > 1.0


@settings(max_examples=10, deadline=None)
@given(st.floats(8.0, 30.0), st.sampled_from([-1.0, 1.0]))
def test_a_steering_angle_that_jumps_is_wrong_within_four_tenths_of_a_second(speed: float, side: float) -> None:
    assert bend(0.0, speed, 2.4, {"steering": side * 1.05 / 16}).wrong


@pytest.mark.parametrize("sensor", ["gyro", "acceleration", "wheels"])
def test_a_single_other_witness_that_jumps_does_not_make_the_steering_wrong(sensor: str) -> None:
    size = {"gyro": 0.5, "acceleration": 8.0, "wheels": 0.5}[sensor]
    assert not bend(0.02, 15.0, 4.0, {sensor: size}).wrong


def test_inertial_sensors_that_are_wrong_together_do_not_outvote_the_steering() -> None:
    assert not bend(0.02, 15.0, 4.0, {"gyro": 0.4, "acceleration": 6.0}).wrong


def test_a_car_that_slides_does_not_contradict_its_steering() -> None:
    """The tyres follow half of what the linear model makes of an angle, at 6 m/s²."""
    speed = 20.0
    half = 6.0 / speed
    angle = 2 * half * (wheelbase(car()) / speed + understeer_gradient(car()) * speed)
    assert steady_yaw_rate(angle, speed) == pytest.approx(2 * half)
    assert not bend(angle, speed, 4.0, {"gyro": -half, "acceleration": -half * speed, "wheels": -half}, since=0).wrong


def test_below_walking_pace_nothing_is_judged() -> None:
    assert not bend(0.0, 0.5 * WITNESSES.slowest, 4.0, {"steering": 0.5}).since


def travelled(wrong: str, seconds: float, error: float, drift: float = 0.0) -> VelocityWitnesses:
    """The witnesses after a drive at 15 m/s to the north-east, in which one sensor has an error of its speed [m/s] that
    may grow [m/s²], from the second second on."""
    witnesses, sensors = VelocityWitnesses(car(), car().sensing()), list(car().sensing())
    radius, heading, speed = car_numbers(car())["rear_radius"], np.pi / 4, 15.0
    way = 0.0
    for i in range(round(seconds * 50)):
        stamp, since = START + i * SECOND // 50, max(i / 50 - 2.0, 0.0)
        more = (error if since else 0.0) + drift * since
        speeds = {name: speed + more * (name == wrong) for name in ("wheel_speeds", "velocity", "position")}
        way += speeds["position"] / 50
        direction = np.array([cos(heading), sin(heading)])
        values = {
            "wheel_speeds": np.full(4, speeds["wheel_speeds"] / radius),
            **({"velocity": speeds["velocity"] * direction, "position": way * direction} if i % 5 == 0 else {}),
        }
        for name, value in values.items():
            index = sensors.index(name)
            witnesses.hear(Event(index, stamp, value, np.full(len(value), 0.01)), lambda: heading)
        if witnesses.wrong is not None:
            break
    return witnesses


SENSORS = ("wheel_speeds", "velocity", "position")


def test_where_all_agree_nobody_is_wrong() -> None:
    witnesses = travelled("", 20.0, 0.0)
    assert witnesses.wrong is None
    assert not witnesses.since


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize(("error", "drift"), [(3.0, 0.0), (-3.0, 0.0), (0.0, 0.5), (0.0, -0.5)])
def test_the_one_of_three_that_contradicts_both_others_is_wrong(sensor: str, error: float, drift: float) -> None:
    witnesses = travelled(sensor, 9.0, error, drift)
    assert witnesses.wrong == list(car().sensing()).index(sensor)


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_radius_that_is_off_by_a_hundredth_is_no_contradiction(sensor: str) -> None:
    assert not travelled(sensor, 20.0, 0.15).since


def gained(wrong: str, error: float = 0.0, slope: float = 0.1) -> str:
    """The sensor that is found to be wrong on a car without wheel speeds that goes ahead at 15 m/s, and gains 0.6 m/s²
    from 12 s on: the velocity may be stuck from 13 s on, the position gains an error [m/s], and the slope of the road
    is felt [m/s²]."""
    vehicle = load_vehicle(vehicle_path("genesis"))
    sensors = vehicle.sensing()
    witnesses, names = VelocityWitnesses(vehicle, sensors), list(sensors)
    for i in range(50 * 20):
        now, stamp = i / 50, START + i * SECOND // 50
        since = [max(now - at, 0.0) for at in (12.0, 13.0)]
        speed, way = 15.0 + 0.6 * since[0], 15.0 * now + 0.3 * since[0] ** 2
        witnesses.feel(stamp, [0.0, 0.0, 0.0, 0.6 * (now >= 12.0) + slope, 0.0, 9.81], 0.0)
        values = {"velocity": min(speed, 15.6) if wrong == "velocity" else speed,
                  "position": way + error * since[1]}  # fmt: skip
        for name, value in values.items() if i % 5 == 0 else ():
            event = Event(names.index(name), stamp, np.array([value, 0.0]), np.full(2, 0.01))
            witnesses.hear(event, lambda: 0.0)
        if witnesses.wrong is not None:
            return names[witnesses.wrong]
    return ""


def test_without_wheels_a_velocity_that_is_stuck_is_found_by_what_is_felt() -> None:
    assert gained("velocity") == "velocity"


@pytest.mark.parametrize("error", [0.0, 2.0, -5.0])
def test_without_wheels_no_velocity_is_wrong_because_a_position_is(error: float) -> None:
    assert not gained("position", error)


def circled(radius: float, speed: float, stamps: float = 0.0) -> VelocityWitnesses:
    """The witnesses after 8 s in a circle to the left, of which the middle of the rear axle has a radius [m] and a
    speed [m/s], with an antenna in a corner of the roof; positions have stamps that are late [s]."""
    vehicle, (ahead, left) = car(), (-0.8, 0.5)
    sensors = vehicle.sensing()
    for name in ("velocity", "position"):
        sensors[name] = sensors[name].model_copy(update={"position": (ahead, left, 1.2)})
    numbers, names = car_numbers(vehicle), list(sensors)
    from_axle = np.array([ahead + numbers["to_rear"], left])
    base, rate = numbers["to_front"] + numbers["to_rear"], speed / radius
    wheels = [(x, side * numbers[f"{axle}_half_track"]) for axle, x in (("front", base), ("rear", 0.0))
              for side in (1, -1)]  # fmt: skip
    spins = [np.hypot(speed - rate * y, rate * x) / numbers["rear_radius"] for x, y in wheels]
    witnesses = VelocityWitnesses(vehicle.model_copy(update={"sensors": sensors}), sensors)
    for i in range(400):
        now = i / 50

        def at(time: float) -> tuple[float, np.ndarray, np.ndarray]:
            heading = rate * time
            turn = np.array([[cos(heading), -sin(heading)], [sin(heading), cos(heading)]])
            axle = radius * np.array([sin(heading), 1 - cos(heading)])
            velocity = np.array([speed - rate * from_axle[1], rate * from_axle[0]])
            return heading, axle + turn @ from_axle, turn @ velocity

        heading, _, velocity = at(now)
        values = {"wheel_speeds": np.array(spins)}
        if i % 5 == 0:
            values |= {"velocity": velocity, "position": at(now - stamps)[1]}
        witnesses.feel(START + i * SECOND // 50, [0.0, 0.0, rate, 0.0, speed * rate, 9.81])
        for name, value in values.items():
            event = Event(names.index(name), START + i * SECOND // 50, value, np.full(len(value), 0.01))
            witnesses.hear(event, lambda heading=heading: heading)  # type: ignore[misc]
    return witnesses


@pytest.mark.parametrize("radius", [5.0, 8.0, 30.0])
def test_in_a_tight_circle_wheels_and_an_antenna_beside_the_middle_do_not_contradict_each_other(radius: float) -> None:
    assert not circled(radius, 4.0).since


def test_positions_whose_stamps_are_a_little_late_contradict_nobody() -> None:
    assert not circled(60.0, 22.0, stamps=0.16).since


@pytest.mark.parametrize("rate", [10, 500])
def test_courses_decide_against_a_drifting_steering_angle_at_any_rate(rate: int) -> None:
    """Wheels are silent, and the angle does not jump: the course alone stands beside the gyro and its accelerometer."""
    witnesses, sensors = YawWitnesses(car(), car().sensing()), list(car().sensing())
    steering, velocity = sensors.index("steering"), sensors.index("velocity")
    speed, angle = 15.0, 0.02
    turn = steady_yaw_rate(angle, speed)
    for i in range(3 * rate * 10):  # in tenths of the interval of courses
        seconds = i / (10 * rate)
        stamp, drift = START + round(seconds * SECOND), 0.05 * max(seconds - 1.5, 0.0)
        witnesses.hear(Event(steering, stamp, np.array([angle + drift]), np.zeros(1)))
        if i % 10 == 0:
            course = speed * np.array([cos(turn * seconds), sin(turn * seconds)])
            witnesses.hear(Event(velocity, stamp, course, np.full(2, 1e-4)))
        witnesses.feel(stamp, 1 / (10 * rate), [0, 0, turn, 0, turn * speed, 9.81], speed, 0.0)
    assert witnesses.wrong


def confirmed_after(seconds: float, gyro_error: float, turn: float) -> bool:
    """True if courses confirm a gyro with an error [rad/s] since 0.6 s before the end, in a turn [rad/s]."""
    witnesses, velocity = YawWitnesses(car(), car().sensing()), list(car().sensing()).index("velocity")
    steering = list(car().sensing()).index("steering")
    speed, rate = 10.0, 100
    for i in range(round(seconds * rate)):
        now = i / rate
        stamp, gyro = START + round(now * SECOND), turn + gyro_error * (now > seconds - 0.6)
        witnesses.hear(Event(steering, stamp, np.zeros(1), np.zeros(1)))
        course = speed * np.array([cos(turn * now), sin(turn * now)])
        witnesses.hear(Event(velocity, stamp, course, np.full(2, 1e-4)))
        witnesses.feel(stamp, 1 / rate, [0, 0, gyro, 0, turn * speed, 9.81], speed, 0.0)
    return bool(witnesses.gyro_confirmed)


@given(st.floats(0.4, 1.2), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=10, deadline=None)
def test_courses_confirm_a_right_gyro_in_a_tight_turn_and_no_wrong_one(turn: float, side: float) -> None:
    assert confirmed_after(2.0, 0.0, side * turn)
    assert not confirmed_after(2.0, 0.5, side * turn)


def test_courses_confirm_no_gyro_straight_ahead_where_a_dead_one_reads_the_same() -> None:
    assert not confirmed_after(2.0, 0.0, 0.0)
