"""Large files are read in pieces: what comes out is what the whole gives, in memory that does not grow with them."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from recordings import formats
from vsense_ros.bag import importers, read_bag
from vsense_ros.bag.importers import import_pieces, import_recording
from vsense_ros.bag.join import concatenated
from vsense_ros.bag.writing import write_pieces
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importers, "LARGE", replace(importers.LARGE, from_size=1 << 12, piece=1 << 13))


def same(one: Recording, other: Recording) -> bool:
    return one.channels.keys() == other.channels.keys() and all(
        np.array_equal(channel.stamp, other[topic].stamp)
        and all(np.array_equal(v, other[topic].columns[f], equal_nan=True) for f, v in channel.columns.items())
        for topic, channel in one.channels.items()
    )


def whole_of(pieces: list[Recording]) -> Recording:
    return replace(pieces[0], channels=concatenated(pieces))


def test_the_pieces_of_a_table_are_the_whole_one(tmp_path: Path) -> None:
    path, options = formats.csv(tmp_path, 20.0)
    pieces = list(import_pieces(path, **options))
    assert len(pieces) > 10
    assert same(whole_of(pieces), import_recording(path, **options))
    write_pieces(tmp_path / "bag", pieces)
    assert same(read_bag(tmp_path / "bag"), import_recording(path, **options))


@pytest.mark.parametrize("name", ["candump", "asc", "blf", "trc", "gvret", "mdf4_bus"])
def test_the_pieces_of_a_can_log_are_the_whole_one(tmp_path: Path, name: str) -> None:
    path, options = formats.MAKERS[name](tmp_path, 4.0)
    pieces = [piece for piece in import_pieces(path, **options) if piece.channels]
    whole = import_recording(path, **options)
    assert len(pieces) > 4
    assert same(whole_of(pieces), whole)
    assert not {note for piece in pieces for note in piece.notes} - set(whole.notes)


@pytest.mark.parametrize("name", ["mcap", "sqlite3", "sqlite3_packed_messages", "mcap_packed_file"])
def test_the_pieces_of_a_bag_are_the_whole_one(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importers, "LARGE", replace(importers.LARGE, from_size=1 << 12, piece=1 << 16))
    path, _ = formats.MAKERS[name](tmp_path, 60.0)
    pieces = [piece for piece in import_pieces(path) if piece.channels]
    whole = import_recording(path)
    assert len(pieces) > (0 if name == "mcap_packed_file" else 3)
    assert same(whole_of(pieces), whole)
    assert not {note for piece in pieces for note in piece.notes} - set(whole.notes)
    renamed = {"topics": {"imu/data": "/imu/data", "gps/velocity": "/gps/velocity"}}
    assert same(whole_of(list(import_pieces(path, mapping=renamed))), whole)
    with pytest.raises(InputError, match="the bag has no topic '/none' for imu/data"):
        list(import_pieces(path, mapping={"topics": {"imu/data": "/none"}}))


def test_a_bag_that_was_cut_gives_in_pieces_what_it_gives_as_a_whole(tmp_path: Path) -> None:
    folder, _ = formats.MAKERS["mcap"](tmp_path, 60.0)
    path = next(folder.glob("*.mcap"))
    path.write_bytes(path.read_bytes()[:-5000])
    pieces = list(import_pieces(path))
    assert same(whole_of([piece for piece in pieces if piece.channels]), import_recording(path))
    assert any("is not finished" in note for note in pieces[-1].damage)


def test_messages_that_never_came_are_noted_at_the_end_of_a_can_log(tmp_path: Path) -> None:
    path, options = formats.MAKERS["candump"](tmp_path, 4.0)
    lines = [line for line in path.read_text().splitlines(True) if " 302#" not in line]
    path.write_text("".join(lines))
    assert any("never came: WHEELS" in note for note in list(import_pieces(path, **options))[-1].notes)
    path.write_text("".join(lines).replace(" 300#", " 301#"))
    with pytest.raises(InputError, match="none of the messages that the mapping uses"):
        list(import_pieces(path, **options))


def test_a_last_line_that_was_cut_and_an_end_without_rows_are_no_pieces(tmp_path: Path) -> None:
    path, options = formats.csv(tmp_path, 20.0)
    whole = import_recording(path, **options)
    data = path.read_bytes()
    path.write_bytes(data + b"\n\n\n")
    assert same(whole_of(list(import_pieces(path, **options))), whole)
    path.write_bytes(data[:-5])
    pieces = list(import_pieces(path, **options))
    assert sum(len(piece["imu/data"]) for piece in pieces) == len(whole["imu/data"]) - 1
    assert any("is cut" in note for note in pieces[0].notes)


def test_times_of_day_go_on_over_midnight_and_a_topic_may_be_absent_for_a_while(tmp_path: Path) -> None:
    path = tmp_path / "night.csv"
    seconds = 86_000 + np.arange(2000) * 0.5
    with path.open("w") as file:
        file.write("clock,speed,yaw rate\n")
        for number, second in enumerate(seconds % 86_400):
            clock = f"{int(second // 3600):02d}:{int(second // 60 % 60):02d}:{second % 60:04.1f}"
            file.write(f"{clock},{'' if 500 < number < 1500 else 20 + number % 7},{number % 5}\n")
    mapping = {
        "time": {"column": "clock", "unit": "hms", "start": "2024-05-01"},
        "topics": {
            "vehicle/velocity": {"speed": {"column": "speed", "unit": "km/h"}},
            "imu/data": {"angular_velocity": [None, None, {"column": "yaw rate", "unit": "deg/s"}]},
        },
    }
    pieces = list(import_pieces(path, mapping=mapping))
    assert any("vehicle/velocity" not in piece for piece in pieces)
    assert same(whole_of(pieces), import_recording(path, mapping=mapping))
    topics = {**mapping["topics"], "gps/fix": {"latitude": {"column": "none", "unit": "deg"}}}
    with pytest.raises(InputError, match="no column 'none'"):
        list(import_pieces(path, mapping={**mapping, "topics": topics}))


def test_an_error_names_the_line_of_the_file_and_leaves_no_bag(tmp_path: Path) -> None:
    path, options = formats.csv(tmp_path, 20.0)
    lines = path.read_text().splitlines()
    lines[1500] = lines[1500].replace("72.0000000", "fast")
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"line 1501, column 'speed': expected a number, found 'fast'"):
        write_pieces(tmp_path / "bag", import_pieces(path, **options))
    assert not (tmp_path / "bag").exists()


def test_a_clock_that_goes_back_between_pieces_is_refused(tmp_path: Path) -> None:
    path, options = formats.csv(tmp_path, 20.0)
    rows = path.read_text().splitlines()
    moved = [f"{float(row.partition(',')[0]) + 100:.7f},{row.partition(',')[2]}" for row in rows[1:]]
    path.write_text("\n".join([rows[0], *moved, *rows[1:]]) + "\n")
    with pytest.raises(InputError, match="its clock goes back"):
        list(import_pieces(path, **options))


def test_the_command_imports_a_large_table_and_says_what_it_inspected(tmp_path: Path) -> None:
    path, options = formats.csv(tmp_path, 20.0)
    (tmp_path / "drive.yaml").write_text(yaml.safe_dump(options["mapping"]))
    done = CliRunner().invoke(main, ["import", str(path), str(tmp_path / "bag")])
    assert done.exit_code == 0, done.output
    assert "first 1 s are inspected" in " ".join(done.output.split())
    assert same(read_bag(tmp_path / "bag"), import_recording(path, **options))


@pytest.mark.exam
@pytest.mark.parametrize("name", ["csv", "mcap"])
def test_the_memory_of_an_import_does_not_grow_with_the_file(tmp_path: Path, name: str) -> None:
    """20 MB of text and 60 MB, or a bag three times as long, in pieces of 4 MiB, by the peak that the kernel keeps of a
    process."""
    _, options = formats.MAKERS[name](tmp_path, 1.0)
    (tmp_path / "options.yaml").write_text(yaml.safe_dump(options.get("mapping")))
    code = (
        "import sys\n"
        "from dataclasses import replace\n"
        "from vsense_ros.bag import importers\n"
        "from vsense_ros.bag.writing import write_pieces\n"
        "importers.LARGE = replace(importers.LARGE, from_size=0, piece=4 << 20)\n"
        "path, mapping, out = sys.argv[1:]\n"
        "write_pieces(out, importers.import_pieces(path, **({'mapping': mapping} if mapping else {})))\n"
        "lines = open('/proc/self/status').read().splitlines()\n"
        "print(next(line.split()[1] for line in lines if line.startswith('VmHWM')))\n"
    )
    used = []
    for seconds in (3000.0, 9000.0):
        path, _ = formats.MAKERS[name](tmp_path, seconds)
        mapping = str(tmp_path / "options.yaml") if options else ""
        command = [sys.executable, "-c", code, str(path), mapping, str(tmp_path / f"{seconds}")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=True)
        used.append(int(done.stdout) * 1024)
    assert used[1] < 1.15 * used[0]
    assert used[1] < 500 << 20
