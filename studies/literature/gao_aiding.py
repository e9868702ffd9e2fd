"""What helps an inertial filter while there are no fixes: the four strategies of Gao 2006 (Leung 2010, section 2.6.2).

    1  nothing: GNSS and inertial sensor alone
    2  v_x = V_wss,  v_y = 0                                   speed of the wheels, and a car that does not slide
    3  v_x = V_wss,  v_y by a lateral accelerometer and a yaw gyro of the car
    4  (v_x, v_y) = V_wss (cos β, sin β),  β by these two

The fourth sensor and the constraint v_z = 0 of his have no meaning here, on a plane. What the two sensors of the car
integrate forgets within τ: v̇_y = A_y - r V - v_y / τ, and β̇ = A_y / V - r - β / τ.
"""

from __future__ import annotations

import numpy as np

from studies.literature.finding import Array, Finding, rms
from vsense_ros.estimation.state_space import Measurement
from vsense_ros.navigation.joint_kkf import POSITION, VELOCITY, JointKkf
from vsense_ros.navigation.space import Definition

SOURCE = "Gao 2006, section 2.6.2"
STRATEGIES = (1, 2, 3, 4)
STEP, SPEED, FIXES, OUTAGE, FORGETTING = 0.05, 15.0, 60.0, 30.0, 10.0  # [s], [m/s], [s], [s], τ [s]
FORCE, RATE = 0.05, np.radians(0.1)  # noise of the inertial sensors [m/s²], [rad/s]
NUMBERS = {"acceleration_noise": FORCE, "gyro_noise": RATE, "sample_time": STEP, "antenna_x": 0.0, "antenna_y": 0.0}
AIDING = Measurement("aiding", lambda x, z, u, p: [x.forward_velocity, x.lateral_velocity], (0.1, 0.5))
GAO = Definition.of(JointKkf(), VELOCITY, POSITION, AIDING)


def winding_drive(slip: float) -> tuple[Array, Array]:
    """States (n, 5), yaw, velocity forwards and to the left, east, north, and readings (n, 3) without errors, of bends
    to the left in which the side slip reaches `slip` [rad]."""
    t = np.arange(0.0, FIXES + OUTAGE, STEP)
    rate, side_slip = 0.15 * (1 + np.sin(0.5 * t)), -slip / 2 * (1 + np.sin(0.5 * t))
    slipping = -slip / 4 * np.cos(0.5 * t)
    yaw = 0.15 * (t + 2 * (1 - np.cos(0.5 * t)))
    forward, lateral, turning = SPEED * np.cos(side_slip), SPEED * np.sin(side_slip), SPEED * (slipping + rate)
    course = yaw + side_slip
    steps = STEP * SPEED * np.column_stack([np.cos(course), np.sin(course)])
    place = np.cumsum(steps, axis=0) - steps
    readings = np.column_stack([-turning * np.sin(side_slip), turning * np.cos(side_slip), rate])
    return np.column_stack([yaw, forward, lateral, place]), readings


def error_after_outage(strategy: int, slip: float, random: np.random.Generator) -> float:
    """Error of the position [m]."""
    true, readings = winding_drive(slip)
    biased = readings + [0.2, -0.2, np.radians(0.5)] + [FORCE, FORCE, RATE] * random.standard_normal(readings.shape)
    of_car = readings[:, 1:] + [FORCE, RATE] * random.standard_normal((len(readings), 2))
    filter = GAO.make(NUMBERS)
    filter.start(GAO.start({"forward_velocity": SPEED, "yaw": 0.0}))
    aside = angle = 0.0
    for k, (yaw, forward, lateral, *place) in enumerate(true):
        if k * STEP >= FIXES and strategy > 1:
            wheels = SPEED + 0.02 * random.standard_normal()
            value = {
                2: [wheels, 0.0],
                3: [wheels, aside],
                4: [wheels * np.cos(angle), wheels * np.sin(angle)],
            }[strategy]
            filter.correct(*AIDING.measured(value))
        elif k * STEP < FIXES and k % round(1 / STEP) == 0:
            c, s = np.cos(yaw), np.sin(yaw)
            ground = np.array([c * forward - s * lateral, s * forward + c * lateral])
            filter.correct(*VELOCITY.measured(ground + 0.025 * random.standard_normal(2), np.full(2, 0.025**2)))
            filter.correct(*POSITION.measured(np.array(place) + random.standard_normal(2)))
        if k == len(true) - 1:
            break
        filter.inputs[:] = biased[k]
        filter.predict(STEP)
        across, rate = of_car[k]
        aside += STEP * (across - rate * SPEED - aside / FORGETTING)
        angle += STEP * (across / SPEED - rate - angle / FORGETTING)
    return float(np.hypot(*(filter.belief().mean[6:8] - true[-1, 3:5])))


def errors(slip: float, drives: int = 10) -> dict[int, float]:
    """Root mean square over drives of the error of the position [m] after the outage, by strategy."""
    return {
        one: rms(np.array([error_after_outage(one, slip, np.random.default_rng([2006, i])) for i in range(drives)]))
        for one in STRATEGIES
    }


def examine() -> list[Finding]:
    """Position after 30 s without fixes, in bends with a side slip of up to 2° and up to 10°."""
    rows = []
    for degrees in (2.0, 10.0):
        found = errors(np.radians(degrees))
        quantity = f"position after 30 s, side slip up to {degrees:g}°, RMSE"
        rows += [
            Finding(
                "aiding in an outage", SOURCE, quantity, "m", found[one], f"strategy {one}; without aiding", found[1]
            )
            for one in STRATEGIES[1:]
        ]
    return rows
