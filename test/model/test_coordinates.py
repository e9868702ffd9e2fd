"""The order of coordinates, velocities, inputs and disturbances stands in one file."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import vsense_ros
from vsense_ros.model import coordinates as c

PACKAGE = Path(vsense_ros.__file__).parent
FOLDERS = ("../studies", "assess", "evaluate", "manoeuvre", "model/car", "model/effects", "model/simulation")
VECTORS = {"q", "u", "udot", "inputs", "force", "disturbances"}  # names that the vectors have everywhere


def bare_indices(source: str) -> list[str]:
    """Subscripts of vectors of the car with a number in them; of arrays over time, in their columns."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Subscript):
            continue
        vector = getattr(node.value, "attr", getattr(node.value, "id", ""))
        columns = node.slice.elts[1:] if isinstance(node.slice, ast.Tuple) else [node.slice]
        parts = [part for column in columns for part in ast.walk(column) if isinstance(part, ast.Constant)]
        if vector in VECTORS and any(isinstance(part.value, int) for part in parts):
            found.append(ast.unparse(node))
    return found


@pytest.mark.parametrize("folder", FOLDERS)
def test_nobody_else_refers_to_a_coordinate_by_its_number(folder):
    files = sorted((PACKAGE / folder).glob("*.py"))
    assert files
    found = {path.name: bare for path in files if (bare := bare_indices(path.read_text(encoding="utf-8")))}
    assert not found


def test_a_bare_index_would_be_found():
    source = "car.u[5] + q[3:6] + motion.u[:, 1] + inputs[1 + i]"
    assert set(bare_indices(source)) == {"car.u[5]", "q[3:6]", "motion.u[:, 1]", "inputs[1 + i]"}
    assert not bare_indices("car.u[YAW_RATE] + q[TRAVEL][i] + motion.u[0, YAW]")


def test_the_names_cover_each_vector_once():
    every = np.arange(c.COORDINATES)
    assert [*every[c.POSITION], *every[c.ATTITUDE], *every[c.TRAVEL], *every[c.SPIN]] == list(every)
    assert [*every[c.VELOCITY], *every[c.RATES], *every[c.TRAVEL], *every[c.SPIN]] == list(every)
    assert list(every[c.POSE]) == [c.X, c.Y, c.Z, c.ROLL, c.PITCH, c.YAW]
    assert list(every[c.TWIST]) == [c.SPEED_X, c.SPEED_Y, c.SPEED_Z, c.ROLL_RATE, c.PITCH_RATE, c.YAW_RATE]
    assert c.INPUTS[c.STEERING] == "steering"
    assert c.INPUTS[c.TORQUES] == tuple(f"torque_{wheel}" for wheel in c.WHEELS)
    places = {name: getattr(c, name.upper()) for name in c.DISTURBANCES}
    assert [c.DISTURBANCES[place] for place in places.values()] == list(places)
    assert [c.WHEEL_OUTPUTS[row] for row in (c.FORCE_X, c.FORCE_Y, c.FORCE_Z, c.MOMENT)] == [
        "force_x", "force_y", "force_z", "moment",
    ]  # fmt: skip
