"""The car as a tree in Pinocchio, built from a vehicle file's numbers without looking at the project's model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.vehicle import Vehicle

pin = pytest.importorskip("pinocchio", reason="the oracle Pinocchio is not installed (pip install pin)")

G = 9.80665
VERTICAL = np.array([0.0, 0.0, 1.0])
PIN_ORDER = [0, 1, 2, 3, 4, 5, 6, 10, 7, 11, 8, 12, 9, 13]  # hub and wheel of one corner after the other


def road_wheel_angles(vehicle: Vehicle, angle: float) -> tuple[float, float]:
    """Left and right, from the turning circle through the middle of the rear axle's line."""
    chassis, share = vehicle.physics.chassis, vehicle.physics.steering.ackermann
    if angle == 0:
        return 0.0, 0.0
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    radius = wheelbase / np.tan(angle)  # positive: the centre is on the left
    half = vehicle.physics.front.track / 2
    left, right = np.arctan(wheelbase / (radius - half)), np.arctan(wheelbase / (radius + half))
    return angle + share * (left - angle), angle + share * (right - angle)


@dataclass
class Twin:
    """The car in Pinocchio, for one steering angle."""

    model: pin.Model
    data: pin.Data
    guides: list[np.ndarray]
    axles: list[Axle]
    static_loads: list[float]
    angles: list[float]

    @classmethod
    def of(cls, vehicle: Vehicle, steering: float) -> Twin:
        physics = vehicle.physics
        chassis = physics.chassis
        wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
        front_load = chassis.mass * G * chassis.cog_to_rear_axle / wheelbase / 2
        rear_load = chassis.mass * G * chassis.cog_to_front_axle / wheelbase / 2
        axles = [physics.front, physics.front, physics.rear, physics.rear]
        loads = [front_load, front_load, rear_load, rear_load]
        angles = [*road_wheel_angles(vehicle, steering), 0.0, 0.0]
        whole = pin.Inertia(
            chassis.mass, np.zeros(3), np.diag([chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia])
        )
        centres, guides, wheels, hubs = [], [], [], []
        for i, axle in enumerate(axles):
            side = 1 if i % 2 == 0 else -1
            arm = chassis.cog_to_front_axle if i < 2 else -chassis.cog_to_rear_axle
            radius = axle.unloaded_radius - loads[i] / axle.tyre_stiffness
            centres.append(np.array([arm, side * axle.track / 2, radius - chassis.cog_height]))
            # At right angles to the line from the contact point to the roll centre.
            to_roll_centre = np.array([0.0, -side * axle.track / 2, axle.roll_centre_height])
            guide = np.cross(to_roll_centre, [1.0, 0.0, 0.0]) * side
            guides.append(guide / np.linalg.norm(guide))
            wheels.append(
                pin.Inertia(
                    axle.wheel_mass,
                    np.zeros(3),
                    np.diag([axle.wheel_diametral_inertia, axle.wheel_spin_inertia, axle.wheel_diametral_inertia]),
                )
            )
            hubs.append(pin.Inertia(axle.hub_mass, np.zeros(3), np.zeros((3, 3))))
        # Whole car = chassis + hubs + wheels, solved for the chassis with 6×6 matrices, which simply add up.
        matrix = whole.matrix()
        for centre, wheel, hub in zip(centres, wheels, hubs, strict=True):
            for part in (wheel, hub):
                matrix = matrix - part.se3Action(pin.SE3(np.eye(3), centre)).matrix()
        mass = matrix[0, 0]
        lever = np.array([matrix[5, 1], matrix[3, 2], matrix[4, 0]]) / mass
        about_lever = matrix[3:, 3:] + mass * pin.skew(lever) @ pin.skew(lever)
        model = pin.Model()
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "chassis")
        model.appendBodyToJoint(root, pin.Inertia(mass, lever, about_lever), pin.SE3.Identity())
        for i in range(4):
            travel = pin.JointModelPrismaticUnaligned(guides[i])
            hub = model.addJoint(root, travel, pin.SE3(np.eye(3), centres[i]), f"hub_{i}")
            model.appendBodyToJoint(hub, hubs[i], pin.SE3.Identity())
            steer = pin.SE3(pin.exp3(VERTICAL * angles[i]), np.zeros(3))
            wheel = model.addJoint(hub, pin.JointModelRY(), steer, f"wheel_{i}")
            model.appendBodyToJoint(wheel, wheels[i], pin.SE3.Identity())
        return cls(model, model.createData(), guides, axles, loads, angles)

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Pinocchio's coordinates; wheels unturned, so that their frames are the steered ones."""
        roll, pitch, yaw = q[3:6]
        attitude = pin.Quaternion(pin.rpy.rpyToMatrix(roll, pitch, yaw)).coeffs()
        joints = np.zeros(8)
        joints[0::2] = q[6:10]
        return np.concatenate([q[:3], attitude, joints])
