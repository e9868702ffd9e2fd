"""What the description of a functional mock-up unit says of its variables."""

from __future__ import annotations

import copy
from pathlib import Path
from xml.etree import ElementTree

import pytest

fmpy = pytest.importorskip("fmpy")
from lxml import etree  # FMPy needs it, too

from vsense_ros.errors import InputError
from vsense_ros.export import fmu, terminals
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(ROOT / "config/vehicles/prototype_model.yaml")


def scalars(unit: fmu.Unit, version: int) -> dict[str, tuple[str, str]]:
    """Unit and description of each variable of numbers, by name."""
    root = ElementTree.fromstring(unit.description(version))
    if version == 2:
        every = [(v.attrib, v.find("Real")) for v in root.iter("ScalarVariable")]
        return {a["name"]: (r.get("unit", ""), a["description"]) for a, r in every if r is not None}
    return {v.attrib["name"]: (v.get("unit", ""), v.attrib["description"]) for v in root.iter("Float64")}


@pytest.fixture(scope="module")
def unit(vehicle: Vehicle) -> fmu.Unit:
    return fmu.Unit(vehicle)


def of_scalars(unit: fmu.Unit) -> fmu.Unit:
    other = copy.copy(unit)
    other.scalars = True
    return other


@pytest.mark.slow
def test_both_versions_have_scalars_of_the_same_names_units_and_meanings(unit: fmu.Unit) -> None:
    second, third = scalars(unit, 2), scalars(of_scalars(unit), 3)
    assert third.pop("time") == ("s", "time")
    assert second == third
    assert all(meaning for _, meaning in second.values())


@pytest.mark.slow
def test_what_is_measured_has_the_name_of_its_quantity_and_axis(unit: fmu.Unit) -> None:
    known = scalars(unit, 2)
    assert known["imu.angular_velocity.z"] == ("rad/s", "about the sensor's z axis")
    assert known["imu.linear_acceleration.y"] == ("m/s2", "specific force along the sensor's y axis")
    assert known["wheel_force_z.fl"] == ("N", "force of the road on the tyre, upwards, wheel fl")
    assert known["state.imu_gyro_bias_x"][0] == "rad/s"


@pytest.mark.slow
def test_a_unit_of_arrays_has_as_many_elements_as_one_of_scalars(unit: fmu.Unit) -> None:
    root = ElementTree.fromstring(unit.description(3))
    sizes = [int(d.attrib["start"]) if (d := v.find("Dimension")) is not None else 1 for v in root.iter("Float64")]
    assert sum(sizes) == len(scalars(of_scalars(unit), 3))


@pytest.mark.slow
@pytest.mark.parametrize("of_elements", [False, True])
def test_every_input_and_output_is_in_one_terminal_as_the_schema_has_them(
    unit: fmu.Unit, of_elements: bool, tmp_path: Path
) -> None:
    chosen = of_scalars(unit) if of_elements else unit
    terminals.write(chosen, 3, tmp_path)
    written = tmp_path / "terminalsAndIcons"
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    etree.XMLSchema(etree.parse(str(schema))).assertValid(etree.parse(str(written / "terminalsAndIcons.xml")))
    root = ElementTree.parse(written / "terminalsAndIcons.xml").getroot()
    assert {"imu", "wheel_speeds", "driver", "motion", "tyres"} <= {t.attrib["name"] for t in root.iter("Terminal")}
    members = [one.attrib["variableName"] for one in root.iter("TerminalMemberVariable")]
    every = next(ElementTree.fromstring(chosen.description(3)).iter("ModelVariables"))
    wanted = [v.attrib["name"] for v in every if v.attrib["causality"] in ("input", "output")]
    assert sorted(members) == sorted(wanted)
    assert (written / "icon.png").read_bytes().startswith(b"\x89PNG")


def kinds() -> list[type[SensorBase]]:
    every = SensorBase.__subclasses__()
    for kind in every:
        every.extend(kind.__subclasses__())
    return [kind for kind in every if isinstance(kind.model_fields["kind"].default, str) and kind.inputs is None]


@pytest.mark.parametrize("kind", kinds(), ids=lambda kind: kind.__name__)
def test_every_number_that_a_sensor_measures_is_a_quantity(kind: type[SensorBase]) -> None:
    sensor = kind.model_construct()
    assert len(kind.quantities) == len(sensor.deviations())
    assert len({quantity.path for quantity in kind.quantities}) == len(kind.quantities)


@pytest.mark.parametrize(
    ("name", "version", "words"),
    [("sparc-solaris", 3, "x86_64-windows"), ("aarch64-linux", 2, "no folder")],
)
def test_a_machine_without_a_binary_is_refused_by_what_there_is(name: str, version: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        fmu.target_of(name, version)


def test_a_compiler_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(InputError, match="x86_64-w64-mingw32-gcc"):
        fmu.target_of("x86_64-windows", 3)
