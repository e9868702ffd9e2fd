"""Integrated Kalman filter a: the triple filter b, then the single-track model of MEKF 2c (Leung 2010, figure 5.15).

The model gets the forward velocity of the triple filter for its speed, the yaw rate without the gyro's bias, and the
heading as one more measurement.
"""

from __future__ import annotations

from vsense_ros.estimation.cascade import PassedInput, PassedMeasurement
from vsense_ros.estimation.state_space import Measurement
from vsense_ros.navigation.space import Definition, Remembered
from vsense_ros.navigation.thesis.mekf import COURSE, GYRO, Mekf2c, running_mean
from vsense_ros.navigation.thesis.triple_kkf import TRIPLE_KKF_B
from vsense_ros.navigation.thesis.wheel_speed_ekf import HEADING_REPEATS

RATE = Measurement("rate_of_heading", lambda x, z, u, p: x.yaw_rate, (0.003,))
YAW = Measurement("yaw_of_heading", lambda x, z, u, p: x.yaw, (0.0,), angles=(0,))
PASSED = (
    PassedMeasurement(GYRO, "heading", "model", RATE.name, lambda x, gyro: gyro[0] - x.gyro_bias, HEADING_REPEATS),
    PassedMeasurement(YAW, "heading", "model", YAW.name, lambda x, nothing: x.yaw, HEADING_REPEATS),
)
SPEED = PassedInput("velocity", "model", lambda x, u: x.forward_velocity, ("speed",))

INTEGRATED_KF_A = Definition(
    {**TRIPLE_KKF_B.parts, "model": (Mekf2c(), (COURSE, RATE, YAW))},
    (*TRIPLE_KKF_B.passed_inputs, SPEED),
    (*TRIPLE_KKF_B.passed_measurements, *PASSED),
    remembered=(*TRIPLE_KKF_B.remembered, Remembered("model", "rates and forces", running_mean)),
)
