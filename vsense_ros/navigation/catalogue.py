"""The filters of this room by name: what each estimates, and when to take which."""

from __future__ import annotations

from functools import partial

from vsense_ros.estimation.catalogue import Catalogue, FilterFamily
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation import dual_kkf, integrated_kf, mekf, triple_kkf, wheel_speed_ekf, yaw_kkf
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
