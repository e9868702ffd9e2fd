"""tools/architecture.py: the page about the architecture and its picture, made from the code."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tool() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "tools" / "architecture.py"))


def test_every_file_that_the_page_names_exists(tool: dict[str, Any]) -> None:
    assert tool["page"]()  # raises SystemExit for one that does not


def test_the_picture_shows_every_package(tool: dict[str, Any]) -> None:
    picture = tool["picture"]()
    shown = {text.text for text in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")}
    folders = {path.parent.name for path in (ROOT / "vsense_ros").glob("*/__init__.py")}
    assert {f"{folder}/" for folder in folders} == shown - {None}


def test_an_arrow_that_follows_from_others_is_left_out(tool: dict[str, Any]) -> None:
    arrows = {"top": ["middle", "bottom", "side"], "middle": ["bottom"], "side": [], "bottom": []}
    assert tool["without_shortcuts"](arrows) == [("top", "middle"), ("top", "side"), ("middle", "bottom")]


def test_imports_within_functions_count(tool: dict[str, Any]) -> None:
    assert "mismatch" in tool["imports"]()["cli"]
