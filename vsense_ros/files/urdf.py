"""A vehicle file as a URDF, for what shows a car or asks where its sensors are (RViz, Foxglove, tf2).

Joints of the wheels have the names that `vehicle/wheel_speeds` gives them, so that its messages turn them. Masses and
inertias are those of the file; the bodies that are shown are as long and as wide as wheelbase and track suggest.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from vsense_ros.files.names import harmless
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.frames import Frame, axle_of, fixed_frames, wheel_on_ground
from vsense_ros.model.parameter import Triple
from vsense_ros.model.vehicle import Vehicle

_WHEEL_WIDTH = 0.22  # [m], for the picture alone
_LARGEST_STEER = 0.8  # [rad]


def urdf(vehicle: Vehicle, prefix: str = "", base: str = "base_link") -> str:
    """The text of the URDF; `prefix` stands before the name of every link."""
    robot = Element("robot", name=harmless(vehicle.name))
    physics, chassis = vehicle.physics, vehicle.physics.chassis
    length = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    frames = fixed_frames(vehicle, base)
    SubElement(robot, "link", name=f"{prefix}{base}")
    for frame in frames:
        link = SubElement(robot, "link", name=f"{prefix}{frame.name}")
        if frame.name == "cog":
            unsprung = 2 * sum(axle.hub_mass + axle.wheel_mass for axle in (physics.front, physics.rear))
            inertia = (chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia)
            _inertial(link, chassis.mass - unsprung, inertia)
            visual = SubElement(link, "visual")
            _origin(visual, (0.5 * (chassis.cog_to_front_axle - chassis.cog_to_rear_axle), 0.0, 0.1))
            box = SubElement(SubElement(visual, "geometry"), "box")
            box.set("size", _numbers((1.5 * length, physics.front.track + _WHEEL_WIDTH, 0.9)))
        _joint(robot, f"{frame.name}_joint", "fixed", frame, prefix)
    for wheel in WHEELS:
        axle, place = axle_of(vehicle, wheel), wheel_on_ground(vehicle, wheel)
        hub, parent = f"hub_{wheel}", base
        centre: Triple = (place[0], place[1], axle.unloaded_radius)
        _inertial(SubElement(robot, "link", name=f"{prefix}{hub}"), axle.hub_mass, (0.1, 0.1, 0.1))
        if wheel.startswith("f"):
            joint = _joint(robot, f"steering_{wheel}", "revolute", Frame(hub, parent, centre), prefix)
            SubElement(joint, "axis", xyz="0 0 1")
            bound = f"{_LARGEST_STEER:g}"
            SubElement(joint, "limit", lower=f"-{bound}", upper=bound, effort="1000", velocity="10")
        else:
            _joint(robot, f"{hub}_joint", "fixed", Frame(hub, parent, centre), prefix)
        link = SubElement(robot, "link", name=f"{prefix}wheel_{wheel}")
        across = axle.wheel_diametral_inertia
        _inertial(link, axle.wheel_mass, (across, axle.wheel_spin_inertia, across))
        visual = SubElement(link, "visual")
        _origin(visual, (0.0, 0.0, 0.0), (1.570796, 0.0, 0.0))
        cylinder = SubElement(SubElement(visual, "geometry"), "cylinder")
        cylinder.set("radius", f"{axle.unloaded_radius:.6g}")
        cylinder.set("length", f"{_WHEEL_WIDTH:g}")
        joint = _joint(robot, f"wheel_{wheel}", "continuous", Frame(f"wheel_{wheel}", hub, (0.0, 0.0, 0.0)), prefix)
        SubElement(joint, "axis", xyz="0 1 0")
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(robot: Element, name: str, kind: str, frame: Frame, prefix: str) -> Element:
    joint = SubElement(robot, "joint", name=f"{prefix}{name}" if kind == "fixed" else name, type=kind)
    SubElement(joint, "parent", link=f"{prefix}{frame.parent}")
    SubElement(joint, "child", link=f"{prefix}{frame.name}")
    _origin(joint, frame.position, frame.attitude)
    return joint


def _origin(element: Element, position: Triple, attitude: Triple = (0.0, 0.0, 0.0)) -> None:
    SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers(attitude))


def _inertial(link: Element, mass: float, inertia: Triple) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "mass", value=f"{mass:.6g}")
    diagonal = dict(zip(("ixx", "iyy", "izz"), (f"{value:.6g}" for value in inertia), strict=True))
    SubElement(inertial, "inertia", {**diagonal, "ixy": "0", "ixz": "0", "iyz": "0"})


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
