"""What a tool draws of a unit: its icon, and of FMI 3 its terminals, each a group of variables that are connected
together (FMI 3.0.2, section 2.5): a sensor, what the driver does, the motion of the body, the tyres.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Protocol
from xml.etree import ElementTree

from vsense_ros.export.entries import Sensor, Variable

SIDE = 100.0  # of the icon from its middle, in the units of its coordinate system
MILLIMETRES = 0.1  # that one of these units is suggested to be drawn as
_DRIVEN = ("input", "steering", "torque")
_MEANINGS = {
    "driver": "steering and wheel torques",
    "road": "slopes of the road",
    "motion": "state of the body and its joints, and their accelerations",
    "tyres": "forces, moment, slip, angle and camber of each tyre",
    "parameters": "parameters that are estimated",
}


class Connected(Protocol):
    """What terminals are made of: the sensors and variables of a unit, which are scalars if it has no arrays."""

    sensors: list[Sensor]
    variables: list[Variable]
    scalars: bool


def write(unit: Connected, version: int, folder: Path) -> None:
    """Write the icon of a unit into the `folder` of its files, where its version of FMI expects it, and of FMI 3 the
    description of terminals."""
    icons = resources.files("vsense_ros.export").joinpath("icons")
    if version == 2:
        (folder / "model.png").write_bytes(icons.joinpath("icon.png").read_bytes())
        return
    place = folder / "terminalsAndIcons"
    place.mkdir()
    for name in ("icon.png", "icon.svg"):
        (place / name).write_bytes(icons.joinpath(name).read_bytes())
    root = described(unit)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    content = f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
    (place / "terminalsAndIcons.xml").write_text(content, encoding="utf-8")


def described(unit: Connected) -> ElementTree.Element:
    """terminalsAndIcons.xml of FMI 3."""
    sub = ElementTree.SubElement
    root = ElementTree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    graphic = sub(root, "GraphicalRepresentation")
    square = {"x1": f"{-SIDE:g}", "y1": f"{-SIDE:g}", "x2": f"{SIDE:g}", "y2": f"{SIDE:g}"}
    sub(graphic, "CoordinateSystem", square | {"suggestedScalingFactorTo_mm": f"{MILLIMETRES:g}"})
    sub(graphic, "Icon", square)
    terminals = sub(root, "Terminals")
    for name, (meaning, members) in groups(unit).items():
        # Members of one name are connected, whatever else the other unit has or lacks.
        terminal = sub(terminals, "Terminal", name=name, matchingRule="bus", description=meaning)
        for variable, member in members:
            sub(terminal, "TerminalMemberVariable", variableName=variable, memberName=member, variableKind="signal")
    return root


def groups(unit: Connected) -> dict[str, tuple[str, list[tuple[str, str]]]]:
    """Meaning of each terminal, by its name, and its variables with their names in it; time and the parameters of the
    start are in none."""
    terminals: dict[str, tuple[str, list[tuple[str, str]]]] = {}
    counted = {sensor.name for sensor in unit.sensors}
    for variable in unit.variables:
        if variable.kind not in ("INPUT", "OUTPUT"):
            continue
        name = _terminal(variable.name) if variable.name not in counted else variable.name
        _, members = terminals.setdefault(name, (_MEANINGS.get(name, f"what {name} measures"), []))
        scalars = [entry.name.lower() for entry in variable.elements] if unit.scalars else [""]
        members += [(".".join(filter(None, (variable.name, scalar))),) * 2 for scalar in scalars]
        if variable.name in counted:
            members.append((f"{variable.name}_count",) * 2)
    return terminals


def _terminal(variable: str) -> str:
    """The terminal of a variable that no sensor measures."""
    if variable in _DRIVEN:
        return "driver"
    if variable.startswith("wheel_"):
        return "tyres"
    return {"slope": "road", "estimate": "parameters"}.get(variable, "motion")
