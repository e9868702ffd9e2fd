"""The filters of this room by name: what each estimates, and when to take which."""

from __future__ import annotations

from functools import partial

from vsense_ros.estimation.catalogue import Catalogue, FilterFamily
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation import (
    attitude_ekf,
    dual_kkf,
    heading_bank,
    inertial,
    integrated,
    integrated_kf,
    joint_kkf,
    mekf,
    model_observers,
    open_loop,
    parameter_ekf,
    side_slip_kkf,
    strapdown,
    triple_kkf,
    wheel_speed_ekf,
    wheel_speed_observer,
    yaw_kkf,
)
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.space import Definition

DEFINITIONS: dict[str, tuple[str, Definition, str]] = {
    "yaw_kkf": ("heading by gyro and course", yaw_kkf.YAW_KKF, "as the simplest: heading alone"),
    "yaw_kkf_heading": (
        "the same with two antennas",
        yaw_kkf.YAW_KKF_WITH_HEADING,
        "where two antennas tell the heading",
    ),
    "dual_kkf": ("dual kinematic KF", dual_kkf.DUAL_KKF, "to repeat Bevly 2001 and Leung 2010, table 4.2"),
    "dual_kkf_heading": (
        "dual kinematic KF with two antennas",
        dual_kkf.DUAL_KKF_WITH_HEADING,
        "to repeat table 4.3; where two antennas tell the heading, without a number of the car",
    ),
    "dual_kkf_free": (
        "dual kinematic KF that holds nothing between fixes",
        dual_kkf.DUAL_KKF_WITHOUT_HOLD,
        "rather than the dual KF where the accelerometers are good",
    ),
    "wheel_speed_ekf_a": (
        "heading and radius by rear wheels, a",
        wheel_speed_ekf.WHEEL_SPEED_A,
        "to see that the course alone does not tell the radius",
    ),
    "wheel_speed_ekf_b1": ("the same with speed over ground", wheel_speed_ekf.WHEEL_SPEED_B1, "without a yaw gyro"),
    "wheel_speed_ekf_b2": (
        "the same, speed held between fixes",
        wheel_speed_ekf.WHEEL_SPEED_B2,
        "to repeat tables 4.4 and 4.5",
    ),
    "wheel_speed_ekf_c": (
        "the same beside a yaw KKF",
        wheel_speed_ekf.WHEEL_SPEED_C,
        "where there are wheel speeds and a gyro: heading and speed without a number of the car",
    ),
    "triple_kkf": (
        "triple kinematic KF",
        triple_kkf.TRIPLE_KKF,
        "to repeat table 4.6: the speed between fixes is that of the wheels",
    ),
    "triple_kkf_b": ("triple kinematic KF b", triple_kkf.TRIPLE_KKF_B, "to repeat table 5.5"),
    "mekf_2a": ("single-track EKF", mekf.MEKF_2A, "where the steering sensor has no offset"),
    "mekf_2b": ("single-track EKF with the steering offset", mekf.MEKF_2B, "where the tyres are well known"),
    "mekf_2b_particles": (
        "the same as a particle filter",
        mekf.PARTICLES,
        "as a reference without any linearisation, at a hundred times the cost",
    ),
    "mekf_2c": (
        "single-track EKF, offset learnt on the straight",
        mekf.MEKF_2C,
        "where the tyres are roughly known: a wrong stiffness is not taken for an offset",
    ),
    "integrated_kf_a": (
        "integrated KF a: triple b, then single-track c",
        integrated_kf.INTEGRATED_KF_A,
        "to repeat table 5.5",
    ),
    "side_slip_kkf_1": (
        "dual KF, side slip extrapolated along a line",
        side_slip_kkf.SIDE_SLIP_KKF_1,
        "to repeat table 4.9",
    ),
    "side_slip_kkf_2": (
        "dual KF, side slip extrapolated along a parabola",
        side_slip_kkf.SIDE_SLIP_KKF_2,
        "to repeat table 4.9",
    ),
    "attitude_ekf": ("attitude by gyros and two antennas", attitude_ekf.ATTITUDE_EKF, "for the attitude alone"),
    "body_ins": ("INS in the axes of the car, open loop", open_loop.BODY_INS, "to see how an inertial sensor drifts"),
    "map_ins": ("INS on the map, open loop", open_loop.MAP_INS, "likewise, with the heading"),
    "gyro_and_course": (
        "side slip as course less integrated gyro",
        open_loop.GYRO_AND_COURSE,
        "as what a filter has to beat",
    ),
    "joint_kkf": (
        "velocity, heading, biases, position in one",
        joint_kkf.JOINT_KKF,
        "to see why gates or two antennas are needed",
    ),
    "joint_kkf_non_holonomic": (
        "the same, not sliding",
        joint_kkf.JOINT_KKF_NON_HOLONOMIC,
        "where position counts and the car slides little",
    ),
    "single_track": ("single-track model, open loop", model_observers.SINGLE_TRACK, "to repeat table 5.3"),
    "single_track_kf": (
        "single-track model, gyro and accelerometer",
        model_observers.SINGLE_TRACK_KF,
        "where there is no GNSS",
    ),
    "luenberger": ("single-track model, linear gain", model_observers.LUENBERGER, "as the cheapest observer"),
    "sliding_mode": ("single-track model, switching gain", model_observers.SLIDING_MODE, "likewise"),
    "model_and_ins": (
        "side slip by model and inertial sensor in two bands",
        model_observers.MODEL_AND_INS,
        "as what a filter has to beat",
    ),
    "wheel_speed_observer": (
        "accelerometers that wheel speeds correct",
        wheel_speed_observer.WHEEL_SPEED_OBSERVER,
        "where there is no GNSS",
    ),
    "parameter_ekf": (
        "openpilot's filter of stiffness, ratio and offset",
        parameter_ekf.PARAMETER_EKF,
        "as a baseline: yaw rate and steering offset",
    ),
    "integrated": (
        "single track with learning tyres, GNSS, all sensors",
        integrated.INTEGRATED,
        "where the car is roughly known: no gates, side slip also at the limit",
    ),
    "inertial": (
        "planar INS that learns its car",
        inertial.INERTIAL,
        "where nothing is known of the car: IMU and GNSS velocity",
    ),
    "heading_bank": (
        "heading by a bank of hypotheses",
        heading_bank.HEADING_BANK,
        "where the heading at start is not known and the course does not tell it yet",
    ),
    "strapdown": (
        "six-axis INS in error coordinates",
        strapdown.STRAPDOWN,
        "where the IMU has six axes, and attitude or position count",
    ),
}


def make(name: str, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> Aided:
    """The filter of this name for a vehicle with sensors. Raises `InputError` where they cannot drive it."""
    return Aided(name, DEFINITIONS[name][1], car_numbers(vehicle, sensors.values()), sensors)


FILTERS = Catalogue(
    FilterFamily(
        name,
        title,
        definition.states,
        definition.inputs,
        tuple(one.name for one in definition.measurements),
        when,
        partial(make, name),
    )
    for name, (title, definition, when) in DEFINITIONS.items()
)
