"""Vehicle files as people write them, and what they are told when something is wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from vsense_ros.errors import InputError
from vsense_ros.files.schema import parameter_rows
from vsense_ros.files.vehicle import load_vehicle, save_changes, save_vehicle

ROOT = Path(__file__).parents[2]
VEHICLES = sorted((ROOT / "config/vehicles").glob("*.yaml"))


@pytest.fixture
def changed(tmp_path: Path) -> Callable[[str, str], Path]:
    """Writes a vehicle file with one piece of its text replaced."""

    def write(old: str, new: str) -> Path:
        text = (ROOT / "test/data/car.yaml").read_text(encoding="utf-8")
        assert old in text
        path = tmp_path / "car.yaml"
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return path

    return write


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as error:
        load_vehicle(path)
    return str(error.value)


def line_of(path: Path, text: str) -> int:
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(i for i, line in enumerate(lines, 1) if text in line)


@pytest.mark.parametrize("path", VEHICLES, ids=lambda path: path.stem)
def test_a_vehicle_survives_being_written_and_read(path, tmp_path):
    vehicle = load_vehicle(path)
    save_vehicle(tmp_path / "copy.yaml", vehicle)
    assert load_vehicle(tmp_path / "copy.yaml") == vehicle


WRITTEN_BY_HAND = [path for path in VEHICLES if "#" in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("path", WRITTEN_BY_HAND, ids=lambda path: path.stem)
def test_changed_numbers_are_written_and_all_else_stays_as_its_author_wrote_it(path, tmp_path):
    source = path.read_text(encoding="utf-8")
    car, copy = load_vehicle(path), tmp_path / "changed.yaml"
    errors = car.observer.force_errors.model_copy(update={"pitch": 0.123, "yaw": 0.0456})
    imu = car.sensors["imu"].model_copy(update={"force_noise": (0.11, 0.22, 0.33)})
    changed = car.model_copy(
        update={
            "observer": car.observer.model_copy(update={"force_errors": errors}),
            "sensors": {**car.sensors, "imu": imu},
        }
    )
    paths = ["observer.force_errors.pitch", "observer.force_errors.yaw"]
    save_changes(path, copy, changed, paths + [f"sensors.imu.force_noise.{i}" for i in range(3)])
    assert load_vehicle(copy) == changed
    remarks = re.findall(r"#.*", source)
    assert re.findall(r"#.*", copy.read_text(encoding="utf-8")) == remarks
    save_changes(path, copy, car, [])
    assert load_vehicle(copy) == car


@pytest.mark.parametrize("rear", ["*imu", "{<<: *imu, topic: rear/data}"], ids=["alias", "merge"])
@pytest.mark.parametrize("written", ["imu", "imu_rear"])
def test_numbers_that_two_sensors_share_in_the_file_are_changed_for_one_of_them(changed, tmp_path, rear, written):
    path = changed("  imu:\n", "  imu: &imu\n")
    text = path.read_text(encoding="utf-8").replace(
        "  steering: {kind", f"  imu_rear: {rear}  # back\n  steering: {{kind"
    )
    path.write_text(text, encoding="utf-8")
    car, copy = load_vehicle(path), tmp_path / "changed.yaml"
    noise = {"rate_noise": (0.1, 0.2, 0.015), "force_bias": 0.4}
    sensors = {**car.sensors, written: car.sensors[written].model_copy(update=noise)}
    wanted = car.model_copy(update={"sensors": sensors})
    paths = [f"sensors.{written}.{name}" for name in ("rate_noise.0", "rate_noise.1", "force_bias")]
    save_changes(path, copy, wanted, paths)
    assert load_vehicle(copy) == wanted
    assert "# back" in copy.read_text(encoding="utf-8")


def test_a_negative_mass_is_refused_with_file_line_key_and_range(changed):
    path = changed("mass: 1700.0", "mass: -1700.0")
    message = complaint(path)
    assert message.startswith(f"{path}:{line_of(path, 'mass: -1700')}: physics.chassis.mass: ")
    assert "found -1700.0" in message
    assert "a number in kg, > 0, < 100000" in message


def test_a_missing_key_is_named_with_what_belongs_there(changed):
    path = changed("    wheel_spin_inertia: 1.2\n", "")
    message = complaint(path)
    assert message.startswith(
        f"{path}:{line_of(path, '  front:')}: physics.front.wheel_spin_inertia: missing; expected "
    )
    assert "moment of inertia of one wheel about its axle (a number in kg m², > 0)" in message


@pytest.mark.parametrize("written", ['"1700 kg"', "1700 kg", '"1700"', "true", "null", "[1700.0]", "{value: 1700.0}"])
def test_a_mass_that_is_no_number_is_refused_with_what_was_found(changed, written):
    message = complaint(changed("mass: 1700.0", f"mass: {written}"))
    assert "physics.chassis.mass: " in message
    assert "a number in kg" in message
    assert message.count("\n") == 0


@pytest.mark.parametrize("written", [".nan", ".inf", "-.inf"])
def test_numbers_that_are_not_finite_are_refused(changed, written):
    assert "physics.aerodynamics.drag_area: " in complaint(changed("drag_area: 0.80", f"drag_area: {written}"))


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("yaw_inertia: 2900.0", "yaw_inertia: 2.9e+12", "physics.chassis.yaw_inertia"),  # g mm²
        ("yaw_inertia: 2900.0", "yaw_inertia: 29.0", "physics.chassis.yaw_inertia"),
        ("pitch_inertia: 2700.0", "pitch_inertia: 27.0", "physics.chassis.pitch_inertia"),
        ("roll_inertia: 720.0", "roll_inertia: 72000.0", "physics.chassis.roll_inertia"),
        ("mass: 1700.0", "mass: 1700000.0", "physics.chassis.mass"),  # g
        ("mass: 1700.0", "mass: 1.7", "physics"),  # t
        ("cog_height: 0.64", "cog_height: 640.0", "physics.chassis.cog_height"),  # mm
        ("suspension_stiffness: 28000.0", "suspension_stiffness: 28.0", "physics.front.suspension_stiffness"),  # N/mm
        ("tyre_stiffness: 220000.0", "tyre_stiffness: 220.0", "physics.front.tyre_stiffness"),  # N/mm
        ("unloaded_radius: 0.352", "unloaded_radius: 352.0", "physics.front.unloaded_radius"),  # mm
        ("attitude: [0.012, 0.073, 0.0]", "attitude: [0.7, 90.0, 0.0]", "sensors.imu.attitude.1"),  # deg
        ("position: [0.6, 0.0, 0.6]", "position: [600.0, 0.0, 600.0]", "sensors.imu.position.0"),  # mm
    ],
)
def test_values_in_a_wrong_unit_are_refused_at_their_line(changed, old, new, key):
    path = changed(old, new)
    first = complaint(path).splitlines()[0]
    assert first.startswith(f"{path}:")
    assert f": {key}: " in first
    if key != "physics":
        assert f"{path}:{line_of(path, new.split(', ')[0])}: " in first


@pytest.mark.parametrize(
    ("effect", "size", "most"),
    [
        ("payload_offset", "moment", 1700 * 1.57 / 2),  # all of the weight is on the wheels of one side
        ("payload_offset", "moment", -1700 * 1.57 / 2),
        ("sloshing_load", "mass", 0.3 * 1700),
    ],
)
def test_a_load_that_no_car_stands_up_with_is_refused_in_a_file_but_may_be_tried(changed, effect, size, most):
    def laden(value: float) -> Path:
        return changed("physics:\n", f"physics:\n  effects:\n    {effect}: {{{size}: {value:.0f}}}\n")

    path = laden(1.01 * most)
    message = complaint(path)
    assert message.startswith(f"{path}:{line_of(path, effect)}: physics.effects.{effect}.{size}: ")
    assert f"is {1.01 * most:.0f}; expected less than {abs(most):.4g} kg" in message
    tried = load_vehicle(laden(0.99 * most)).with_parameters({f"effects.{effect}.{size}": 2 * most})
    assert tried.values()[f"effects.{effect}.{size}"] == 2 * most


def test_an_unknown_key_is_named_with_those_that_are_known(changed):
    path = changed("mass: 1700.0", "weight: 1700.0")
    missing, unknown = complaint(path).splitlines()
    assert "physics.chassis.mass: missing" in missing
    assert unknown.startswith(f"{path}:{line_of(path, 'weight')}: physics.chassis.weight: unknown key, found 1700.0")
    assert "mass, roll_inertia, pitch_inertia" in unknown


def test_an_unknown_key_of_a_sensor_is_named_with_those_that_are_known(changed):
    message = complaint(changed("{kind: wheel_speeds, noise: 0.17}", "{kind: wheel_speeds, sigma: 0.17}"))
    assert "sensors.wheel_speeds.sigma: unknown key, found 0.17; known here: kind, topic, " in message


def test_a_sensor_of_unknown_kind_is_told_which_kinds_there_are(changed):
    message = complaint(changed("kind: wheel_speeds", "kind: lidar"))
    assert ": sensors.wheel_speeds: " in message
    assert "lidar" in message
    assert "'gnss_velocity'" in message


def test_a_sensor_name_with_a_dot_is_refused_because_dots_part_keys(changed):
    path = changed("  imu:\n", "  imu.front:\n")
    message = complaint(path)
    assert message.startswith(f"{path}:{line_of(path, 'imu.front')}: sensors.imu.front: ")
    assert "expected a name without dots" in message
    assert "write imu_front, found 'imu.front'" in message


def test_noise_of_zero_is_refused_because_no_sensor_is_perfect(changed):
    message = complaint(changed("rate_noise: [0.03, 0.03, 0.015]", "rate_noise: [0.03, 0.0, 0.015]"))
    assert "sensors.imu.rate_noise.1: " in message
    assert "a number in rad/s, 3 numbers, > 0" in message


def test_all_faults_of_a_file_are_told_at_once(changed):
    path = changed("mass: 1700.0, roll_inertia: 720.0", "mass: -1.0, roll_inertia: heavy")
    message = complaint(path)
    assert len(message.splitlines()) == 2
    assert "found 'heavy'" in message


def test_a_tyre_curve_without_maximum_is_refused_at_its_line(changed):
    path = changed("initial_slope: 75000.0", "initial_slope: 750.0")
    assert complaint(path).startswith(
        f"{path}:{line_of(path, 'initial_slope: 750.0')}: physics.front.tyre.lateral.nominal"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: [unclosed\nphysics: {}\n", r"car\.yaml:\d+: not valid YAML"),
        ("name: a\nname: b\n", r"car\.yaml:\d+: not valid YAML"),
        ("\tname: a\n", r"car\.yaml:1: not valid YAML"),
        ("", "expected a mapping with the keys name, source, physics"),
        ("- a\n- b\n", "expected a mapping with the keys name, source, physics"),
        ("just words\n", "expected a mapping"),
        ("name: a\n---\nname: b\n", "not valid YAML"),
    ],
)
def test_a_file_that_is_no_vehicle_file_is_refused(tmp_path, text, expected):
    path = tmp_path / "car.yaml"
    path.write_text(text, encoding="utf-8")
    assert re.search(expected, complaint(path))


def test_a_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_bytes(b"\xff\xfe\x00name")
    assert str(path) in complaint(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    missing = complaint(tmp_path / "nowhere.yaml")
    assert missing.startswith(f"{tmp_path / 'nowhere.yaml'}: no such vehicle file; give the path of one")
    assert "config/vehicles" in missing
    assert complaint(tmp_path).startswith(f"{tmp_path}: not a regular file")


def test_whole_numbers_anchors_and_dates_are_understood(changed):
    path = changed("source: invented for tests", "source: 2017-05-01")
    assert load_vehicle(path).source == "2017-05-01"
    assert load_vehicle(changed("mass: 1700.0", "mass: 1700")).physics.chassis.mass == 1700.0


def test_an_unknown_parameter_cannot_be_changed():
    with pytest.raises(KeyError, match=r"chassis\.weight.*is no parameter; known are chassis\.mass"):
        load_vehicle(VEHICLES[0]).with_parameters({"chassis.weight": 1.0})


def test_every_quantity_of_the_schema_is_described():
    assert [row.key for row in parameter_rows() if row.unit and not row.description] == []
