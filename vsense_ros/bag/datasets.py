"""The public recordings: where they are, what they must be (SHA-256), and how they come here.

They stay what their authors published; the project does not redistribute them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote

from vsense_ros.cache import user_folder
from vsense_ros.errors import InputError

_REPOSITORY = Path(__file__).resolve().parents[2]
_ENVIRONMENT = "VSENSE_DATA"
_NEIGHBOUR = Path("../shared/recordings")


@dataclass(frozen=True)
class File:
    """One file of a dataset: its place in the dataset's folder, its public address, its SHA-256."""

    path: str
    url: str
    sha256: str


@dataclass(frozen=True)
class Dataset:
    """A public recording."""

    name: str
    title: str
    licence: str
    source: str
    entry: str  # what to give to an importer, relative to the dataset's folder
    files: tuple[File, ...]


def _raw(repository: str, commit: str, path: str) -> str:
    return f"https://raw.githubusercontent.com/{repository}/{commit}/{quote(path)}"


_COMMA_FILES = (
    ("global_pose/frame_gps_times", "e275dc136ac742a58191ca58b103e5361246197a241647bc07b1f928395fc5b4"),
    ("global_pose/frame_orientations", "0eee212a8a1e6cc79978d84217aba068bd3ab9f441a6c1eebb51052ba698d1bb"),
    ("global_pose/frame_positions", "85864c9632030f5b6f0a6a8a78f2c9079e7555725d38a28ae029ed5dd4fc9057"),
    ("global_pose/frame_times", "2bec8428f9302b30a7edef3b86de0bc797c77e6964f404b3d982af1ce4dfcb5d"),
    ("global_pose/frame_velocities", "2e2a3b5d222153b440db70b34ea91e4f0eda661d4b139f16d7b057754cd978c2"),
    ("processed_log/CAN/raw_can/address", "581d1e63b955b1218b3c4d667878e2c30f67c979df2c5b046f76c4741be0dd5e"),
    ("processed_log/CAN/raw_can/data", "04842858174a318e441f6a1e3f38583d52be135327a43de1e51750ce5cea4938"),
    ("processed_log/CAN/raw_can/src", "c2ac62cdcb420cd416073f3c30eaaefb51307f2a6ab45e0e4f86eca09c14a935"),
    ("processed_log/CAN/raw_can/t", "57ee5a9875ac96c08e0e5be94a6e4529fa46bb675cbed1727837f98bcafbba79"),
    ("processed_log/CAN/speed/t", "53d2a88becfc45f9dcb804f2f78436f2bb6246d80386ff18ded10af679d5d6f3"),
    ("processed_log/CAN/speed/value", "ba40ded2c9d2a6d5f98801f5438d0cb5d811ccf1444e3a3f680d7addb707551f"),
    ("processed_log/CAN/steering_angle/t", "eb489c74b52cebccd30b803860d70aaafc44801a44b93e72585d602a982dbfc7"),
    ("processed_log/CAN/steering_angle/value", "6af86fe2fce790c6d3a51d512c625e4766699f473ec13207ea043c08d83a6bea"),
    ("processed_log/CAN/wheel_speed/t", "53d2a88becfc45f9dcb804f2f78436f2bb6246d80386ff18ded10af679d5d6f3"),
    ("processed_log/CAN/wheel_speed/value", "021dd8d0ac5029b34d3d2ddfc53c2654944baf57da4cb45d7ac4b0f995c69d2f"),
    ("processed_log/GNSS/live_gnss_qcom/t", "b6235345d9e056975660a6f8bba19281d2e3a3f40f614a3df9cd319bd7ab528b"),
    ("processed_log/GNSS/live_gnss_qcom/value", "1b544d6597976d494c40bddcbc36fc3020f7b00611dee7f4ba452200db0ea428"),
    ("processed_log/GNSS/live_gnss_ublox/t", "238794a8b336a9dc69e6787116d6e8fe4ce9013e4f454ca2bcde010b43011e95"),
    ("processed_log/GNSS/live_gnss_ublox/value", "1136d8819a640d482c06ed6460efdb84a625ddf765ed581b1cf28f030dabfff3"),
    ("processed_log/GNSS/raw_gnss_qcom/t", "b994638a16fc14c8b5561ce2e50a342490f722eab7c618eb2aec50f51522099e"),
    ("processed_log/GNSS/raw_gnss_qcom/value", "9c0b72b83ab20617fe774ac3dcf23fe24f597ab2112a3b908d6539149295fdf4"),
    ("processed_log/GNSS/raw_gnss_ublox/t", "1189929515072dbb3f2b87a4cca60fdf8d62f03ae20e448c6ed62aeb10438562"),
    ("processed_log/GNSS/raw_gnss_ublox/value", "369d0a467aad1a45b8d7910629c282d15f7d421dd8f33b34bc02ba97ac909576"),
    ("processed_log/IMU/accelerometer/t", "9df28fe965d5936bb91a020b688e35304ee4b823e388cb814d077b1f934a8558"),
    ("processed_log/IMU/accelerometer/value", "313949234c212c4f02b0a7c5f1c14173ac2b4dac50297782f50dc4e43fc9579b"),
    ("processed_log/IMU/gyro/t", "9df28fe965d5936bb91a020b688e35304ee4b823e388cb814d077b1f934a8558"),
    ("processed_log/IMU/gyro/value", "7af1d2f8b2ec8b78a0af59dde3a3e40bf8a8d425fb0c96a7fc71cadc0830b50c"),
    ("processed_log/IMU/gyro_bias/t", "9df28fe965d5936bb91a020b688e35304ee4b823e388cb814d077b1f934a8558"),
    ("processed_log/IMU/gyro_bias/value", "1c3dce954b63d437c16c76d7c1df91ea4c8c58fb8edcc06e5c3de5cee35d9859"),
    ("processed_log/IMU/gyro_uncalibrated/t", "9df28fe965d5936bb91a020b688e35304ee4b823e388cb814d077b1f934a8558"),
    ("processed_log/IMU/gyro_uncalibrated/value", "7f0020194f66c06922d3b34890407db3790da5a83a6e6c9c0b0f01d8f19e279c"),
    ("processed_log/IMU/magnetometer/t", "6dd128290581bbd86f6998eb4fc4590c7e1300dab9eafc938ccd72a100b34bbb"),
    ("processed_log/IMU/magnetometer/value", "3561b468184a4ae695f7fc1e11c96d1032e5bb725b85b29cc05fcbd943ffc901"),
    (
        "processed_log/IMU/magnetometer_uncalibrated/t",
        "6dd128290581bbd86f6998eb4fc4590c7e1300dab9eafc938ccd72a100b34bbb",
    ),
    (
        "processed_log/IMU/magnetometer_uncalibrated/value",
        "93db4146db941251fc6c8c8cde4351140e7b8b053e906afc010e0830afc6cbc9",
    ),
)
_COMMA_COMMIT = "4c7f1a6e1957745beadc1def0e7225f559b09a2a"
_COMMA_SEGMENT = "Example_1/b0c9d2329ad1606b|2018-08-02--08-34-47/40"
_GENESIS_MASTER = "7f62ff6d1d16bcfef317181575305811b9460e8a"

