"""The document on what the simplified car leaves out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from studies import simplification
from studies.simplification import GUIDES, SIGNALS, SIMPLIFIED, TABLES, compare
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES, STANDARD
from vsense_ros.model.effects import Effects
from vsense_ros.model.effects.gyro_bias import GyroBias
from vsense_ros.model.vehicle import Vehicle

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "docs/simplification.md"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(ROOT / "config/vehicles/prototype_real.yaml")


def printed(title: str) -> dict[str, dict[str, float]]:
    """RMSE of each signal and car in the table of a manoeuvre."""
    section = DOCUMENT.read_text(encoding="utf-8").split(f"## {title}\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (.+) \[.+?\] \| (\S+).*? \| (\S+).*? \|", section, re.MULTILINE)
    return {name: dict(zip(SIMPLIFIED, (float(a), float(b)), strict=True)) for name, a, b in rows}


@pytest.mark.exam
def test_the_document_says_what_the_cars_do_now(vehicle):
    """`python -m studies simplification` writes it anew."""
    (comparison,) = compare(vehicle, (MANOEUVRES["step_steer"],))
    table = printed(comparison.manoeuvre.title)
    for signal in SIGNALS:
        for car in SIMPLIFIED:
            assert comparison.rmse(signal, car) == pytest.approx(table[signal.name][car], rel=0.1), (signal.name, car)


@pytest.mark.parametrize("manoeuvre", STANDARD, ids=lambda manoeuvre: manoeuvre.name)
def test_every_manoeuvre_has_its_table_and_its_picture(manoeuvre):
    table = printed(manoeuvre.title)
    assert set(table) == {signal.name for signal in SIGNALS}
    assert (DOCUMENT.parent / "simplification" / f"{manoeuvre.name}.png").exists()
    for name in ("lateral acceleration", "yaw rate", "roll", "lateral tyre force", "vertical tyre force"):
        assert table[name][TABLES] < table[name][GUIDES]


def test_a_vehicle_without_tables_is_refused(vehicle):
    with pytest.raises(InputError, match="has no section `suspension`; the comparison needs linkages and the tables"):
        next(compare(vehicle.model_copy(update={"suspension": None})))


def test_effects_of_the_file_are_left_out_of_all_three_cars(vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    driven: list[Vehicle] = []
    for name in ("simulate", "simulate_full_car"):
        monkeypatch.setattr(simplification, name, lambda car, *_, **__: driven.append(car))
    effects = Effects(gyro_bias=GyroBias(z=0.01))
    physics = vehicle.physics.model_copy(update={"effects": effects})
    simplification.drive(vehicle.model_copy(update={"physics": physics}), MANOEUVRES["step_steer"])
    assert [car.physics.effects.present() for car in driven] == [(), (), ()]
