"""Drives whose truth is known in closed form, for the tests of the evaluation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.recording import Channel, Recording

START = 1_700_000_000_000_000_000
WHEELS = ("fl", "fr", "rl", "rr")


def channel(topic: str, kind: str, seconds: NDArray, columns: dict, frame_id: str = "", names: tuple = ()) -> Channel:
    stamp = START + np.round(np.asarray(seconds) * 1e9).astype(np.int64)
    return Channel(topic, kind, stamp, stamp, columns, frame_id, names)


def odometry(
    topic: str,
    seconds: NDArray,
    *,
    position: NDArray | None = None,
    yaw: NDArray | None = None,
    roll: NDArray | None = None,
    vx: NDArray | float = 20.0,
    vy: NDArray | float = 0.0,
    yaw_rate: NDArray | float = 0.0,
    deviation: float = 0.0,
) -> Channel:
    rows = len(seconds)
    yaw = np.zeros(rows) if yaw is None else yaw
    roll = np.zeros(rows) if roll is None else roll
    zero = np.zeros(rows)
    half_yaw, half_roll = yaw / 2, roll / 2
    orientation = np.column_stack(
        [
            np.cos(half_yaw) * np.sin(half_roll),
            np.sin(half_yaw) * np.sin(half_roll),
            np.sin(half_yaw) * np.cos(half_roll),
            np.cos(half_yaw) * np.cos(half_roll),
        ]
    )
    place = np.column_stack([zero, zero]) if position is None else position
    covariance = np.tile((np.eye(6) * deviation**2).ravel(), (rows, 1))
    return channel(
        topic,
        "nav_msgs/msg/Odometry",
        seconds,
        {
            "position": np.column_stack([place, zero]),
            "orientation": orientation,
            "pose_covariance": covariance,
            "linear": np.column_stack([zero + vx, zero + vy, zero]),
            "angular": np.column_stack([zero, zero, zero + yaw_rate]),
            "twist_covariance": covariance.copy(),
        },
        "map",
    )


def recording(*channels: Channel, **more) -> Recording:
    return Recording({found.topic: found for found in channels}, **more)


def slalom(
    source: str, *, late: float = 0.0, noise: float = 0.0, rate: float = 100.0, duration: float = 20.0
) -> Recording:
    """A slalom at 15 to 25 m/s with everything an observer says about it; `late` delays it, `noise` spoils it."""
    random = np.random.default_rng(7)
    seconds = np.arange(0.0, duration, 1.0 / rate)
    t = seconds - late

    def spoil(value: NDArray, scale: float) -> NDArray:
        slow = np.convolve(random.normal(size=len(t) + 49), np.ones(50) / 7.1, "valid")
        return value + noise * scale * slow

    speed = 20.0 + 5.0 * np.sin(0.2 * t)
    yaw_rate = 0.3 * np.sin(1.5 * t)
    yaw = 0.2 - 0.2 * np.cos(1.5 * t)
    vy = spoil(0.5 * np.sin(1.5 * t - 0.4), 0.08)
    path = np.cumsum(np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw)]), axis=0) / rate
    found = [
        odometry(
            f"{source}/odometry",
            seconds,
            position=spoil(path.T, 0.4).T if noise else path,
            yaw=yaw,
            roll=spoil(-0.03 * np.sin(1.5 * t), 0.003),
            vx=spoil(speed, 0.1),
            vy=vy,
            yaw_rate=spoil(yaw_rate, 0.008),
            deviation=0.1 if noise else 0.0,
        ),
        channel(
            f"{source}/acceleration",
            "geometry_msgs/msg/AccelStamped",
            seconds,
            {
                "linear": np.column_stack([np.cos(0.2 * t), spoil(yaw_rate * speed, 0.2), 0.1 * np.sin(8.0 * t)]),
                "angular": np.zeros((len(t), 3)),
            },
        ),
    ]
    if source == "vsense":
        beta = np.arctan2(vy, speed)
        found.append(
            channel(
                "vsense/sideslip",
                "geometry_msgs/msg/Vector3Stamped",
                seconds,
                {"vector": np.column_stack([beta, np.full(len(t), 0.004), np.gradient(beta, seconds)])},
            )
        )
    for wheel in WHEELS:
        left = 1.0 if wheel.endswith("l") else -1.0
        vertical = 4000.0 - left * 250.0 * yaw_rate * speed
        found.append(
            channel(
                f"{source}/wheel_force/{wheel}",
                "geometry_msgs/msg/WrenchStamped",
                seconds,
                {
                    "force": np.column_stack(
                        [
                            300.0 * np.cos(0.2 * t),
                            spoil(vertical * yaw_rate * speed / 9.81, 150.0),
                            spoil(vertical, 60.0),
                        ]
                    ),
                    "torque": np.zeros((len(t), 3)),
                },
            )
        )
    return recording(*found, name="slalom")