DATASETS: Mapping[str, Dataset] = MappingProxyType(
    {
        dataset.name: dataset
        for dataset in (
            Dataset(
                "comma2k19_rav4",
                "Toyota RAV4 2017 on a public highway, 60 s: raw CAN, phone IMU, u-blox GNSS, pose reference",
                "MIT",
                "https://github.com/commaai/comma2k19",
                "segment",
                (
                    *(
                        File(
                            f"segment/{path}", _raw("commaai/comma2k19", _COMMA_COMMIT, f"{_COMMA_SEGMENT}/{path}"), sha
                        )
                        for path, sha in _COMMA_FILES
                    ),
                    File(
                        "toyota_rav4_2017_pt_generated.dbc",
                        _raw(
                            "commaai/opendbc",
                            "dd036a99161bb41106298748871eaaaca49c273a",
                            "toyota_rav4_2017_pt_generated.dbc",
                        ),
                        "f22798c8cc6c05299209ca7b309077aa8472011a8ddc7ce0bb235308ecfe815a",
                    ),
                ),
            ),
            Dataset(
                "genesis_oxts_can",
                "Hyundai Genesis on a proving-ground road, three laps: CAN signals and OxTS reference",
                "MIT",
                "https://github.com/MPC-Berkeley/genesis_path_follower",
                "med_lap_center_8_21.mat",
                tuple(
                    File(name, _raw("MPC-Berkeley/genesis_path_follower", commit, f"paths/{name}"), sha)
                    for name, commit, sha in (
                        (
                            "cpg_slow_lap.mat",
                            _GENESIS_MASTER,
                            "7b8692e43d4ccc2ee11ec302d479e9dc15adfb1cbcef94bc6bbb35ab9cd76708",
                        ),
                        (
                            "cpg_fast_lap.mat",
                            _GENESIS_MASTER,
                            "cbb43a938a9de9bc8545d689d21cf6645d4f8f861d7a7904a2ee5033edb3c2ce",
                        ),
                        (
                            "med_lap_center_8_21.mat",
                            "6628b65b2b97f0c63849e8b5e178b0c5a0da2efb",
                            "b1688344361de0383f4eb6b15718be59d2efd9f7088d72648a84dcbe62744afa",
                        ),
                    )
                ),
            ),
            Dataset(
                "racelogic_brake_stop",
                "One brake stop from 112 km/h, 86 s: GNSS at 100 Hz",
                "CC0-1.0",
                "https://github.com/RacelogicVBOX/VBB-to-Python",
                "ExampleBrakeStop.vbb",
                (
                    File(
                        "ExampleBrakeStop.vbb",
                        _raw(
                            "RacelogicVBOX/VBB-to-Python",
                            "83d1aa378fca2628aaeef4ef6e820f705ec3223f",
                            "ExampleBrakeStop.vbb",
                        ),
                        "240155b5791063f8aee2eb9109ecbf07b6d52112ef7adb1fb5b57b019c3ed60b",
                    ),
                ),
            ),
        )
    }
)


