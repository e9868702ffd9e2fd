"""The commands `python -m studies`: messages and exit codes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from studies.commands import main

ROOT = Path(__file__).parents[2]


def studies(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.parametrize("command", ["accelerator", "best", "genesis", "leung", "road", "thesis"])
def test_a_folder_where_a_file_is_to_be_written_is_refused_before_any_work(command, tmp_path):
    result = studies(command, "--out", tmp_path)
    assert result.exit_code == 2
    assert "is a directory" in result.output


def test_a_table_that_leung_does_not_have_is_refused_before_any_work(tmp_path):
    result = studies("leung", "--table", "5.6", "--out", tmp_path / "leung.json")
    assert result.exit_code == 2
    assert "studies: no table '5.6'; there are: 3.4, 4.2" in result.output
    assert not list(tmp_path.iterdir())


def test_python_runs_the_commands_from_the_repository():
    command = [sys.executable, "-m", "studies", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    assert "Usage: python -m studies" in done.stdout
    assert set(main.commands) <= set(done.stdout.split())


@pytest.mark.parametrize("name", sorted(main.commands))
def test_every_command_explains_itself_with_an_example(name):
    assert f"python -m studies {name}" in studies(name, "--help").output
