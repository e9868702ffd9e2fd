"""The real recordings, which are not part of the repository."""

from __future__ import annotations

from pathlib import Path

import pytest

from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.messages.recording import Recording


def real(name: str, file: str = "") -> Path:
    folder = datasets.data_dir() / name
    if not (folder / file).exists():
        pytest.skip(f"needs the recording {name}: set VSENSE_DATA or run 'vsense datasets'; looked in {folder}")
    return folder / file


@pytest.fixture(scope="session")
def rav4_path() -> Path:
    path = datasets.find("comma2k19_rav4")
    if path is None:
        folder = datasets.data_dir() / "comma2k19_rav4"
        pytest.skip(f"not all files of the RAV4's recording are in {folder}: 'vsense datasets fetch comma2k19_rav4'")
    return path


@pytest.fixture(scope="session")
def rav4(rav4_path: Path) -> Recording:
    return import_recording(rav4_path)


@pytest.fixture(scope="session", params=["cpg_slow_lap", "cpg_fast_lap", "med_lap_center_8_21"])
def genesis(request: pytest.FixtureRequest) -> Recording:
    return import_recording(real("genesis_oxts_can", f"{request.param}.mat"))


@pytest.fixture(scope="session")
def genesis_path() -> Path:
    return real("genesis_oxts_can", "cpg_fast_lap.mat")


@pytest.fixture(scope="session")
def vbb_path() -> Path:
    return real("racelogic_brake_stop", "ExampleBrakeStop.vbb")
