"""The URDF and the frames of a car, against what its file says."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vsense_ros.files.installed import shared_folder
from vsense_ros.files.names import harmless
from vsense_ros.files.urdf import urdf
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.frames import fixed_frames

VEHICLES = sorted((shared_folder("config") / "vehicles").glob("*.yaml"))


def places(text: str, joints: dict[str, float]) -> dict[str, np.ndarray]:
    """Each link's pose (4, 4) in the root, by following the joints; turning ones by their angles [rad]."""
    robot = ElementTree.fromstring(text)
    of_child = {}
    for joint in robot.iter("joint"):
        origin = joint.find("origin")
        pose = np.eye(4)
        pose[:3, 3] = [float(v) for v in origin.get("xyz").split()]
        turned = Rotation.from_euler("xyz", [float(v) for v in origin.get("rpy").split()])
        if joint.get("type") in ("revolute", "continuous"):
            axis = np.array([float(v) for v in joint.find("axis").get("xyz").split()])
            turned *= Rotation.from_rotvec(axis * joints.get(joint.get("name"), 0.0))
        pose[:3, :3] = turned.as_matrix()
        of_child[joint.find("child").get("link")] = (joint.find("parent").get("link"), pose)

    def of(link: str) -> np.ndarray:
        if link not in of_child:
            return np.eye(4)
        parent, pose = of_child[link]
        return of(parent) @ pose

    return {link.get("name"): of(link.get("name")) for link in robot.iter("link")}


@pytest.mark.parametrize("path", VEHICLES, ids=lambda p: p.stem)
def test_one_tree_holds_the_wheels_and_the_sensors_where_the_file_has_them(path) -> None:
    car = load_vehicle(path)
    found = places(urdf(car, "c/"), {"steering_fl": 0.3})
    robot = ElementTree.fromstring(urdf(car, "c/"))
    children = [j.find("child").get("link") for j in robot.iter("joint")]
    assert len(children) == len(set(children)) == len(found) - 1, "no tree"
    chassis, front, rear = car.physics.chassis, car.physics.front, car.physics.rear
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    np.testing.assert_allclose(found["c/wheel_fl"][:3, 3], [wheelbase, front.track / 2, front.unloaded_radius], 1e-5)
    np.testing.assert_allclose(found["c/wheel_rr"][:3, 3], [0, -rear.track / 2, rear.unloaded_radius], 1e-5, 1e-9)
    np.testing.assert_allclose(found["c/wheel_fl"][:2, 0], [np.cos(0.3), np.sin(0.3)], 1e-6)
    cog = np.array([chassis.cog_to_rear_axle, 0, chassis.cog_height])
    for sensor in car.sensors.values():
        if sensor.frame_id in ("", "map"):
            continue
        np.testing.assert_allclose(found[f"c/{sensor.frame_id}"][:3, 3], cog + sensor.position, 1e-5, 1e-6)
        if hasattr(sensor, "attitude"):
            turned = Rotation.from_matrix(found[f"c/{sensor.frame_id}"][:3, :3]).as_euler("xyz")
            np.testing.assert_allclose(turned, sensor.attitude, 1e-4, 1e-6)
    assert {f"c/{frame.name}" for frame in fixed_frames(car)} <= set(found)


def test_masses_of_the_links_are_that_of_the_car() -> None:
    car = load_vehicle(VEHICLES[0])
    robot = ElementTree.fromstring(urdf(car))
    assert sum(float(m.get("value")) for m in robot.iter("mass")) == pytest.approx(car.physics.chassis.mass, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Toyota RAV4 (2017)", "Toyota RAV4 (2017)"),
        ("a \\\n#include <x>", "a ___include _x_"),
        ("*/ int main(", "__ int main("),
        ("=cmd|'/c calc'!A0", "_cmd___c calc__A0"),
        ("../../etc/passwd", "_.._etc_passwd"),
        ("Škoda Citroën", "Škoda Citroën"),
        ("\x00", "_"),
        ("", "unnamed"),
    ],
)
def test_names_mean_nothing_to_compilers_shells_and_spreadsheets(name: str, expected: str) -> None:
    found = harmless(name)
    assert not set(found) & set("\\\n\r\t*/'\"`$;|&<>=@!#%{}")
    assert not found.startswith(("=", "+", "-", "@", ".", " "))
    assert found == expected
