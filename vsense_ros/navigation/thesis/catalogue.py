"""Filters of the literature by name: what each estimates, and what it is compared with."""

from __future__ import annotations

from vsense_ros.navigation import joint_kkf, open_loop, yaw_kkf
from vsense_ros.navigation.space import Definition
from vsense_ros.navigation.thesis import (
    attitude_ekf,
    dual_kkf,
    integrated_kf,
    mekf,
    model_observers,
    parameter_ekf,
    side_slip_kkf,
    tilt_kkf,
    triple_kkf,
    wheel_speed_ekf,
    wheel_speed_observer,
)

# Name → title, definition, when to take it.
THESIS: dict[str, tuple[str, Definition, str]] = {
    "yaw_kkf": (
        "heading by gyro and course",
        yaw_kkf.YAW_KKF,
        "to repeat section 4.2.1 of Leung 2010: it takes a car to go where it points, which no banked road lets it do",
    ),
    "yaw_kkf_heading": (
        "heading by gyro, course and two antennas",
        yaw_kkf.YAW_KKF_WITH_HEADING,
        "likewise, where two antennas measure the heading",
    ),
    "dual_kkf": ("dual kinematic KF", dual_kkf.DUAL_KKF, "to repeat Bevly 2001 and Leung 2010, table 4.2"),
    "dual_kkf_heading": (
        "dual kinematic KF with two antennas",
        dual_kkf.DUAL_KKF_WITH_HEADING,
        "to repeat table 4.3; where two antennas measure the heading, without a number of the car",
    ),
    "dual_kkf_free": (
        "dual kinematic KF that holds nothing between fixes",
        dual_kkf.DUAL_KKF_WITHOUT_HOLD,
        "rather than the dual KF where the accelerometers are good",
    ),
    "wheel_speed_ekf_a": (
        "heading and radius by rear wheels, a",
        wheel_speed_ekf.WHEEL_SPEED_A,
        "to see that the course alone does not determine the radius",
    ),
    "wheel_speed_ekf_b1": (
        "heading and radius by rear wheels and speed over ground",
        wheel_speed_ekf.WHEEL_SPEED_B1,
        "without a yaw gyro",
    ),
    "wheel_speed_ekf_b2": (
        "heading and radius by rear wheels, speed held between fixes",
        wheel_speed_ekf.WHEEL_SPEED_B2,
        "to repeat tables 4.4 and 4.5",
    ),
    "wheel_speed_ekf_c": (
        "heading and radius by rear wheels beside a yaw KKF",
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
        "single-track particle filter with the steering offset",
        mekf.PARTICLES,
        "as a reference without any linearisation, at a hundred times the cost",
    ),
    "mekf_2c": (
        "single-track EKF, offset estimated on the straight",
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
    "pitch_kkf": (
        "pitch by gyro and two antennas, one behind the other",
        tilt_kkf.PITCH_KKF,
        "to repeat section 4.5: pitch of body and road, without a number of the car",
    ),
    "roll_kkf": (
        "roll by gyro and two antennas side by side",
        tilt_kkf.ROLL_KKF,
        "to repeat section 4.5: roll of body and road, without a number of the car",
    ),
    "body_ins": ("INS in the axes of the car, open loop", open_loop.BODY_INS, "to see how an inertial sensor drifts"),
    "map_ins": (
        "INS on the map, open loop",
        open_loop.MAP_INS,
        "to see how an inertial sensor drifts, with the heading",
    ),
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
        "velocity, heading, biases, position in one, not sliding",
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
    "sliding_mode": ("single-track model, switching gain", model_observers.SLIDING_MODE, "as a cheap observer"),
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
}
