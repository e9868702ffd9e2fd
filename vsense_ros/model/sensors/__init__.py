"""Sensor equations, one file each.

A sensor is a pydantic class: where its messages come from, how to read one, its noise and biases, and the equation that
says what it would measure. To add one: write its file, add it here.
"""

from typing import Annotated

from pydantic import Field

from vsense_ros.model.sensors.base import Bias, SensorBase
from vsense_ros.model.sensors.gnss_attitude import GnssAttitude
from vsense_ros.model.sensors.gnss_position import GnssPosition
from vsense_ros.model.sensors.gnss_velocity import GnssVelocity
from vsense_ros.model.sensors.imu import Imu
from vsense_ros.model.sensors.steering import Steering
from vsense_ros.model.sensors.suspension import Suspension
from vsense_ros.model.sensors.wheel_speeds import WheelSpeeds
from vsense_ros.model.sensors.wheel_torques import WheelTorques

Sensor = Annotated[
    Imu | WheelSpeeds | Suspension | Steering | WheelTorques | GnssPosition | GnssVelocity | GnssAttitude,
    Field(discriminator="kind"),
]

__all__ = [
    "Bias",
    "GnssAttitude",
    "GnssPosition",
    "GnssVelocity",
    "Imu",
    "Sensor",
    "SensorBase",
    "Steering",
    "Suspension",
    "WheelSpeeds",
    "WheelTorques",
]
