"""Files that are there whole or not at all."""

from __future__ import annotations

import pytest

from vsense_ros.files.atomic import atomic_write, in_place_of


def test_who_is_interrupted_keeps_the_earlier_file(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text("earlier", encoding="utf-8")

    def interrupted() -> None:
        with atomic_write(path) as file:
            file.write("half of")
            file.flush()
            raise OSError("no room")

    with pytest.raises(OSError, match="no room"):
        interrupted()
    assert path.read_text(encoding="utf-8") == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_written_takes_the_place_of_what_a_link_points_to(tmp_path):
    path, link = tmp_path / "car.yaml", tmp_path / "link.yaml"
    path.write_text("earlier", encoding="utf-8")
    link.symlink_to(path)
    with atomic_write(link) as file:
        file.write("anew")
    assert link.is_symlink()
    assert path.read_text(encoding="utf-8") == "anew"


def test_what_is_no_file_is_written_to(tmp_path):
    with atomic_write("/dev/null") as file:
        file.write("gone")


def test_who_writes_by_the_path_and_is_interrupted_keeps_the_earlier_file_too(tmp_path):
    path = tmp_path / "fleet.parquet"
    path.write_bytes(b"earlier")

    def interrupted() -> None:
        with in_place_of(path) as fresh:
            fresh.write_bytes(b"half of")
            raise OSError("no room")

    with pytest.raises(OSError, match="no room"):
        interrupted()
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]
    with in_place_of(path) as fresh:
        fresh.write_bytes(b"anew")
    assert path.read_bytes() == b"anew"


def test_lines_end_as_they_are_written(tmp_path):
    with atomic_write(tmp_path / "road.csv") as file:
        file.write("a\r\nb\n")
    assert (tmp_path / "road.csv").read_bytes() == b"a\r\nb\n"
