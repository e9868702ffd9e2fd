"""README and docs/ name only files and commands that exist, and the commands of the tutorials run."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from vsense_ros.cli import main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
TUTORIALS = ROOT / "docs/tutorials"
LINK = re.compile(r"\]\(([^)\s#]+)(?:#[^)\s]*)?\)")
MADE_BY_THE_SITE = {"docs/reference/commands.md"}
CODE = re.compile(r"`[^`\n]+`|^ {4}.+$", re.MULTILINE)
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(?<![\w/.-])vsense ([a-z][a-z-]*)(?: ([a-z]+)\b)?((?:[^`\n#]|\\\n)*)")
OPTION = re.compile(r"(?<=\s)--[a-z][a-z-]*")


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def every_command(group: click.Group, name: str) -> Iterator[tuple[str, click.Command]]:
    for key, command in group.commands.items():
        yield f"{name} {key}", command
        if isinstance(command, click.Group):
            yield from every_command(command, f"{name} {key}")


def wrong_commands(text: str) -> list[str]:
    """Commands and options of `vsense` in the text that do not exist."""
    wrong = []
    for first, second, rest in COMMAND.findall(text):
        command = main.commands.get(first)
        if isinstance(command, click.Group) and second:
            command = command.commands.get(second)
        if command is None:
            wrong.append(f"vsense {first} {second}".strip())
            continue
        if isinstance(command, click.Group):
            continue
        known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
        wrong += [f"vsense {first} {one}" for one in OPTION.findall(rest) if one not in known | {"--help"}]
    return wrong


def test_the_readme_has_at_most_120_lines() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_file_that_a_page_links_to_exists(page: Path) -> None:
    targets = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    missing = [one for one in targets if not (page.parent / one).exists()]
    assert [one for one in missing if named((page.parent / one).resolve()) not in MADE_BY_THE_SITE] == []


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_command_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert wrong_commands("\n".join([*CODE.findall(text), *BLOCK.findall(text)])) == []


def test_every_test_that_the_page_about_security_names_exists() -> None:
    named_tests = set(re.findall(r"`(test_\w+)`", (ROOT / "SECURITY.md").read_text(encoding="utf-8")))
    there = {
        name for file in (ROOT / "test").rglob("test_*.py") for name in re.findall(r"def (test_\w+)", file.read_text())
    }
    assert len(named_tests) > 20
    assert named_tests <= there


def test_every_command_that_a_help_text_names_exists() -> None:
    wrong = {}
    for name, command in [("vsense", main), *every_command(main, "vsense")]:
        text = command.get_help(click.Context(command, info_name=name, max_content_width=400))
        if missing := wrong_commands(text):
            wrong[name] = missing
    assert wrong == {}


def test_every_command_has_a_heading_and_its_whole_summary() -> None:
    text = CliRunner().invoke(main, ["--help"], terminal_width=80).output
    assert "Other:" not in text
    assert max(map(len, text.splitlines())) <= 80
    words = " ".join(text.split())
    assert [name for name, one in main.commands.items() if f"{name} {one.get_short_help_str(1000)}" not in words] == []


def test_the_list_of_filters_has_at_most_80_columns_also_in_a_file() -> None:
    text = CliRunner().invoke(main, ["filters", "--all"]).output
    assert max(map(len, text.splitlines())) <= 80


def test_the_help_of_simulate_lists_the_manoeuvres() -> None:
    words = re.split(r"[\s,]+", CliRunner().invoke(main, ["simulate", "--help"], terminal_width=80).output)
    assert {"double_lane_change", "hills", "lane_change_35", "dg_100"} <= set(words)


def test_a_command_that_does_not_exist_is_noticed() -> None:
    assert wrong_commands("`vsense estimate`") == ["vsense estimate"]
    assert wrong_commands("vsense run lap --no-such-option") == ["vsense run --no-such-option"]
    assert wrong_commands("vsense export d prototype_model") == ["vsense export d"]
    assert wrong_commands("the `vsense_ros` package, vsense run lap --vehicle genesis") == []


def run_blocks(page: Path, folder: Path) -> None:
    """Run the shell commands of a page one after the other, in a folder that has what a clone has."""
    for name in ("bags", "config", "docs"):
        (folder / name).symlink_to(ROOT / name)
    script = folder / "bin/vsense"
    script.parent.mkdir()
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m vsense_ros.cli "$@"\n', encoding="utf-8")
    script.chmod(0o755)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{script.parent}{os.pathsep}{os.environ['PATH']}"}
    commands = "".join(BLOCK.findall(page.read_text(encoding="utf-8")))
    assert commands
    done = subprocess.run(
        ["bash", "-euc", commands], cwd=folder, env=environment, capture_output=True, text=True, timeout=2000
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_the_commands_of_the_first_tutorial_run(tmp_path: Path) -> None:
    run_blocks(TUTORIALS / "first_estimate.md", tmp_path)
    results = tmp_path / "out/run/double_lane_change"
    for name in ("report.html", "picture.png", "picture.svg", "output", "summary.json"):
        assert (results / name).exists()


@pytest.mark.exam
@pytest.mark.timeout(1500)
def test_the_commands_about_the_genesis_run_and_name_what_the_tutorial_quotes(tmp_path: Path) -> None:
    from vsense_ros.bag import datasets
    from vsense_ros.mismatch.answer_schema import read_answer

    if datasets.find("genesis_oxts_can") is None:
        pytest.skip("the laps of the Genesis are not here: `vsense datasets fetch genesis_oxts_can`")
    run_blocks(TUTORIALS / "disagree.md", tmp_path)
    answer = read_answer(tmp_path / "out/genesis")
    assert (answer.verdict, set(answer.answer_set)) == ("named", {"road_bank", "steering_ratio"})


@pytest.mark.exam
@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs/reference/python.md"], ids=named)
def test_the_first_python_of_a_page_runs(page: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    if "to_pandas" in page.read_text(encoding="utf-8"):
        pytest.importorskip("pandas")
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    block = re.search(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert block
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", block[1]], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "lap.png").exists()
    assert list(tmp_path.glob("lap*.csv"))


@pytest.mark.exam
@pytest.mark.timeout(2400)
def test_the_commands_of_the_tutorial_about_your_car_run(tmp_path: Path) -> None:
    run_blocks(TUTORIALS / "your_car.md", tmp_path)
    errors = {}
    for name in ("by_catalogue", "identified_run"):
        summary = json.loads((tmp_path / "out" / name / "summary.json").read_text(encoding="utf-8"))
        errors[name] = summary["drive_3"]["signals"]["side_slip"]["rmse"]
    assert errors["identified_run"] < errors["by_catalogue"]


@pytest.mark.exam
@pytest.mark.timeout(1500)
def test_the_commands_that_export_the_observer_run(tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    run_blocks(TUTORIALS / "simulink_or_c.md", tmp_path)


@pytest.mark.exam
def test_the_site_is_built_without_a_dead_link_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    loaded = re.compile(r'<(?:script|img|iframe)[^>]+src="https?:|<link[^>]+rel="stylesheet"[^>]+href="https?:')
    for page in (tmp_path / "index.html", tmp_path / "reference/commands.html", tmp_path / "mismatch.html"):
        assert not loaded.search(page.read_text(encoding="utf-8"))
