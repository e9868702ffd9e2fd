"""Conventions of axes that a mapping states; the oracle is a car that turns left, written down in each convention."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vsense_ros.bag import write_bag
from vsense_ros.bag.importers import import_recording
from vsense_ros.bag.importers.convention import CONVENTIONS
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording

# A car that drives north-east, turns left and brakes: in its own axes forward, left, up and on the map east, north, up.
RATE = (0.01, 0.02, 0.3)  # [rad/s]
FORCE = (-2.0, 4.5, 9.8)  # [m/s²]
GROUND = (6.0, 8.0, 0.5)  # [m/s]
STEERING = 0.4  # [rad] to the left
IN_CONVENTION: dict[str, dict[str, tuple[float, ...]]] = {
    "iso_8855": {"rate": RATE, "force": FORCE, "ground": GROUND, "steering": (STEERING,)},
    "sae_j670": {
        "rate": (0.01, -0.02, -0.3),
        "force": (-2.0, -4.5, -9.8),
        "ground": (8.0, 6.0, -0.5),
        "steering": (-STEERING,),
    },
    "ned": {
        "rate": (0.01, -0.02, -0.3),
        "force": (-2.0, -4.5, -9.8),
        "ground": (8.0, 6.0, -0.5),
        "steering": (STEERING,),
    },
    "enu": {"rate": (-0.02, 0.01, 0.3), "force": (-4.5, -2.0, 9.8), "ground": GROUND, "steering": (STEERING,)},
}
COLUMNS = {"imu/data": ("rate", "force"), "gps/velocity": ("ground",), "vehicle/steering": ("steering",)}


def written(folder: Path, convention: str) -> Path:
    """A table of that car in a convention."""
    values = IN_CONVENTION[convention]
    names = [f"{name}{i}" for name, numbers in values.items() for i in range(len(numbers))]
    row = ",".join(str(number) for numbers in values.values() for number in numbers)
    lines = [",".join(["t", *names]), *(f"{i / 10},{row}" for i in range(20))]
    (folder / "log.csv").write_text("\n".join(lines))
    return folder / "log.csv"


def mapping(**more: Any) -> dict[str, Any]:
    def three(name: str, unit: str) -> list[dict[str, str]]:
        return [{"column": f"{name}{i}", "unit": unit} for i in range(3)]

    return {
        "time": {"column": "t", "unit": "s", "start": "2024-01-01T00:00:00Z"},
        "topics": {
            "imu/data": {"angular_velocity": three("rate", "rad/s"), "linear_acceleration": three("force", "m/s²")},
            "gps/velocity": {"linear": three("ground", "m/s")},
            "vehicle/steering": {"position": {"steering_wheel": {"column": "steering0", "unit": "rad"}}},
        },
        **more,
    }


def is_the_car(found: Recording) -> bool:
    first = {topic: {field: rows[0] for field, rows in found[topic].columns.items()} for topic in COLUMNS}
    return (
        np.allclose(first["imu/data"]["angular_velocity"], RATE)
        and np.allclose(first["imu/data"]["linear_acceleration"], FORCE)
        and np.allclose(first["gps/velocity"]["linear"], GROUND)
        and np.allclose(first["vehicle/steering"]["position"], STEERING)
    )


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_table_in_any_convention_is_the_same_car(convention: str, tmp_path: Path) -> None:
    table = written(tmp_path, convention)
    assert is_the_car(import_recording(table, mapping=mapping(convention=convention)))
    each = dict.fromkeys(COLUMNS, convention)
    assert is_the_car(import_recording(table, mapping=mapping(conventions=each)))
    assert is_the_car(import_recording(table, mapping=mapping())) == (convention == "iso_8855")


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_topics_of_a_bag_in_any_convention_are_the_same_car(convention: str, tmp_path: Path) -> None:
    plain = import_recording(written(tmp_path, convention), mapping=mapping())
    renamed = {
        f"their/{name}": Channel(f"their/{name}", c.kind, c.stamp, c.received, c.columns, c.frame_id, c.names)
        for name, c in plain.channels.items()
    }
    write_bag(tmp_path / "bag", Recording(renamed))
    theirs = {topic: f"/their/{topic}" for topic in COLUMNS}
    assert is_the_car(import_recording(tmp_path / "bag", mapping={"topics": theirs, "convention": convention}))
    each = {topic: {"topic": name, "convention": convention} for topic, name in theirs.items()}
    assert is_the_car(import_recording(tmp_path / "bag", mapping={"topics": each}))


@pytest.mark.parametrize("name", ["ned", "sae_j670"])
def test_a_heading_in_north_east_down_is_the_yaw_from_east(name: str, tmp_path: Path) -> None:
    """A pose that heads 30° east of north, nose up by 5°."""
    heading, nose = np.radians(30.0), np.radians(5.0)
    given = Rotation.from_euler("ZYX", [heading, nose, 0.0]).as_quat()
    stamp = 1_700_000_000_000_000_000 + np.arange(5) * 10_000_000
    columns = {
        "position": np.tile([100.0, 50.0, -3.0], (5, 1)),
        "orientation": np.tile(given, (5, 1)),
        "pose_covariance": np.zeros((5, 36)),
        "linear": np.tile([10.0, 0.5, 0.1], (5, 1)),
        "angular": np.zeros((5, 3)),
        "twist_covariance": np.zeros((5, 36)),
    }
    pose = Channel("their/pose", "nav_msgs/msg/Odometry", stamp, stamp, columns, "map")
    write_bag(tmp_path / "bag", Recording({"their/pose": pose}))
    found = import_recording(
        tmp_path / "bag", mapping={"topics": {"reference/odometry": "their/pose"}, "convention": name}
    )["reference/odometry"]
    yaw, pitch, roll = Rotation.from_quat(found.columns["orientation"][0]).as_euler("ZYX")
    assert (yaw, pitch, roll) == pytest.approx((np.pi / 2 - heading, -nose, 0.0))  # pitch is positive nose down
    assert found.columns["position"][0] == pytest.approx([50.0, 100.0, 3.0])
    assert found.columns["linear"][0] == pytest.approx([10.0, -0.5, -0.1])


def test_a_convention_for_a_topic_that_is_not_mapped_or_that_nobody_knows_is_a_sentence(tmp_path: Path) -> None:
    table = written(tmp_path, "ned")
    with pytest.raises(InputError, match=r"conventions: 'gps/fix' is no topic of this mapping; it has imu/data"):
        import_recording(table, mapping=mapping(conventions={"gps/fix": "ned"}))
    with pytest.raises(InputError, match=r"convention: .*iso_8855.*found 'android'"):
        import_recording(table, mapping=mapping(convention="android"))
