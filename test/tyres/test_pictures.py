"""`vsense tyres`: a picture of each tyre, and one message where a file is no tyre."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from bench import FOLDER
from vsense_ros.cli import main


def test_a_tyre_file_becomes_a_picture(tmp_path):
    result = CliRunner().invoke(main, ["tyres", str(FOLDER / "fiala.yaml"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out/fiala.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["a.tir", "a.yaml"])
def test_what_is_no_tyre_ends_with_a_message(tmp_path, name):
    path = tmp_path / name
    path.write_text("hello\n", encoding="utf-8")
    result = CliRunner().invoke(main, ["tyres", str(path), "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert name in result.output
    assert "Traceback" not in result.output
