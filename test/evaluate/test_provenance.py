"""The top of a report: where its results come from."""

from __future__ import annotations

import subprocess
from pathlib import Path

from vsense_ros.evaluate.provenance import file_hash, provenance


def test_the_hash_of_a_file_is_that_of_sha256sum(tmp_path: Path) -> None:
    file = tmp_path / "car.yaml"
    file.write_text("name: car\n", encoding="utf-8")
    expected = subprocess.run(["sha256sum", file], capture_output=True, text=True, check=True).stdout
    assert expected.startswith(file_hash(file))


def test_the_hash_of_a_folder_follows_names_and_content(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    first = tmp_path / "bag" / "a.mcap"
    first.write_bytes(b"1")
    before = file_hash(tmp_path / "bag")
    first.rename(tmp_path / "bag" / "b.mcap")
    assert file_hash(tmp_path / "bag") != before


def test_provenance_names_software_files_and_filter(tmp_path: Path) -> None:
    car = tmp_path / "car.yaml"
    car.write_text("name: car\n", encoding="utf-8")
    found = provenance(vehicle=car, recording=car, filter="error_ekf")
    assert found["software"].startswith("vsense_ros")
    assert found["filter"] == "error_ekf"
    assert file_hash(car) in found["recording"]
    assert str(car) in found["vehicle file"]
