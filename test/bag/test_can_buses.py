"""A log of several buses, each with a database and a mapping of its own."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\n'
DRIVE = HEAD + (
    'BO_ 50 SPIN: 8 X\n SG_ A : 0|16@1+ (0.01,0) [0|0] "m/s" X\n'
    'BO_ 51 MORE: 8 X\n SG_ B : 0|16@1+ (0.01,0) [0|0] "m/s" X\n'
)
TURN = HEAD + 'BO_ 50 HAND: 8 X\n SG_ C : 0|16@1- (0.01,0) [0|0] "rad" X\n'


def speed(message: str, signal: str, topic: str = "vehicle/speed") -> str:
    kind = "speed" if topic == "vehicle/speed" else "body_velocity"
    return f"  - {{kind: {kind}, topic: {topic}, message: {message}, speed: {{signals: {signal}, unit: m/s}}}}\n"


STEER = (
    "  - {kind: joint_state, topic: vehicle/steering, message: HAND, field: position, "
    "joints: {steering_wheel: {signals: C, unit: rad}}}\n"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in (("drive.dbc", DRIVE), ("turn.dbc", TURN)):
        (tmp_path / name).write_text(text)
    (tmp_path / "drive.yaml").write_text(
        "name: drive\noutputs:\n" + speed("SPIN", "A") + speed("MORE", "B", "vehicle/velocity")
    )
    (tmp_path / "turn.yaml").write_text("name: turn\noutputs:\n" + STEER)
    (tmp_path / "both.yaml").write_text("name: both\noutputs:\n" + speed("SPIN", "A") + STEER)
    with can.Logger(tmp_path / "log.log") as logger:
        for i in range(50):
            for channel, identifier, value in (("can0", 50, 1000), ("can0", 51, 2000), ("can1", 50, -300)):
                data = struct.pack("<h6x", value)
                logger(can.Message(1000.0 + i / 50, identifier, is_extended_id=False, data=data, channel=channel))
    return tmp_path


def values(folder: Path, dbc: tuple[str, ...], mapping: tuple[str, ...]) -> tuple[float, float]:
    """Speed and steering angle that come of these databases, `=` before the folder's files for a bus."""
    files = [f"{d.partition('=')[0]}={folder / d.partition('=')[2]}" if "=" in d else folder / d for d in dbc]
    found = import_recording(folder / "log.log", dbc=files, mapping=[folder / m for m in mapping])
    assert all(len(channel) == 50 for channel in found.channels.values())
    return (
        float(np.mean(found["vehicle/speed"].columns["linear"][:, 0])),
        float(np.mean(found["vehicle/steering"].columns["position"])),
    )


@pytest.mark.parametrize(
    ("dbc", "mapping"),
    [
        (("can0=drive.dbc", "can1=turn.dbc"), ("drive.yaml", "turn.yaml")),
        (("can1=turn.dbc", "can0=drive.dbc"), ("turn.yaml", "drive.yaml")),
        (("drive.dbc", "turn.dbc"), ("drive.yaml", "turn.yaml")),
        (("turn.dbc", "drive.dbc"), ("turn.yaml", "drive.yaml")),
        (("can0=drive.dbc", "turn.dbc"), ("both.yaml",)),
    ],
)
def test_each_database_is_used_on_its_bus(folder: Path, dbc: tuple[str, ...], mapping: tuple[str, ...]) -> None:
    np.testing.assert_allclose(values(folder, dbc, mapping), (10.0, -3.0))


def test_a_mapping_says_its_bus(folder: Path) -> None:
    for name, bus in (("drive", "can0"), ("turn", "can1")):
        path = folder / f"{name}.yaml"
        path.write_text(f"bus: {bus}\n" + path.read_text())
    np.testing.assert_allclose(values(folder, ("turn.dbc", "drive.dbc"), ("turn.yaml", "drive.yaml")), (10.0, -3.0))


@pytest.mark.parametrize(
    ("dbc", "mapping", "expected"),
    [
        (("drive.dbc", "turn.dbc"), ("drive.yaml",), "none of its messages is in turn.dbc"),
        (("drive.dbc", "turn.dbc"), ("drive.yaml",) * 3, "2 databases and 3 mappings"),
        (("can7=drive.dbc", "turn.dbc"), ("drive.yaml", "turn.yaml"), "no channel 'can7'; it has can0, can1"),
        (("drive.dbc", "drive.dbc"), ("both.yaml",), "message SPIN is in drive.dbc, drive.dbc of the databases"),
    ],
)
def test_databases_that_fit_nothing_are_refused_in_words(
    folder: Path, dbc: tuple[str, ...], mapping: tuple[str, ...], expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        values(folder, dbc, mapping)


def test_databases_that_fit_several_buses_alike_are_not_shared_out(folder: Path) -> None:
    (folder / "same.dbc").write_text(TURN.replace("HAND", "FOOT"))
    (folder / "same.yaml").write_text(
        "name: same\noutputs:\n" + speed("FOOT", "C").replace("unit: m/s", "unit: m/s, ignore_stated_unit: true")
    )
    with pytest.raises(InputError, match="on several buses alike; say which bus each is of: --dbc BUS=FILE"):
        values(folder, ("turn.dbc", "same.dbc"), ("turn.yaml", "same.yaml"))