def data_dir() -> Path:
    """Folder of the recordings: `VSENSE_DATA`, else `../shared/recordings` beside the repository if it is there,
    else the download cache of this user. It need not exist.
    """
    named = os.environ.get(_ENVIRONMENT)
    if named:
        return Path(named).expanduser()
    neighbour = (_REPOSITORY / _NEIGHBOUR).resolve()
    if neighbour.is_dir():
        return neighbour
    return user_folder()


def find(name: str) -> Path | None:
    """What to give to an importer for this dataset, if all its files are here; None if not."""
    dataset = _dataset(name)
    folder = data_dir() / name
    return folder / dataset.entry if all((folder / file.path).is_file() for file in dataset.files) else None


def fetch(name: str, progress: Callable[[str, int, int], None] | None = None) -> Path:
    """Download what is missing of a dataset into `data_dir()`, check it, and return what to give to an importer.

    `progress(file, done, total)` is called after each file. Raises `InputError` if there is no such dataset, if the
    download fails, or if a file is not what it must be.
    """
    import pooch

    dataset = _dataset(name)
    folder = data_dir() / name
    for done, file in enumerate(dataset.files):
        if progress is not None:
            progress(file.path, done, len(dataset.files))
        target = folder / file.path
        if target.is_file():
            if pooch.file_hash(str(target), alg="sha256") != file.sha256:
                raise InputError(f"{target}: not the published file (SHA-256 differs from {file.sha256}); delete it")
            continue
        pooch.get_logger().setLevel("WARNING")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            pooch.retrieve(file.url, f"sha256:{file.sha256}", fname=target.name, path=target.parent)
        except ValueError:
            raise InputError(
                f"{file.url}: what was downloaded is not the published file (expected SHA-256 {file.sha256}); "
                f"a proxy may have answered in its place; try again or copy the file to {target}"
            ) from None
        except OSError as error:  # of requests too
            raise InputError(
                f"{file.url}: cannot be downloaded to {target} ({type(error).__name__}). Check the network and the "
                f"folder, or set {_ENVIRONMENT} to a folder that holds {name}/{file.path}"
            ) from None
    if progress is not None:
        progress("", len(dataset.files), len(dataset.files))
    return folder / dataset.entry


def _dataset(name: str) -> Dataset:
    if name not in DATASETS:
        raise InputError(f"dataset {name!r} is unknown; known: {', '.join(DATASETS)}")
    return DATASETS[name]
