"""Side slip of a car that steers all wheels, by their speeds and angles (He et al. 2002; Leung 2010, eqs. 2.76, 2.78).

    V, β, ρ constant but for noise                             eq. 2.76, ρ the curvature of the path
    V_i = V cos β √((1 ∓ T ρ / cos β)² + tan² δ_j)             eq. 2.78, left and right, of the front or the rear axle
    tan δ_F = tan β + a ρ / cos β,  tan δ_R = tan β - b ρ / cos β   wheels that roll where they point

The print lacks the square of the bracket, and calls half the track T half the wheelbase. One speed at cog stands for
his four of the wheels. A car whose tyres slip moves by their slip angle elsewhere than its wheels point.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from studies.literature.finding import Array, Finding, rms
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting

SOURCE = "He 2002, eqs. 2.76, 2.78"
CAR = {"to_front": 1.36, "to_rear": 1.546, "half_track": 0.768}  # a, b, T [m]
_SPEED, _STEER = 0.012, np.radians(0.06)  # noise of a wheel [m/s] and of a wheel's angle [rad]


class FourWheelSteering(NavigationSpace):
    """V, β, ρ."""

    names = ("speed", "side_slip", "curvature")
    inputs = ("steer_front", "steer_rear")
    parameters = tuple(CAR)
    prior: Mapping[str, float] = {"speed": 1.0, "side_slip": 0.1, "curvature": 0.05}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return x.vector

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return drifting(h, 0.5, 0.05, 0.02)


def wheel_speeds(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    """Speeds [m/s] at which the wheels front left, front right, rear left, rear right roll where none slips, (4,)."""
    across = p.half_track * x.curvature / ca.cos(x.side_slip)
    return [
        x.speed * ca.cos(x.side_slip) * ca.sqrt((1 - side * across) ** 2 + ca.tan(steer) ** 2)
        for steer in (u.steer_front, u.steer_rear)
        for side in (1, -1)
    ]


def wheel_angles(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    """Steering angles [rad] of the front and the rear wheels with which none slips sideways, (2,)."""
    c, s = ca.cos(x.side_slip), ca.sin(x.side_slip)
    return [ca.atan2(s + p.to_front * x.curvature, c), ca.atan2(s - p.to_rear * x.curvature, c)]


SPEEDS = Measurement("wheels", wheel_speeds, (_SPEED,) * 4)
ANGLES = Measurement("steering", wheel_angles, (_STEER,) * 2)
HE = Definition.of(FourWheelSteering(), SPEEDS, ANGLES)


def follow(angles: Array, speeds: Array, h: float) -> Array:
    """States (n, 3) by angles (n, 2) of the axles [rad] and speeds (n, 4) of the wheels [m/s], each `h` [s]."""
    filter = HE.make(CAR)
    filter.start(HE.start({"speed": float(speeds[0].mean())}))
    states = np.zeros((len(angles), 3))
    for k, (steer, wheels) in enumerate(zip(angles, speeds, strict=True)):
        filter.inputs[:] = steer
        filter.correct(*ANGLES.measured(steer))
        filter.correct(*SPEEDS.measured(wheels))
        states[k] = filter.belief().mean
        filter.predict(h)
    return states


def rolling(speed: float, side_slip: Array, curvature: Array) -> tuple[Array, Array]:
    """Angles (n, 2) and speeds (n, 4) of wheels that roll, by the velocity of each axle and wheel."""
    c, s = speed * np.cos(side_slip), speed * np.sin(side_slip)
    aside = np.stack([s + CAR["to_front"] * speed * curvature, s - CAR["to_rear"] * speed * curvature], axis=1)
    along = [c - side * CAR["half_track"] * speed * curvature for side in (1, -1)]
    speeds = np.stack([np.hypot(one, aside[:, axle]) for axle in (0, 1) for one in along], axis=1)
    return np.arctan2(aside, c[:, None]), speeds


def examine() -> list[Finding]:
    """A slalom of 20 s at 5 m/s, in which a car goes aside and turns; with tyres that roll, and that slip by 1°."""
    t, random = np.arange(0.0, 20.0, 0.01), np.random.default_rng(2002)
    side_slip, curvature = np.radians(5.0) * np.sin(0.5 * t), 0.05 * np.sin(0.8 * t)
    angles, speeds = rolling(5.0, side_slip, curvature)
    errors = []
    for slip in (0.0, np.radians(1.0)):
        steer = angles + slip + _STEER * random.standard_normal(angles.shape)
        found = follow(steer, speeds + _SPEED * random.standard_normal(speeds.shape), 0.01)
        errors.append(float(np.degrees(rms(found[:, 1] - side_slip))))
    quantity, beside = "side slip in a slalom, RMSE", "all tyres slip by 1°"
    return [Finding("four-wheel steering", SOURCE, quantity, "°", errors[0], beside, errors[1])]
