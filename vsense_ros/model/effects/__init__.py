"""Physical effects that a model may have or lack, one file each.

A vehicle file lists those that its car has below `physics: effects:`, by id, with their parameters; every effect with
zero size changes nothing. `Effect` (base.py) says where effects enter the equations. To add one: write its file, add
its class to `_ALL`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, create_model

from vsense_ros.model.effects.accelerometer_bias import AccelerometerBias
from vsense_ros.model.effects.aero_downforce import AeroDownforce
from vsense_ros.model.effects.aero_drag import AeroDrag
from vsense_ros.model.effects.base import Effect
from vsense_ros.model.effects.body_roll_in_accelerometer import BodyRollInAccelerometer
from vsense_ros.model.effects.brake_drag import BrakeDrag
from vsense_ros.model.effects.bump_stop import BumpStop
from vsense_ros.model.effects.camber_thrust import CamberThrust
from vsense_ros.model.effects.crosswind import Crosswind
from vsense_ros.model.effects.friction_change import FrictionChange
from vsense_ros.model.effects.gnss_lever_arm import GnssLeverArm
from vsense_ros.model.effects.gyro_bias import GyroBias
from vsense_ros.model.effects.gyro_scale import GyroScale
from vsense_ros.model.effects.imu_lever_arm import ImuLeverArm
from vsense_ros.model.effects.imu_pitch_misalignment import ImuPitchMisalignment
from vsense_ros.model.effects.imu_roll_misalignment import ImuRollMisalignment
from vsense_ros.model.effects.imu_yaw_misalignment import ImuYawMisalignment
from vsense_ros.model.effects.limited_slip_differential import LimitedSlipDifferential
from vsense_ros.model.effects.payload_offset import PayloadOffset
from vsense_ros.model.effects.road_bank import RoadBank
from vsense_ros.model.effects.road_grade import RoadGrade
from vsense_ros.model.effects.roll_steer import RollSteer
from vsense_ros.model.effects.rolling_resistance import RollingResistance
from vsense_ros.model.effects.sensor_delay import SensorDelay
from vsense_ros.model.effects.sloshing_load import SloshingLoad
from vsense_ros.model.effects.steering_compliance import SteeringCompliance
from vsense_ros.model.effects.steering_offset import SteeringOffset
from vsense_ros.model.effects.steering_ratio import SteeringRatio
from vsense_ros.model.effects.suspension_friction import SuspensionFriction
from vsense_ros.model.effects.toe_compliance import ToeCompliance
from vsense_ros.model.effects.tyre_conicity import TyreConicity
from vsense_ros.model.effects.tyre_heating import TyreHeating
from vsense_ros.model.effects.tyre_load_sensitivity import TyreLoadSensitivity
from vsense_ros.model.effects.tyre_relaxation import TyreRelaxation
from vsense_ros.model.effects.tyre_underinflation import TyreUnderinflation
from vsense_ros.model.effects.unmodelled import Unmodelled
from vsense_ros.model.effects.wheel_radius import WheelRadius
from vsense_ros.model.parameter import Part

_ALL: tuple[type[Effect], ...] = (
    AccelerometerBias,
    AeroDownforce,
    AeroDrag,
    BodyRollInAccelerometer,
    BrakeDrag,
    BumpStop,
    CamberThrust,
    Crosswind,
    FrictionChange,
    GnssLeverArm,
    GyroBias,
    GyroScale,
    ImuLeverArm,
    ImuPitchMisalignment,
    ImuRollMisalignment,
    ImuYawMisalignment,
    LimitedSlipDifferential,
    PayloadOffset,
    RoadBank,
    RoadGrade,
    RollSteer,
    RollingResistance,
    SensorDelay,
    SloshingLoad,
    SteeringCompliance,
    SteeringOffset,
    SteeringRatio,
    SuspensionFriction,
    ToeCompliance,
    TyreConicity,
    TyreHeating,
    TyreLoadSensitivity,
    TyreRelaxation,
    TyreUnderinflation,
    Unmodelled,
    WheelRadius,
)
EVERY = {effect.id: effect for effect in _ALL}
BY_ID = {id: effect for id, effect in EVERY.items() if effect.known}  # the library: physics that has a name


class _Effects(Part):
    """Effects of a car, its road and its sensors by id; those left out are absent."""

    def present(self) -> tuple[Effect, ...]:
        """The effects that the file lists, whatever their size."""
        return tuple(value for name in type(self).model_fields if (value := getattr(self, name)) is not None)


if TYPE_CHECKING:
    Effects = _Effects
else:
    Effects = create_model(
        "Effects",
        __base__=_Effects,
        **{id: (effect | None, Field(default=None, description=effect.sentence)) for id, effect in EVERY.items()},
    )

__all__ = ["BY_ID", "EVERY", "Effect", "Effects"]
