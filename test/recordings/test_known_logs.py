"""Mappings that are proposed for logs as devices write them read what was measured, unedited."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from recordings import guessing
from recordings.known_buses import BUSES
from recordings.known_logs import LOGS
from recordings.logs import drive
from vsense_ros.bag.importers.guess_names import heading, meanings

EVERY = LOGS | BUSES


@pytest.mark.parametrize("name", EVERY)
def test_what_is_proposed_for_a_log_reads_what_was_measured(name: str, tmp_path: Path) -> None:
    verdict = guessing.judged(name, EVERY[name], tmp_path)
    assert verdict.right, verdict.why


@pytest.mark.exam
@pytest.mark.parametrize(("manoeuvre", "vehicle"), [("steering_sweep", "rav4"), ("brake_in_turn", "prototype_model")])
def test_other_drives_are_read_as_well(manoeuvre: str, vehicle: str, tmp_path: Path) -> None:
    d = drive(manoeuvre, vehicle)
    verdicts = []
    for name, log in EVERY.items():
        (tmp_path / name.replace("/", " ")).mkdir()
        verdicts.append(guessing.judged(name, log, tmp_path / name.replace("/", " "), d))
    assert not [verdict for verdict in verdicts if verdict.silent]
    assert sum(verdict.right for verdict in verdicts) >= 30


def test_the_examination_notices_a_signal_in_another_unit(tmp_path: Path) -> None:
    log = LOGS["COBB Accessport"]

    def write(folder: Path, d: guessing.Columns) -> Path:
        return log.write(folder, {**d, "speed": d["speed"] * 1.609})

    verdict = guessing.judged("wrong", replace(log, write=write), tmp_path)
    assert "speed of vehicle/velocity is off" in verdict.why
    assert verdict.silent


@pytest.mark.parametrize(
    ("name", "words", "unit"),
    [
        ("gyroRotationZ(rad/s)", "gyro rotation z", "rad/s"),
        ("/imu/data/angular_velocity/z", "imu data angular velocity z", ""),
        ("SPEED_KPH", "speed", "km/h"),
        ("G(x)", "g x", ""),
        ("Time since start in ms ", "time since start", "ms"),
    ],
)
def test_a_name_is_looked_at_as_words_without_its_unit(name: str, words: str, unit: str) -> None:
    stated = "rad/s" if "rad/s" in name else ""
    assert (heading(name, stated).words, heading(name, stated).unit) == (words, unit)


def test_a_column_of_another_quantity_means_nothing() -> None:
    found = meanings({"speed": heading("Engine speed", "rpm"), "v": heading("Vehicle speed", "rpm")})
    assert found == {}
