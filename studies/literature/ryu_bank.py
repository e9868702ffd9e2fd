"""Bank of the road, separated from the roll of the body (Ryu & Gerdes 2004a; Leung 2010, eqs. 2.85 and 2.86).

Two antennas across the car measure the sum of both, φ_v + φ_ev. A single-track model separates them: a road that
leans pulls the car aside, and the body rolls by the forces of the tyres.

    f_y = (F_F + F_R) / m                                      specific force of linear tyres
    β̇ = (f_y - g φ_ev) / V - r,  J_z ṙ = a F_F - b F_R         as eq. 2.83, with the bank
    J_x φ̈_v = m h f_y + (m g h - K) φ_v - C φ̇_v - J_x ṗ        roll of the body on its springs
    φ̇_ev = p + ε,  p̈ = w_p,  ε̇ = w_ε                           eq. 2.86: the road turns under the car, or is steep

The states are those of the thesis; p is the roll rate of the road, and the gyro measures φ̇_v + p. ISO axes: an angle is
positive where the left side is up.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from studies.literature.finding import Array, Finding, rms
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.model.constants import GRAVITY
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting

SOURCE = "Ryu & Gerdes 2004a, eqs. 2.85-2.86"
# A saloon: table A.1 and eq. 3.29 of the thesis for the motion on the road; roll as of a common suspension. The
# stiffness of an axle [N/rad] is negative; the roll inertia is about the roll axis.
CAR = {
    "mass": 1858.0, "yaw_inertia": 3515.0, "to_front": 1.36, "to_rear": 1.546,
    "front_stiffness": -154_780.0, "rear_stiffness": -147_540.0,
    "roll_inertia": 1120.0, "height": 0.5, "roll_stiffness": 1.0e5, "roll_damping": 5000.0,
}  # fmt: skip
SLOWEST = 3.0  # [m/s], below it the model divides by too little
_RATE, _ANGLE = np.radians(0.1), np.radians(0.3)  # noise of gyros [rad/s] and of receivers [rad]


class RyuBank(NavigationSpace):
    """β, r, φ_v, φ̇_v, φ_ev, p, ṗ, ε."""

    names = ("side_slip", "yaw_rate", "body_roll", "body_roll_rate", "bank", "road_rate", "road_acceleration", "slope")
    inputs = ("steer_angle", "speed")
    parameters = tuple(CAR)
    prior: Mapping[str, float] = dict(
        zip(names, (0.05, 0.1, 0.05, 0.1, 0.1, 0.05, 0.05, 0.005), strict=True)
    )  # [rad], [rad/s], [rad/s²]

    def rates(self, x: Named, u: Named, theta: Named) -> ca.SX:
        """ẋ (8,)."""
        speed = ca.fmax(u.speed, SLOWEST)
        front = theta.front_stiffness * (x.side_slip + theta.to_front * x.yaw_rate / speed - u.steer_angle)
        rear = theta.rear_stiffness * (x.side_slip - theta.to_rear * x.yaw_rate / speed)
        across, lever = (front + rear) / theta.mass, theta.mass * theta.height
        moment = lever * (across + GRAVITY * x.body_roll)
        springs = theta.roll_stiffness * x.body_roll + theta.roll_damping * x.body_roll_rate
        return ca.vertcat(
            (across - GRAVITY * x.bank) / speed - x.yaw_rate,
            (theta.to_front * front - theta.to_rear * rear) / theta.yaw_inertia,
            x.body_roll_rate,
            (moment - springs) / theta.roll_inertia - x.road_acceleration,
            x.road_rate + x.slope,
            x.road_acceleration,
            0.0,
            0.0,
        )

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        middle = Named(x.vector + h / 2 * self.rates(x, u, theta), self.names)
        return x.vector + h * self.rates(middle, u, theta)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return drifting(h, 1e-3, 1e-2, 1e-4, 1e-3, 1e-5, 1e-4, 0.1, 1e-3)


GYROS = Measurement("gyros", lambda x, z, u, p: [x.yaw_rate, x.body_roll_rate + x.road_rate], (_RATE, _RATE))
RECEIVER = Measurement("receiver", lambda x, z, u, p: [x.side_slip, x.body_roll + x.bank], (_ANGLE, _ANGLE))
RYU_BANK = Definition.of(RyuBank(), GYROS, RECEIVER)


def follow(steer: Array, speed: float, measured: Array, h: float, car: Mapping[str, float] = CAR) -> Array:
    """States (n, 8) by angles (n,) of the front wheels and `measured` (n, 4): yaw rate and roll rate by gyros,
    side slip and roll by two antennas, NaN where there is no fix."""
    filter = RYU_BANK.make(car)
    filter.start(RYU_BANK.start({}))
    states = np.zeros((len(steer), 8))
    for k, row in enumerate(measured):
        filter.inputs[:] = steer[k], speed
        filter.correct(*GYROS.measured(row[:2]))
        if np.isfinite(row[2]):
            filter.correct(*RECEIVER.measured(row[2:]))
        states[k] = filter.belief().mean
        filter.predict(h)
    return states


def banked_drive(h: float, speed: float) -> tuple[Array, Array]:
    """Times (n,) and states (n, 6) β, r, φ_v, φ̇_v, φ_ev, φ̇_ev of a slalom on a road that leans by 5° from 6 to 8 s."""
    c, t = CAR, np.arange(0.0, 30.0, h)

    def road(at: float) -> tuple[float, float, float]:
        """Bank, its rate and its acceleration: a half wave."""
        w, s = np.pi / 2, min(max(at - 6.0, 0.0), 2.0)
        half = np.radians(5.0) / 2
        return half * (1 - np.cos(w * s)), half * w * np.sin(w * s), half * w**2 * np.cos(w * s) * (0 < s < 2)

    def rates(at: float, y: Array) -> list[float]:
        bank, _, quick = road(at)
        front = c["front_stiffness"] * (y[0] + c["to_front"] * y[1] / speed - steer_angle(at))
        rear = c["rear_stiffness"] * (y[0] - c["to_rear"] * y[1] / speed)
        turning = c["mass"] * c["height"] * ((front + rear) / c["mass"] + GRAVITY * y[2])
        held = c["roll_stiffness"] * y[2] + c["roll_damping"] * y[3]
        return [
            (front + rear) / (c["mass"] * speed) - y[1] - GRAVITY * bank / speed,
            (c["to_front"] * front - c["to_rear"] * rear) / c["yaw_inertia"],
            y[3],
            (turning - held) / c["roll_inertia"] - quick,
        ]

    found = solve_ivp(rates, (0.0, 30.0), np.zeros(4), t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.05)
    return t, np.column_stack([found.y.T, [road(at)[:2] for at in t]])


def steer_angle(t: Any) -> Any:
    """Steering angle of the front wheels in the slalom [rad] at t [s]: up to 4 m/s² at 20 m/s."""
    return 0.03 * np.sin(1.2 * t)


def examine() -> list[Finding]:
    """Bank by the observer, beside the roll of the antennas taken for it, and with springs believed 20 % softer."""
    h, speed, random = 0.01, 20.0, np.random.default_rng(2004)
    t, true = banked_drive(h, speed)
    measured = np.column_stack([true[:, 1], true[:, 3] + true[:, 5], true[:, 0], true[:, 2] + true[:, 4]])
    measured += np.array([_RATE, _RATE, _ANGLE, _ANGLE]) * random.standard_normal(measured.shape)
    measured[np.arange(len(t)) % 10 > 0, 2:] = np.nan  # fixes at 10 Hz
    softer = CAR | {"roll_stiffness": 0.8 * CAR["roll_stiffness"]}
    late = t > 5.0
    errors = [
        float(np.degrees(rms((follow(steer_angle(t), speed, measured, h, car)[:, 4] - true[:, 4])[late])))
        for car in (CAR, softer)
    ]
    rolls = float(np.degrees(rms(true[late, 2])))
    quantity = "bank in a slalom, RMSE"
    return [
        Finding("bank observer", SOURCE, quantity, "°", errors[0], "roll of two antennas taken for the bank", rolls),
        Finding("bank observer", SOURCE, quantity, "°", errors[0], "springs believed 20 % softer", errors[1]),
    ]
