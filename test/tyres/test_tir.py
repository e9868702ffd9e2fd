"""Tyre property files as they are found: units, comments, versions; and what is wrong with some."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench import FOLDER, forces
from vsense_ros.errors import InputError
from vsense_ros.files.tir import read_tir
from vsense_ros.files.tyre import load_tyre
from vsense_ros.files.vehicle import load_vehicle, save_vehicle

BOOK = FOLDER / "pacejka_2006_205_60r15.tir"


@pytest.fixture
def written(tmp_path):
    def write(*replacements: tuple[str, str], extra: str = "") -> Path:
        text = BOOK.read_text(encoding="utf-8")
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "tyre.tir"
        path.write_text(text + extra, encoding="utf-8")
        return path

    return write


def test_units_of_the_file_are_converted_for_what_has_a_dimension(written):
    path = written(
        ("LENGTH   = 'meter'", "LENGTH = 'mm'"), ("FORCE    = 'newton'", "FORCE = 'kN'"),
        ("ANGLE    = 'radians'", "ANGLE = 'degrees'"), ("UNLOADED_RADIUS = 0.313", "UNLOADED_RADIUS = 313"),
        ("FNOMIN = 4000", "FNOMIN = 4"), ("FZMIN = 200", "FZMIN = 0.2"), ("FZMAX = 9000", "FZMAX = 9"),
        ("CAMMAX = 0.26", "CAMMAX = 14.896902673"), ("LONGVL   = 16.67", "LONGVL = 16670"),
        ("LONGITUDINAL_STIFFNESS = 300000", "LONGITUDINAL_STIFFNESS = 0.3"),
        ("LATERAL_STIFFNESS      = 100000", "LATERAL_STIFFNESS = 0.1"),
    )  # fmt: skip
    converted, original = read_tir(path), read_tir(BOOK)
    assert converted.largest_camber == pytest.approx(original.largest_camber)
    for name in ("nominal_load", "unloaded_radius", "smallest_load", "reference_speed", "lateral_stiffness"):
        assert getattr(converted, name) == pytest.approx(getattr(original, name)), name
    assert converted.lateral == original.lateral


def test_comments_case_quotes_tables_and_fortran_exponents_do_not_matter(written):
    path = written(
        ("PCX1       = 1.685", "pcx1=1.685$shape"), ("PKX1       = 21.51", "PKX1 = 2.151D+01 ! slope"),
        ("LENGTH   = 'meter'", 'LENGTH = "METER"'),
        extra="\n[SHAPE]\n{radial width}\n 1.0 0.0\n 1.0 0.4\n\n[OVERTURNING_COEFFICIENTS]\nQSX1 = 0.1\n",
    )  # fmt: skip
    assert read_tir(path) == read_tir(BOOK)


def test_keys_that_mean_something_else_in_another_section_do_not_matter(written):
    path = written(
        ("LENGTH   = 'meter'", "LENGTH = 'meter'\nMASS = 'kg'"),
        extra="\n[INERTIA]\nMASS = 9.3\nLENGTH = 12\n[CONTACT_PATCH]\nQ = 1\n[SHAPE]\nQ = 2\n",
    )
    assert read_tir(path) == read_tir(BOOK)


@pytest.mark.parametrize(("fittyp", "version"), [("6", 5.2), ("21", 5.2), ("52", 5.2), ("61", 6.1), ("62", 6.1)])
def test_fittyp_says_which_magic_formula(written, fittyp, version):
    assert read_tir(written(("FITTYP   = 61", f"FITTYP = {fittyp}"))).version == version


def test_a_right_tyre_on_the_right_is_a_left_tyre_on_the_left(written):
    left, right = read_tir(BOOK), read_tir(written(("'LEFT'", "'RIGHT'")))
    state = (4000.0, 20.0, 0.3, 20.2)
    assert forces(right, *state, side=-1.0) == pytest.approx(forces(left, *state, side=1.0))


def test_a_symmetric_tyre_has_no_side_force_at_zero_slip(written):
    tyre = read_tir(written(("'LEFT'", "'SYMMETRIC'")))
    assert forces(tyre, 4000.0, 20.0, 0.0, 20.0)[1] == pytest.approx(0, abs=1e-9)
    assert forces(read_tir(BOOK), 4000.0, 20.0, 0.0, 20.0)[1] == pytest.approx(42, abs=1)


def test_a_file_in_adapted_sae_axes_is_recognised_by_its_sign_and_read_where_that_is_said(written):
    from vsense_ros.model.tyres.magic_formula_coefficients import AXIS_DEPENDENT

    text, lines = BOOK.read_text(encoding="utf-8"), []
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        flip = key.strip().lower() in AXIS_DEPENDENT
        lines.append(f"{key}= {-float(value)!r}" if equals and flip else line)
    path = written((text, "\n".join(lines)))
    with pytest.raises(InputError, match=r"PKY1 14.95 has the wrong sign for iso axes.*axes: adapted_sae"):
        read_tir(path)
    assert read_tir(path, "adapted_sae") == read_tir(BOOK)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("PKX1       = 21.51", "PKX1 = stiff", r"tyre\.tir:\d+: PKX1: expected a number, found 'stiff'"),
        ("PKX1       = 21.51", "", r"tyre\.tir: PKX1 is missing"),
        ("PKX1       = 21.51", "PKX1 21.51", r"tyre\.tir:\d+: expected KEY = value in section"),
        ("PKX1       = 21.51", "PCX1 = 1.9", r"PCX1 = 1.9 contradicts line \d+"),
        ("PCX1       = 1.685", "PCX1 = 3", r"tyre\.tir:\d+: PCX1: .*less than or equal to 2, found 3"),
        ("FNOMIN = 4000", "", r"FNOMIN is missing"),
        ("FORCE    = 'newton'", "FORCE = 'stone'", r"tyre\.tir:\d+: FORCE: unknown unit 'stone'; known are newton"),
        ("FITTYP   = 61", "FITTYP = 89", r"tyre\.tir:\d+: FITTYP 89 is not supported; expected one of"),
        ("FITTYP   = 61", "$", r"FITTYP is missing in section \[MODEL\]"),
        ("'MF-TYRE'", "'FIALA'", r"PROPERTY_FILE_FORMAT 'FIALA' is no Magic Formula"),
        ("'LEFT'", "'TOP'", r"TYRESIDE: expected LEFT, RIGHT or SYMMETRIC, found 'TOP'"),
    ],
)
def test_a_fault_is_named_with_file_line_and_key(written, old, new, complaint):
    with pytest.raises(InputError, match=complaint):
        read_tir(written((old, new)))


def test_what_is_no_tyre_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such tyre file"):
        read_tir(tmp_path / "missing.tir")
    (tmp_path / "empty.tir").write_text("nothing here\n", encoding="utf-8")
    with pytest.raises(InputError, match="no tyre property file"):
        read_tir(tmp_path / "empty.tir")


@pytest.fixture
def with_tyres(tmp_path):
    """Writes the Genesis with other tyres."""
    from ruamel.yaml import YAML

    def write(tyre: dict) -> Path:
        yaml = YAML()
        car = yaml.load(FOLDER.parent / "vehicles/genesis.yaml")
        for axle in ("front", "rear"):
            car["physics"][axle]["tyre"] = dict(tyre)
        (tmp_path / "tyres").mkdir(exist_ok=True)
        (tmp_path / "tyres/book.tir").write_bytes(BOOK.read_bytes())
        path = tmp_path / "car.yaml"
        yaml.dump(car, path)
        return path

    return write


def test_a_vehicle_file_names_a_tyre_file_and_may_change_what_it_says(with_tyres, tmp_path):
    car = load_vehicle(with_tyres({"model": "magic_formula", "tir": "tyres/book.tir", "scaling": {"lmuy": 1.1}}))
    tyre = car.physics.front.tyre
    assert tyre.lateral == read_tir(BOOK).lateral
    assert tyre.scaling.lmuy == 1.1
    save_vehicle(tmp_path / "copy.yaml", car)
    assert load_vehicle(tmp_path / "copy.yaml").values() == car.values()


@pytest.mark.parametrize(
    ("tyre", "complaint"),
    [
        ({"model": "fiala", "tir": "tyres/book.tir"}, r"car\.yaml:\d+: physics\.front\.tyre\.tir: only a tyre of"),
        ({"model": "magic_formula", "tir": "tyres/other.tir"}, r"physics\.front\.tyre\.tir: .*no such tyre file"),
        ({"model": "magic_formula", "tir": "tyres/book.tir", "axes": "left"}, r"axes: expected iso or adapted_sae"),
        ({"model": "magic_formula", "tir": "tyres/book.tir", "grip": 1.0}, r"grip: Extra inputs are not permitted"),
    ],
)
def test_faults_of_tyre_files_are_reported_at_the_line_that_names_them(with_tyres, tyre, complaint):
    with pytest.raises(InputError, match=complaint):
        load_vehicle(with_tyres(tyre))


def test_a_tyre_on_its_own_is_read_from_yaml_too(tmp_path):
    assert load_tyre(FOLDER / "fiala.yaml").slip_stiffness == 86000.0
    (tmp_path / "a.yaml").write_text("model: fiala\nslip_stiffness: -1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.yaml: fiala\.slip_stiffness: Input should be greater than 0"):
        load_tyre(tmp_path / "a.yaml")
