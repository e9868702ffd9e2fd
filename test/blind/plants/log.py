"""What a plant hands over: the motion of every lane, every `PERIOD` seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PERIOD = 0.005  # [s]
SETTLING = 1.5  # [s] of driving before a log begins: cars start level, on a road that may not be

COLUMNS = {
    "position": 3,  # of cog in the map [m]
    "angles": 3,  # roll, pitch, yaw [rad]
    "velocity": 3,  # body axes [m/s]
    "rates": 3,  # body axes [rad/s]
    "force": 3,  # specific force of cog, body axes [m/s²]
    "turning": 3,  # angular acceleration, body axes [rad/s²]
    "travel": 4,  # compression [m]
    "spin": 4,  # [rad/s]
    "handwheel": 1,  # [rad]
    "torque": 4,  # told [N m]
    "load": 4,  # of the wheels [N]
    "side": 4,  # lateral tyre force [N]
}


@dataclass(frozen=True)
class Log:
    """Arrays (rows, columns, lanes) by name."""

    columns: dict[str, np.ndarray]

    def lane(self, index: int, duration: float) -> dict[str, np.ndarray]:
        """One lane, (rows, columns) each, cut to its duration."""
        rows = round(duration / PERIOD) + 1
        return {name: array[:rows, :, index].astype(float) for name, array in self.columns.items()}


class Recorder:
    def __init__(self, duration: float, lanes: int) -> None:
        rows = round(duration / PERIOD) + 1
        self._columns = {name: np.zeros((rows, count, lanes), np.float32) for name, count in COLUMNS.items()}
        self._row = 0

    def add(self, motion, action, handwheel, force, turning) -> None:
        if self._row >= len(self._columns["position"]):
            return
        values = {
            "position": motion.position, "angles": angles(motion.rotation), "velocity": motion.velocity,
            "rates": motion.rates, "force": force, "turning": turning, "travel": motion.travel, "spin": motion.spin,
            "handwheel": handwheel[None], "torque": action.told, "load": action.contact.load, "side": action.force_y,
        }  # fmt: skip
        for name, value in values.items():
            self._columns[name][self._row] = value
        self._row += 1

    def log(self) -> Log:
        return Log(self._columns)


def rotation(roll, pitch, yaw):
    """Body → map for z-y-x angles, (3, 3, …)."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return np.stack(
        [
            np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr]),
            np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr]),
            np.stack([-sp, cp * sr, cp * cr]),
        ]
    )


def angles(matrix):
    """Roll, pitch and yaw of `rotation`, (3, lanes)."""
    return np.stack(
        [
            np.arctan2(matrix[2, 1], matrix[2, 2]),
            -np.arcsin(np.clip(matrix[2, 0], -1, 1)),
            np.arctan2(matrix[1, 0], matrix[0, 0]),
        ]
    )
