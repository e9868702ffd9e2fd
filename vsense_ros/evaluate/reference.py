"""Estimates, moved from `cog` to where the reference system of a recording sits.

A reference that sits elsewhere, or whose axes are turned, measures other velocities than those of `cog`. The comparison
is made at its place, so that what was measured stays as it was measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle

ODOMETRY = "vsense/odometry"
SIDE_SLIP = "vsense/sideslip"


def at_reference(output: Recording, vehicle: Vehicle) -> Recording:
    """The estimates of `output` as the reference system would see them, by the mounting that the vehicle file states.

    A system at `position` whose forward axis is turned by `yaw` sees the velocity R(-yaw) (v + ω × position). Position,
    attitude, velocity, rates and side slip are moved; covariances are left, since the mounting is taken as known. What
    is absent (NaN) stays so, and counts as zero for the rest.
    """
    mounting = vehicle.reference
    if ODOMETRY not in output or (not any(mounting.position) and mounting.yaw == 0):
        return output
    odometry = output[ODOMETRY]
    columns = dict(odometry.columns)
    turn = Rotation.from_euler("z", mounting.yaw)
    arm = np.array(mounting.position)
    attitude = Rotation.from_quat(columns["orientation"])
    columns["position"] = columns["position"] + attitude.apply(arm)
    columns["orientation"] = (attitude * turn).as_quat()
    linear, angular = (np.nan_to_num(columns[name]) for name in ("linear", "angular"))
    moved = {"linear": turn.inv().apply(linear + np.cross(angular, arm)), "angular": turn.inv().apply(angular)}
    for name, value in moved.items():
        columns[name] = np.where(np.isnan(columns[name]), np.nan, value)
    channels = {**output.channels, ODOMETRY: replace(odometry, columns=columns)}
    slip = output.channels.get(SIDE_SLIP)  # not every filter tells it
    if slip is not None and len(slip) and np.array_equal(slip.stamp, odometry.stamp):
        vector = slip.columns["vector"].copy()
        vector[:, 0] = np.arctan2(columns["linear"][:, 1], columns["linear"][:, 0])
        channels[SIDE_SLIP] = replace(slip, columns={"vector": vector})
    return replace(output, channels=channels)


def mounting_in_words(vehicle: Vehicle) -> str:
    """Where the estimates are compared, or nothing where that is `cog`."""
    mounting = vehicle.reference
    if not any(mounting.position) and mounting.yaw == 0:
        return ""
    x, y, z = mounting.position
    angle = np.degrees(mounting.yaw)
    return f"Compared at the reference system: ({x:.2f}, {y:.2f}, {z:.2f}) m from cog, its axes turned by {angle:.2f}°."
