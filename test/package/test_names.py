"""Names of vehicles, bags and topics are what somebody else wrote: no terminal, page, table, picture or file takes them
for more."""

from __future__ import annotations

import csv
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.bag import BagWriter, TopicDescription, read_bag
from vsense_ros.cli import main
from vsense_ros.files.names import cell, printable
from vsense_ros.messages.recording import Sample

ROOT = Path(__file__).parents[2]
EVIL = "=cmd|'x'!A1 [/b] </script><script>alert(1)</script> $\\frac{$ \x1b[31m \u202e"
FOLDER = "=cmd|'x'!A1 [b] <script>alert(1)<script> $\\frac{$ \x1b[31m"


class Scripts(HTMLParser):
    """The scripts of a page, those in attributes too."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.inside = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.inside = tag == "script"
        self.found += [""] if self.inside else []
        self.found += [value or "" for name, value in attrs if name.startswith("on")]

    def handle_endtag(self, tag: str) -> None:
        self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.found[-1] += data


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds of a drive, with two topics that nobody should have, in a folder that nobody should have."""
    path = tmp_path_factory.mktemp("names") / FOLDER
    drive = read_bag(ROOT / "bags/double_lane_change").between(0.0, 3.0)
    kind, at = "geometry_msgs/msg/Vector3Stamped", drive.start + 10**9
    with BagWriter(path) as writer:
        for sample in drive.samples(tuple(drive.channels)):
            writer.write(sample)
        for topic in (EVIL, f"x/{EVIL}"):
            writer.describe(topic, TopicDescription.of(topic, kind))
            writer.write(Sample(topic, kind, at, {"vector": np.zeros(3)}, EVIL, received=at))
    return path


@pytest.fixture(scope="module")
def car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("names") / "car.yaml"
    text = (ROOT / "config/vehicles/prototype_model.yaml").read_text(encoding="utf-8")
    path.write_text(re.sub(r"^name:.*$", lambda _: f"name: {json.dumps(EVIL)}", text, flags=re.MULTILINE))
    return path


def test_a_report_has_no_script_but_its_own_and_the_terminal_is_not_steered(
    bag: Path, car: Path, tmp_path: Path
) -> None:
    done = CliRunner().invoke(main, ["run", str(bag), "--vehicle", str(car), "--report", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "\x1b" not in done.output
    assert "\u202e" not in done.output
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    scripts = Scripts(page).found
    assert "&lt;script&gt;alert(1)" in page
    assert len(scripts) == 2  # plotly, and its call
    assert not any(script.strip() == "alert(1)" for script in scripts)


@pytest.mark.parametrize("command", ["info", "import"])
def test_commands_print_names_as_they_are(command: str, bag: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, [command, str(bag), *([str(tmp_path / "copy")] if command == "import" else [])])
    assert done.exit_code == 0, done.output
    assert "\x1b" not in done.output
    if command == "info":
        assert "[/b]" in done.output


def test_an_error_about_a_name_does_not_steer_the_terminal(tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    done = CliRunner().invoke(main, ["info", str(tmp_path / FOLDER)])
    assert done.exit_code == 2
    assert "\ufffd[31m" in done.output


@given(st.text())
def test_what_is_printed_has_no_control_characters_and_all_else(text: str) -> None:
    shown = printable(text)
    assert len(shown) == len(text)
    assert all(c in "\n\t" or c.isprintable() or ord(c) > 159 for c in shown)
    assert all(a == b for a, b in zip(text, shown, strict=True) if b != "\ufffd")


@given(st.text())
def test_no_cell_of_a_table_begins_a_formula_and_no_text_is_lost(text: str) -> None:
    shown = cell(text)
    assert shown[:1] not in ("=", "+", "-", "@", "\t", "\r")
    assert shown.removeprefix("'") == text.removeprefix("'") or shown == text


def test_the_table_of_a_fleet_begins_no_formula(tmp_path: Path) -> None:
    from vsense_ros.fleet.fleet import FAILED, NoAnswer, Result
    from vsense_ros.fleet.report import write

    found = NoAnswer(verdict=FAILED, sentence="@SUM(1)")
    write([Result(key="", vehicle="=cmd|'x'!A1", recordings=(), outcome=found)], tmp_path)
    with (tmp_path / "fleet.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert not any(str(value).startswith(("=", "@", "+")) for value in row.values())


def test_no_text_of_ours_has_markup_that_would_be_printed_as_it_stands() -> None:
    """What is to be bold is a text with a style."""
    for path in sorted((ROOT / "vsense_ros").rglob("*.py")):
        found = re.findall(r"\[/?(?:bold|dim|italic|red|green|yellow)[a-z ]*\]", path.read_text(encoding="utf-8"))
        assert not found, path
