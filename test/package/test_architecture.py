"""The page about the architecture is the one that the code makes."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
AGAIN = "run: python tools/architecture.py"


@pytest.fixture(scope="module")
def tool() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "tools" / "architecture.py"))


def test_the_page_is_up_to_date_and_every_file_that_it_names_exists(tool: dict[str, Any]) -> None:
    assert (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8") == tool["page"](), AGAIN


def test_the_picture_is_up_to_date_and_shows_every_room(tool: dict[str, Any]) -> None:
    picture = (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8")
    assert picture == tool["picture"](), AGAIN
    shown = {text.text for text in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")}
    folders = {path.parent.name for path in (ROOT / "vsense_ros").glob("*/__init__.py")}
    assert {f"{folder}/" for folder in folders} == shown - {None}


def test_an_arrow_that_follows_from_others_is_left_out(tool: dict[str, Any]) -> None:
    arrows = {"top": ["middle", "bottom", "side"], "middle": ["bottom"], "side": [], "bottom": []}
    assert tool["without_shortcuts"](arrows) == [("top", "middle"), ("top", "side"), ("middle", "bottom")]


def test_imports_within_functions_count(tool: dict[str, Any]) -> None:
    assert "mismatch" in tool["imports"]()["cli"]
