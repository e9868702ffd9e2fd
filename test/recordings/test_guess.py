"""A mapping that is proposed reads the drive that the table was made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from recordings import planted
from vsense_ros.bag.importers import import_recording
from vsense_ros.bag.importers.guess import guess
from vsense_ros.checks.inspect import inspect
from vsense_ros.cli import main
from vsense_ros.errors import InputError

HEADER = "Time;GPS Speed [km/h];GPS Heading;YawRate;Lateral acceleration [g];Lenkradwinkel [°];Latitude;Longitude;Gear"


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A logger's table: yaw rate in deg/s to the right, lateral acceleration in g to the right."""
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    t = np.arange(0, 12, 0.02)

    def at(topic: str, field: str, column: int) -> np.ndarray:
        channel = drive[topic]
        seconds = (channel.stamp - drive["imu/data"].stamp[0]) * 1e-9
        return np.interp(t, seconds, channel.columns[field][:, column])

    east, north = (at("gps/velocity", "linear", i) for i in (0, 1))
    columns = [
        t,
        np.hypot(east, north) * 3.6,
        np.degrees(np.arctan2(east, north)) % 360,
        -np.degrees(at("imu/data", "angular_velocity", 2)),
        -at("imu/data", "linear_acceleration", 1) / 9.80665,
        np.degrees(at("vehicle/steering", "position", 0)),
        at("gps/fix", "latitude", 0),
        at("gps/fix", "longitude", 0),
        0 * t + 3,
    ]
    path = tmp_path_factory.mktemp("guess") / "drive.csv"
    with path.open("w", encoding="utf-8") as file:
        file.write(HEADER + "\n")
        np.savetxt(file, np.column_stack(columns), fmt="%.7f", delimiter=";")
    return path


def test_names_units_and_signs_are_found(table: Path, tmp_path: Path) -> None:
    said = CliRunner().invoke(main, ["import", str(table), "--guess"])
    assert said.exit_code == 0, said.output
    assert "# YawRate: reversed, as the yaw rate is against the turning of the GNSS course" in said.output
    assert "# not used: Gear" in said.output
    (tmp_path / "mapping.yaml").write_text(said.stdout, encoding="utf-8")
    found = import_recording(table, mapping=tmp_path / "mapping.yaml")
    assert inspect(found).problems == ()
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    imu = drive["imu/data"]
    expected = np.interp(found["imu/data"].seconds, imu.seconds, imu.columns["angular_velocity"][:, 2])
    np.testing.assert_allclose(found["imu/data"].columns["angular_velocity"][:, 2], expected, atol=1e-4)
    steering = YAML(typ="safe").load(said.stdout)["topics"]["vehicle/steering"]["position"]["steering_wheel"]
    assert steering == {"column": "Lenkradwinkel [°]", "unit": "deg"}


def test_a_table_of_which_no_name_is_known_says_so(tmp_path: Path) -> None:
    (tmp_path / "odd.csv").write_text("time,foo,bar\n0,1,2\n1,2,3\n2,3,4\n")
    with pytest.raises(InputError, match="none of its columns has a name that is known; found: foo, bar"):
        guess(tmp_path / "odd.csv")
