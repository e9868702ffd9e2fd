"""The check of a vehicle file finds planted mistakes, and nothing in files that have none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from planted_mistakes import GENERATED, PLANTED, content
from vsense_ros.cli import main
from vsense_ros.files.installed import shared_folder
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.prepare.car_check import features
from vsense_ros.prepare.features import ranges
from vsense_ros.prepare.vehicle_check import check_vehicle

SHIPPED = sorted((shared_folder("config") / "vehicles").glob("*.yaml"))


def written(path: Path, tree: object) -> Path:
    with path.open("w", encoding="utf-8") as file:
        YAML().dump(tree, file)
    return path


def check(path: Path, *arguments: str):
    return CliRunner().invoke(main, ["check", str(path), *arguments])


@pytest.mark.parametrize(("title", "car", "plant", "key"), PLANTED, ids=[one[0] for one in PLANTED])
def test_a_planted_mistake_is_found_and_its_key_named(title, car, plant, key, tmp_path):
    tree = content(car)
    plant(tree)
    found = check_vehicle(written(tmp_path / "car.yaml", tree))
    assert not found.is_good
    assert any(key in named for finding in found.findings for named in finding.keys) or key in found.refused


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_nothing_is_found_in_a_shipped_file(path):
    assert check_vehicle(path).sentences() == []


@pytest.mark.parametrize("name", GENERATED)
def test_nothing_is_found_in_a_file_made_from_catalogue_values(name, tmp_path):
    assert check_vehicle(written(tmp_path / "car.yaml", content(name))).sentences() == []


def test_every_range_is_used_and_says_where_it_comes_from():
    used = {feature.name for path in SHIPPED for feature in features(load_vehicle(path))}
    assert used == set(ranges())
    assert all(one.source and one.meaning and one.range[0] < one.range[1] for one in ranges().values())


def test_a_diameter_in_place_of_a_radius_is_called_so(tmp_path):
    tree = content("golf")
    for axle in ("front", "rear"):
        tree["physics"][axle]["unloaded_radius"] *= 2
    (finding,) = check_vehicle(written(tmp_path / "car.yaml", tree)).findings
    assert finding.mistake is not None
    assert finding.mistake.words == "the diameter instead of the radius"


def test_two_mistakes_are_both_found(tmp_path):
    tree = content("golf")
    tree["physics"]["chassis"]["mass"] *= 2.2046
    tree["sensors"]["imu"]["attitude"] = [0.0, 4.0, 0.0]
    found = check_vehicle(written(tmp_path / "car.yaml", tree))
    keys = {key for finding in found.findings for key in finding.keys}
    assert {"physics.chassis.mass", "sensors.imu.attitude"} <= keys


def test_a_mistake_that_no_car_can_have_is_named_beside_what_the_schema_says(tmp_path):
    tree = content("genesis")
    tree["physics"]["chassis"]["mass"] *= 9.80665
    found = check_vehicle(written(tmp_path / "car.yaml", tree))
    assert found.refused
    assert found.findings[0].keys == ("physics.chassis.mass",)
    assert "newtons" in found.sentences()[-1]


def test_exit_codes_tell_a_good_file_from_a_doubtful_and_an_unreadable_one(tmp_path):
    good = check(SHIPPED[0])
    assert good.exit_code == 0
    assert "Nothing looks wrong" in good.output
    tree = content("golf")
    tree["physics"]["steering"]["ratio"] = 0.0658
    doubtful = check(written(tmp_path / "car.yaml", tree))
    assert doubtful.exit_code == 1
    assert "physics.steering.ratio" in doubtful.output
    (tmp_path / "no.yaml").write_text("a: [", encoding="utf-8")
    assert check(tmp_path / "no.yaml").exit_code == 2
    assert check(tmp_path / "absent.yaml").exit_code == 2


def test_json_has_keys_figures_and_their_sources(tmp_path):
    tree = content("golf")
    tree["physics"]["steering"]["ratio"] = 0.0658
    found = json.loads(check(written(tmp_path / "car.yaml", tree), "--json").output)
    (finding,) = found["findings"]
    assert finding["keys"] == ["physics.steering.ratio"]
    assert finding["figures"][0]["source"].startswith("Reimpell")
