"""Public datasets: where they are found, and what is said when they cannot be had. Nothing here uses a network."""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import SimpleNamespace

import pooch
import pytest

from vsense_ros.bag import datasets
from vsense_ros.bag.importers import find_importer
from vsense_ros.errors import InputError


@pytest.mark.parametrize("name", sorted(datasets.DATASETS))
def test_the_files_here_are_those_that_are_published(name: str) -> None:
    entry = datasets.find(name)
    if entry is None:
        pytest.skip(f"needs the recording {name}: set VSENSE_DATA or run 'vsense datasets'")
    for file in datasets.DATASETS[name].files:
        found = (datasets.data_dir() / name / file.path).read_bytes()
        assert hashlib.sha256(found).hexdigest() == file.sha256
    assert find_importer(entry).name != ""
    assert datasets.fetch(name) == entry


def test_the_environment_names_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VSENSE_DATA", str(tmp_path))
    assert datasets.data_dir() == tmp_path
    assert datasets.find("racelogic_brake_stop") is None


def test_without_a_folder_the_cache_of_the_user_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("VSENSE_DATA", raising=False)
    monkeypatch.setattr(datasets, "_REPOSITORY", tmp_path / "a" / "b")
    assert datasets.data_dir() == Path(pooch.os_cache("vsense_ros"))


def test_addresses_are_pinned_to_a_commit() -> None:
    for dataset in datasets.DATASETS.values():
        for file in dataset.files:
            host, _, rest = file.url.removeprefix("https://").partition("/")
            assert host == "raw.githubusercontent.com"
            assert len(rest.split("/")[2]) == 40
            assert "|" not in file.url


def test_an_unknown_name_is_an_input_error_that_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="comma2k19_rav4, genesis_oxts_can, racelogic_brake_stop"):
        datasets.fetch("nurburgring")


def test_without_a_network_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def offline(*_: object, **__: object) -> None:
        raise ConnectionError("no route to host")

    monkeypatch.setenv("VSENSE_DATA", str(tmp_path))
    monkeypatch.setattr(pooch, "retrieve", offline)
    with pytest.raises(InputError, match=r"cannot be downloaded .* Check the network .* set VSENSE_DATA"):
        datasets.fetch("racelogic_brake_stop")


def test_a_file_that_is_not_the_published_one_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VSENSE_DATA", str(tmp_path))
    (tmp_path / "racelogic_brake_stop").mkdir()
    (tmp_path / "racelogic_brake_stop" / "ExampleBrakeStop.vbb").write_bytes(b"<html>")
    with pytest.raises(InputError, match="not the published file"):
        datasets.fetch("racelogic_brake_stop")


def test_missing_files_are_fetched_by_checksum_and_progress_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked = []

    def retrieve(url: str, known_hash: str, fname: str, path: Path) -> str:
        asked.append(SimpleNamespace(url=url, known_hash=known_hash))
        (path / fname).write_bytes(b"data")
        return str(path / fname)

    monkeypatch.setenv("VSENSE_DATA", str(tmp_path))
    monkeypatch.setattr(pooch, "retrieve", retrieve)
    told: list[tuple[str, int, int]] = []
    entry = datasets.fetch("genesis_oxts_can", lambda *progress: told.append(progress))
    assert entry == tmp_path / "genesis_oxts_can" / "med_lap_center_8_21.mat"
    assert len(asked) == 3
    assert all(request.known_hash.startswith("sha256:") for request in asked)
    assert told[-1] == ("", 3, 3)
