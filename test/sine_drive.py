"""Drives whose truth is a closed form, as recordings: a car that turns as a sine, and what may go wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsense_ros.bag.importers import build
from vsense_ros.estimation.filter import Array
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.vehicle import Vehicle

SPEED, RATE, PERIOD = 15.0, 0.25, 8.0  # [m/s], [rad/s] at most, [s]
REAR = 1.5  # [m] from cog to the rear axle, which rolls without side slip
ORIGIN = (43.5, -8.2, 0.0)
EPOCH = 1_600_000_000_000_000_000


def car_of_sine_drive() -> Vehicle:
    """A car whose sensors are mounted at cog, and whose axles and wheels are where the sine drive has them."""
    found = load_vehicle(vehicle_path("prototype_model"))
    sensors = {}
    for name, sensor in found.sensors.items():
        at = {"position": (0.0, 0.0, 0.0)} if hasattr(sensor, "position") else {}
        sensors[name] = sensor.model_copy(update=at)
    changed = found.with_parameters({"chassis.cog_to_rear_axle": 1.5, "rear.track": 1.6, "rear.unloaded_radius": 0.306})
    return changed.model_copy(update={"sensors": sensors})


class SineDrive:
    """A car whose rear axle rolls without side slip, at constant speed after standing for `stands` [s]."""

    def __init__(self, seconds: float = 40.0, heading: float = 0.3, stands: float = 0.0, seed: int = 0) -> None:
        self.t = np.arange(0.0, seconds, 0.01)
        moving = np.clip((self.t - stands) / 5.0, 0.0, 1.0) if stands else np.ones_like(self.t)
        self.speed = SPEED * moving
        along = np.gradient(self.speed, 0.01)
        w = 2 * np.pi / PERIOD
        calm = 8.0 + stands  # [s] straight ahead first
        phase = np.where(self.t > calm, self.t - calm, 0.0)
        self.rate = RATE * np.sin(w * phase)
        turning = np.where(self.t > calm, RATE * w * np.cos(w * phase), 0.0)
        self.yaw = heading + np.concatenate([[0.0], np.cumsum(0.5 * (self.rate[1:] + self.rate[:-1]) * 0.01)])
        self.lateral = REAR * self.rate
        self.random = np.random.default_rng(seed)
        n = len(self.t)
        noise = self.random.normal(size=(n, 9))
        self.rates = np.column_stack([np.zeros(n), np.zeros(n), self.rate]) + 0.01 + 0.00175 * noise[:, :3]
        forces = [along - self.rate * self.lateral, REAR * turning + self.rate * self.speed, np.full(n, 9.80665)]
        self.forces = np.column_stack(forces) + 0.1 + 0.1 * noise[:, 3:6]
        self.east_north = self.on_map(self.speed, self.lateral)
        self.position = np.cumsum(self.east_north, axis=0) * 0.01

    def on_map(self, forward: Array, lateral: Array) -> Array:
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.column_stack([c * forward - s * lateral, s * forward + c * lateral])

    def recording(self, gnss_every: int = 20) -> Recording:
        """With GNSS at 100 / `gnss_every` Hz; mounted at cog."""
        stamp = EPOCH + (self.t * 1e9).astype(np.int64)
        rows = np.arange(0, len(self.t), gnss_every)
        seen = self.east_north[rows] + 0.025 * self.random.normal(size=(len(rows), 2))
        up = np.zeros(len(rows))
        half = self.speed[:, None] + self.rate[:, None] * 0.8 * np.array([-1.0, 1.0, -1.0, 1.0])
        spins = half / 0.3 + 0.04 * self.random.normal(size=half.shape)
        names = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
        steer = np.arctan(3.0 * self.rate / np.maximum(self.speed, 1.0))
        degrees = np.degrees(self.position / 6.378e6)
        fixes = [ORIGIN[0] + degrees[rows, 1], ORIGIN[1] + degrees[rows, 0] / np.cos(np.radians(ORIGIN[0]))]
        zero = np.zeros_like(self.t)
        reference = {
            "position": np.column_stack([self.position, zero]),
            "orientation": np.column_stack([zero, zero, np.sin(self.yaw / 2), np.cos(self.yaw / 2)]),
            "pose_covariance": np.zeros((len(zero), 36)),
            "linear": np.column_stack([self.speed, self.lateral, zero]),
            "angular": np.column_stack([zero, zero, self.rate]),
        }
        channels = {
            "imu/data": build.imu(stamp, self.rates, self.forces),
            "vehicle/wheel_speeds": build.joints(
                "vehicle/wheel_speeds", stamp, "velocity", dict(zip(names, spins.T, strict=True))
            ),
            "vehicle/steering": build.joints("vehicle/steering", stamp, "position", {"road_wheel_front": steer}),
            "gps/velocity": build.velocity(stamp[rows], np.column_stack([seen, up])),
            "gps/fix": build.fix(stamp[rows], *fixes, up),
            "reference/odometry": build.channel("reference/odometry", stamp, reference),
        }
        return Recording(channels, "sine")


def with_velocity(recording: Recording, change: object, after: float = 20.0) -> Recording:
    """The recording whose GNSS velocities (n, 3) later than `after` [s] became `change(velocities)`."""
    channel: Channel = recording["gps/velocity"]
    linear = channel.columns["linear"].copy()
    late = channel.seconds > after
    linear[late] = change(linear[late])  # type: ignore[operator]
    changed = replace(channel, columns={**channel.columns, "linear": linear})
    return replace(recording, channels={**recording.channels, "gps/velocity": changed})


def without_velocity(recording: Recording, begin: float, end: float) -> Recording:
    """The recording without GNSS from `begin` to `end` [s]."""
    channels = dict(recording.channels)
    for topic in ("gps/velocity", "gps/fix"):
        seconds = channels[topic].seconds
        channels[topic] = channels[topic].select((seconds < begin) | (seconds > end))
    return replace(recording, channels=channels)
