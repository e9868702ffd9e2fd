"""An importer is one file: once it stands in the folder, everything that reads recordings knows its format."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from vsense_ros.bag import importers, read_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError

IMPORTER = '''
"""Wheel speeds, one line a second, of a data logger that nobody ever built."""
import numpy as np
from vsense_ros.messages.recording import Channel, Recording

NAME = "spinning"
DESCRIPTION = "wheel speeds of the Spinning logger (.txt)"

def matches(path):
    return path.is_file() and path.read_bytes().startswith(b"spinning")

def read(path, *, ratio=1.0):
    values = np.array([[float(word) for word in line.split()] for line in path.read_text().splitlines()[1:]])
    stamp = np.arange(len(values), dtype=np.int64) * 1_000_000_000
    empty = np.zeros((len(values), 0))
    columns = {"position": empty, "velocity": ratio * values, "effort": empty}
    names = tuple(f"wheel_{wheel}" for wheel in ("fl", "fr", "rl", "rr"))
    channel = Channel("vehicle/wheel_speeds", "sensor_msgs/msg/JointState", stamp, stamp, columns, "", names)
    return Recording({channel.topic: channel}, name=path.stem)
'''


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A log of a format whose importer has just been written."""
    (tmp_path / "added").mkdir()
    (tmp_path / "added" / "spinning.py").write_text(IMPORTER)
    monkeypatch.setattr(importers, "__path__", [*importers.__path__, str(tmp_path / "added")])
    path = tmp_path / "drive.txt"
    path.write_text("spinning\n10 10 11 11\n12 12 13 13\n")
    yield path
    sys.modules.pop("vsense_ros.bag.importers.spinning", None)


def test_its_recordings_are_imported_with_its_options(log: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["import", str(log), str(tmp_path / "bag"), "--option", "ratio=2"])
    assert result.exit_code == 0, result.output
    assert read_bag(tmp_path / "bag")["vehicle/wheel_speeds"].columns["velocity"].tolist() == [
        [20.0, 20.0, 22.0, 22.0],
        [24.0, 24.0, 26.0, 26.0],
    ]


def test_other_commands_read_them_without_an_import(log: Path) -> None:
    result = CliRunner().invoke(main, ["info", str(log)])
    assert result.exit_code == 0, result.output
    assert "vehicle/wheel_speeds" in result.output


def test_it_is_asked_before_those_that_judge_by_the_ending(log: Path) -> None:
    assert importers.find_importer(log).name == "spinning"


def test_it_is_listed_where_a_format_is_unknown(log: Path) -> None:
    other = log.with_suffix(".unknown")
    other.touch()
    with pytest.raises(InputError, match=r"spinning: wheel speeds of the Spinning logger"):
        importers.find_importer(other)


@pytest.mark.parametrize(
    ("name", "tool"),
    [("lap.ld", "i2 exports"), ("rlog.zst", "LogReader"), ("qlog", "LogReader"), ("a.ncom", "NAVsolve")],
)
def test_a_format_that_is_not_read_is_named_with_what_converts_it(name: str, tool: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(InputError, match=tool):
        importers.find_importer(path)
