"""The handling model with four degrees of freedom and lagged tyre forces of Best & Bogdanski (2016), eqs. 14 to 30.

Longitudinal, lateral, yaw and roll motion, and a longitudinal and a lateral force of each tyre that follows its steady
value with a constant lag. The wheel loads come from these lagged forces, so that there is no algebraic loop. The paper
is in SAE axes, this is in ISO 8855: lateral quantities, yaw and steering change their signs, what rolls does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres.base import TyreInput
from vsense_ros.model.tyres.similarity import Similarity


@dataclass(frozen=True)
class Best4DofSettings:
    """Where the equations of Best & Bogdanski 2016 are smoothed: decisions of this project."""

    load: float = 100.0  # [N] below about this a wheel load bends to zero, smoothly, and never gets there
    slowest: float = 2.0  # [m/s] forward speed of a wheel below which slip is that of this speed
    curve_points: int = 30  # of a curve


SMOOTHING = Best4DofSettings()

TYRE = ("stiffness", "longitudinal_ratio", "shape", "peak", "curvature")  # C_α, K_x, C, D, E

# Of the paper's car, a Jaguar XF of 2008: what its identification takes as known, and what it found (table 1, IEKF).
# Not printed are the lag of the tyres, their radius and the front share of roll stiffness: these are chosen here.
PAPER = {
    "front_weight": 9567.0, "rear_weight": 8635.0, "roll_inertia": 696.0, "front_roll_centre_height": 0.08,
    "rear_roll_centre_height": 0.125, "half_track": 0.79, "wheelbase": 2.91, "friction": 1.0, "lag": 0.03,
    "wheel_radius": 0.33, "front_roll_share": 0.55,
    "cog_height": 0.533, "yaw_inertia": 2069.0, "roll_stiffness": 1.152e5, "roll_damping": 6150.0,
    "front_stiffness": 0.625e5, "front_longitudinal_ratio": 3.299, "front_shape": 2.042, "front_peak": 1.103,
    "front_curvature": 0.630,
    "rear_stiffness": 1.283e5, "rear_longitudinal_ratio": 0.966, "rear_shape": 1.653, "rear_peak": 0.954,
    "rear_curvature": 0.720,
}  # fmt: skip

# The 14 that the paper identifies: its symbol and the unit that it prints them in, as a factor to SI.
SYMBOLS = {
    "cog_height": ("hG", 1.0), "yaw_inertia": ("Izz", 1e3), "roll_stiffness": ("Kphi", 1e5),
    "roll_damping": ("Bphi", 1e4), "front_longitudinal_ratio": ("Kxf", 1.0), "rear_longitudinal_ratio": ("Kxr", 1.0),
    "front_stiffness": ("Caf", 1e5), "rear_stiffness": ("Car", 1e5), "front_shape": ("Cf", 1.0),
    "front_peak": ("Df", 1.0), "front_curvature": ("Ef", 1.0), "rear_shape": ("Cr", 1.0), "rear_peak": ("Dr", 1.0),
    "rear_curvature": ("Er", 1.0),
}  # fmt: skip

# Between which the parameters of a car can be.
BOUNDS = {
    "cog_height": (0.2, 2.0), "yaw_inertia": (300.0, 2e4), "roll_stiffness": (2e4, 1e6), "roll_damping": (500.0, 1e5),
    "roll_inertia": (100.0, 5e3), "relaxation_length": (0.15, 3.0), "roll_gradient": (0.0, 0.03),
    "front_roll_centre_height": (-0.6, 0.6), "rear_roll_centre_height": (-0.6, 0.6),
    **{f"{axle}_{name}": ends for axle in ("front", "rear") for name, ends in {
        "stiffness": (1e4, 5e5), "longitudinal_ratio": (0.1, 20.0), "shape": (0.8, 3.0), "peak": (0.2, 3.0),
        "curvature": (-20.0, 1.0),
    }.items()},
}  # fmt: skip

JUDGED_BY_CURVE = tuple(f"{axle}_{name}" for axle in ("front", "rear") for name in ("shape", "curvature"))


class Best4Dof:
    """Its names and equations; arguments and results are CasADi expressions or numbers.

    States: velocity of the centre of gravity's place in the road plane, ahead and to the left [m/s], yaw rate [rad/s],
    roll [rad] and roll rate [rad/s], tyre forces in the axes of each wheel [N]. Inputs: road-wheel angle [rad], spin
    of each wheel [rad/s]. Outputs: acceleration ahead and to the left [m/s²], roll rate [rad/s] (eq. 30).

    `as_printed`: the equations of motion of the paper. In a frame that yaws and does not roll, a centre of gravity that
    has swung out by -h φ has the velocity (U + h φ r, V - h p). That gives the longitudinal equation the Coriolis term
    2 h r p and the term h φ ṙ, of which eq. 14 has half of the first; the lateral and the roll equation r (U + h φ r)
    in place of r U; and a longitudinal force the arm h φ about the centre of gravity, which eq. 16 lacks. At a yaw rate
    of 0.5 rad/s and a roll rate of 0.3 rad/s the first is 0.065 m/s²; braked at 9 m/s² in a turn the last is
    0.1 rad/s².

    `yaw_rate`: whether that is an output, too, of a car with a stability control.

    `on_body`: whether the accelerations are read by sensors that roll with the body, which feel g φ besides.
    """

    states: tuple[str, ...] = (
        "speed", "lateral_velocity", "yaw_rate", "roll", "roll_rate",
        *(f"longitudinal_force_{wheel}" for wheel in WHEELS), *(f"lateral_force_{wheel}" for wheel in WHEELS),
    )  # fmt: skip
    inputs: tuple[str, ...] = ("steering", *(f"spin_{wheel}" for wheel in WHEELS))
    outputs: tuple[str, ...] = ("longitudinal_acceleration", "lateral_acceleration", "roll_rate")
    parameters: tuple[str, ...] = tuple(PAPER)

    def __init__(self, *, as_printed: bool = False, on_body: bool = False, yaw_rate: bool = False) -> None:
        self.as_printed, self.on_body = as_printed, on_body
        if yaw_rate:
            self.outputs = (*type(self).outputs, "yaw_rate")

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Time derivatives of the states, (13,)."""
        mass = (p.front_weight + p.rear_weight) / GRAVITY
        to_front = p.wheelbase * p.rear_weight / (p.front_weight + p.rear_weight)
        axis = roll_axis_height(p)
        h = p.cog_height - axis
        ahead, left = self.road_forces(x, u)
        total_x, total_y = sum(ahead), sum(left)
        loads = self.loads(x, u, p)
        front, rear = left[0] + left[1], left[2] + left[3]
        turning = ahead[1] + ahead[3] - ahead[0] - ahead[2]
        yaw = (to_front * front - (p.wheelbase - to_front) * rear + p.half_track * turning) / p.yaw_inertia
        swung = 0.0 if self.as_printed else h * x.roll
        yaw -= swung * total_x / p.yaw_inertia
        centripetal = x.yaw_rate * (x.speed + swung * x.yaw_rate)  # acceleration towards the middle of the turn
        # eqs. 15 and 17 are linear in the lateral and the roll acceleration: [M, -M h; -M h, I] of these is
        side = total_y - mass * centripetal
        rolling = (
            mass * h * centripetal + mass * GRAVITY * h * x.roll + axis * total_y
            + p.half_track * (loads[0] + loads[2] - loads[1] - loads[3])
        )  # fmt: skip
        det = mass * p.roll_inertia - (mass * h) ** 2
        swinging = h * x.yaw_rate * x.roll_rate
        ahead_rate = total_x / mass + x.yaw_rate * x.lateral_velocity - swinging - swung * yaw
        if not self.as_printed:
            ahead_rate -= swinging
        lag = [
            [(steady - present) / p.lag for steady, present in zip(pair, (fx, fy), strict=True)]
            for pair, fx, fy in zip(self.steady_forces(x, u, p, loads), *self.tyre_forces(x), strict=True)
        ]
        return [
            ahead_rate, (p.roll_inertia * side + mass * h * rolling) / det, yaw,
            x.roll_rate, (mass * h * side + mass * rolling) / det,
            *(pair[0] for pair in lag), *(pair[1] for pair in lag),
        ]  # fmt: skip

    def measured(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Outputs (3,) (eq. 30)."""
        mass = (p.front_weight + p.rear_weight) / GRAVITY
        ahead, left = self.road_forces(x, u)
        tilt = GRAVITY * x.roll if self.on_body else 0.0
        outputs = [sum(ahead) / mass, sum(left) / mass + tilt, x.roll_rate]
        return [*outputs, x.yaw_rate] if "yaw_rate" in self.outputs else outputs

    def tyre_forces(self, x: Any) -> tuple[list[Scalar], list[Scalar]]:
        """Forces of the four tyres, along and across each wheel [N]."""
        return [x[f"longitudinal_force_{w}"] for w in WHEELS], [x[f"lateral_force_{w}"] for w in WHEELS]

    def road_forces(self, x: Any, u: Any) -> tuple[list[Scalar], list[Scalar]]:
        """Forces of the four tyres in the axes of the car [N] (eq. 20)."""
        along, across = self.tyre_forces(x)
        cos, sin = ca.cos(u.steering), ca.sin(u.steering)
        ahead = [along[i] * cos - across[i] * sin if i < 2 else along[i] for i in range(4)]
        left = [across[i] * cos + along[i] * sin if i < 2 else across[i] for i in range(4)]
        return ahead, left

    def loads(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Wheel loads [N] (eqs. 28 and 29), positive always.

        In a left turn the right wheels are loaded by lateral force and by roll alike; in the paper's SAE axes the two
        would have opposite signs, which eq. 28 leaves out.
        """
        ahead, left = self.road_forces(x, u)
        torque = p.roll_stiffness * x.roll + p.roll_damping * x.roll_rate
        front = ((left[0] + left[1]) * p.front_roll_centre_height + p.front_roll_share * torque) / (2 * p.half_track)
        rear_torque = (1 - p.front_roll_share) * torque
        rear = ((left[2] + left[3]) * p.rear_roll_centre_height + rear_torque) / (2 * p.half_track)
        pitch = sum(ahead) * p.cog_height / p.wheelbase / 2
        straight = [
            p.front_weight / 2 - front - pitch, p.front_weight / 2 + front - pitch,
            p.rear_weight / 2 - rear + pitch, p.rear_weight / 2 + rear + pitch,
        ]  # fmt: skip
        return [(load + ca.sqrt(load * load + SMOOTHING.load**2)) / 2 for load in straight]

    def steady_forces(self, x: Any, u: Any, p: Any, loads: list[Scalar]) -> list[tuple[Scalar, Scalar]]:
        """Steady forces of the four tyres, along and across [N], which the actual ones approach (eqs. 22 to 27)."""
        to_front = p.wheelbase * p.rear_weight / (p.front_weight + p.rear_weight)
        to_rear = p.wheelbase - to_front
        cos, sin = ca.cos(u.steering), ca.sin(u.steering)
        forces_of_tyres = []
        for i, wheel in enumerate(WHEELS):
            front, side = i < 2, -1 if i % 2 == 0 else 1
            ahead = x.speed + side * p.half_track * x.yaw_rate
            left = x.lateral_velocity + (to_front if front else -to_rear) * x.yaw_rate
            if front:
                ahead, left = ahead * cos + left * sin, left * cos - ahead * sin
            ahead = ca.fmax(ahead, SMOOTHING.slowest)
            rolling = p.wheel_radius * u[f"spin_{wheel}"]
            contact = TyreInput(loads[i], ahead, left, rolling, p.friction)
            forces = tyre(p, "front" if front else "rear").forces(contact)
            forces_of_tyres.append((forces.longitudinal, forces.lateral))
        return forces_of_tyres


def tyre(p: Any, axle: str) -> Similarity:
    """The tyre of an axle, "front" or "rear", with the parameters of the model in it."""
    values = {name: p[f"{axle}_{name}"] for name in TYRE}
    return Similarity.model_construct(model="similarity", relaxation_time=0.0, standstill_speed=0.01, **values)


def roll_axis_height(p: Any) -> Scalar:
    """Below the centre of gravity [m] (the paper's h0)."""
    front, rear = p["front_roll_centre_height"], p["rear_roll_centre_height"]
    return front + p["rear_weight"] / (p["front_weight"] + p["rear_weight"]) * (rear - front)


# Slips up to which force curves are drawn and judged: tangent of the slip angle, longitudinal slip.
REACH = {
    "front lateral": np.tan(np.radians(9.0)), "front longitudinal": 0.2,
    "rear lateral": np.tan(np.radians(6.0)), "rear longitudinal": 0.3,
}  # fmt: skip


def curve_slips(name: str) -> NDArray[np.float64]:
    """Slips of a force curve of `REACH`, (SMOOTHING.curve_points,)."""
    return np.linspace(0.0, REACH[name], SMOOTHING.curve_points + 1)[1:]


def curves(p: Mapping[str, float]) -> NDArray[np.float64]:
    """Force over slip at the wheel's load at rest and in pure slip, for each of `REACH` (4, SMOOTHING.curve_points)
    [N]."""
    return np.array(_curves()([p[name] for name in Best4Dof.parameters])).T


@cache
def _curves() -> ca.Function:
    vector = ca.SX.sym("p", len(Best4Dof.parameters))
    p = dict(zip(Best4Dof.parameters, ca.vertsplit(vector), strict=True))
    columns = []
    for name in REACH:
        axle, direction = name.split()
        load, speed = p[f"{axle}_weight"] / 2, 20.0
        column = []
        for slip in curve_slips(name):
            lateral = direction == "lateral"
            contact = TyreInput(
                load, speed, -slip * speed if lateral else 0.0, speed * (1 if lateral else 1 + slip), p["friction"]
            )
            forces = tyre(p, axle).forces(contact)
            column.append(forces.lateral if lateral else forces.longitudinal)
        columns.append(ca.vertcat(*column))
    return ca.Function("curves", [vector], [ca.horzcat(*columns)])
