"""The commands on recordings: import of one and of several, info."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner

from recordings import formats, planted
from vsense_ros.bag import read_bag
from vsense_ros.cli import main


def called(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(a) for a in arguments])
    return result.exit_code, result.output


def test_info_looks_into_a_can_log_with_its_database_and_mapping(tmp_path: Path) -> None:
    path, options = formats.MAKERS["candump"](tmp_path, 3.0)
    code, said = called("info", path, "--dbc", options["dbc"], "--mapping", options["mapping"])
    assert code == 0, said
    assert "vehicle/wheel_speeds" in said
    assert "Nothing looks wrong." in said
    code, said = called("info", path)
    assert code == 2
    assert "needs a database (--dbc FILE) and a mapping (--mapping FILE)" in " ".join(said.split())


def test_a_can_log_and_a_table_with_another_clock_become_one_bag(tmp_path: Path) -> None:
    """The table has the GNSS of a slalom 4.2 s later than it was, the log the yaw rate."""
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    imu, gnss = drive["imu/data"], drive["gps/velocity"]
    (tmp_path / "car.dbc").write_text(formats.DBC)
    (tmp_path / "can.yaml").write_text(formats.CAN_MAPPING)
    start = int(imu.stamp[0])
    with (tmp_path / "bus.log").open("w") as log:
        for stamp, rate in zip(imu.stamp[::3], imu.columns["angular_velocity"][::3, 2], strict=True):
            raw = round(float(np.degrees(rate)) * 100).to_bytes(2, "little", signed=True)
            log.write(f"({formats.START + (stamp - start) * 1e-9:.6f}) can0 300#{(raw + bytes(6)).hex()}\n")
    east, north = gnss.columns["linear"][:, :2].T
    with (tmp_path / "gnss.csv").open("w") as table:
        table.write("time,speed [m/s],course [deg]\n")
        late = (gnss.stamp - start) * 1e-9 + 4.2
        course = np.degrees(np.arctan2(east, north)) % 360
        np.savetxt(table, np.column_stack([late, np.hypot(east, north), course]), fmt="%.6f", delimiter=",")
    (tmp_path / "gnss.yaml").write_text(
        "time: {column: time, unit: s, start: 2024-05-01T12:00:00Z}\n"
        "topics: {gps/velocity: {speed: {column: 'speed [m/s]'}, course: {column: 'course [deg]'}}}\n"
    )
    code, said = called(
        "import", tmp_path / "bus.log", tmp_path / "gnss.csv", tmp_path / "whole", "--dbc", tmp_path / "car.dbc",
        "--mapping", tmp_path / "can.yaml",
    )  # fmt: skip
    assert code == 0, said
    assert "gnss: its times are put -4." in said
    whole = read_bag(tmp_path / "whole")
    expected = formats.START * 10**9 + gnss.stamp[0] - start
    assert abs(whole["gps/velocity"].stamp[0] - expected) < 0.1e9
    code, said = called("import", tmp_path / "whole")
    assert code == 2
    assert "expected a recording and the bag to write" in said
