"""`vsense can` on databases of our own, with names of other languages: what is found, and whether its mapping works."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cantools
import numpy as np
import pytest
from click.testing import CliRunner

import vsense_ros as vs
from vsense_ros.bag.can_names import likeness, plain, side_keys
from vsense_ros.bag.can_survey import survey
from vsense_ros.cli import main

START = 1_700_000_000.0
TIME = np.arange(0.0, 40.0, 0.04)
RATIO, TRACK, WHEELBASE = 14.0, 1.6, 2.6

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: ECU\n'
# One bus in three languages: wheels in two messages, a magnitude with a sign bit, axes positive to the right, missing
# units, and signals beside them whose names or values are like those that are looked for.
GERMAN = (
    HEAD
    + """
BO_ 257 Raddrehzahlen: 8 ECU
 SG_ Radgeschw_VL : 0|16@1+ (0.01,0) [0|400] "km/h" ECU
 SG_ Radgeschw_VR : 16|16@1+ (0.01,0) [0|400] "km/h" ECU
 SG_ Radgeschw_HL : 32|16@1+ (0.01,0) [0|400] "km/h" ECU
 SG_ Radgeschw_HR : 48|16@1+ (0.01,0) [0|400] "km/h" ECU

BO_ 258 Lenkung: 8 ECU
 SG_ Lenkradwinkel : 0|15@1+ (0.1,0) [0|1000] "Grad" ECU
 SG_ Lenkradwinkel_VZ : 15|1@1+ (1,0) [0|1] "" ECU
 SG_ Lenkradwinkel_Geschw : 16|16@1- (0.5,0) [-2000|2000] "Grad/s" ECU
 SG_ Solllenkwinkel : 32|16@1- (0.1,0) [-1000|1000] "Grad" ECU

BO_ 259 Fahrdynamik: 8 ECU
 SG_ Gierrate : 0|16@1- (0.01,0) [-160|160] "Grad/s" ECU
 SG_ Querbeschleunigung : 16|16@1- (0.001,0) [-20|20] "m/s^2" ECU
 SG_ Laengsbeschleunigung : 32|16@1- (0.001,0) [-20|20] "m/s^2" ECU
 SG_ Gierrate_Status : 48|8@1+ (1,0) [0|255] "" ECU
"""
)
FRENCH = (
    HEAD
    + """
BO_ 512 ROUES_AV: 8 ECU
 SG_ VIT_ROUE_AVG : 0|16@1+ (0.01,0) [0|400] "km/h" ECU
 SG_ VIT_ROUE_AVD : 16|16@1+ (0.01,0) [0|400] "km/h" ECU

BO_ 513 ROUES_AR: 8 ECU
 SG_ VIT_ROUE_ARG : 0|16@1+ (0.01,0) [0|400] "km/h" ECU
 SG_ VIT_ROUE_ARD : 16|16@1+ (0.01,0) [0|400] "km/h" ECU

BO_ 514 DIRECTION: 8 ECU
 SG_ ANGLE_VOLANT : 0|16@1- (0.1,0) [-3000|3000] "deg" ECU
 SG_ VITESSE_VOLANT : 16|16@1- (1,0) [-3000|3000] "deg/s" ECU

BO_ 515 DYNAMIQUE: 8 ECU
 SG_ VITESSE_LACET : 0|16@1- (0.0002,0) [-6|6] "" ECU
 SG_ ACCEL_TRANSVERSALE : 16|16@1- (0.0001,0) [-3|3] "" ECU
 SG_ ACCEL_LONGITUDINALE : 32|16@1- (0.001,0) [0|1] "m/s2" ECU
 SG_ CONSIGNE_LACET : 48|16@1- (0.0002,0) [-6|6] "" ECU
"""
)


def drive() -> dict[str, np.ndarray]:
    speed = 14 + 6 * np.sin(2 * np.pi * TIME / 23)
    curvature = 0.014 * np.sin(2 * np.pi * TIME / 9) + 0.005 * np.sin(2 * np.pi * TIME / 3.1)
    rate = speed * curvature
    found = {
        "speed": speed,
        "steering": RATIO * WHEELBASE * curvature,
        "yaw_rate": rate,
        "lateral": speed * rate,
        "longitudinal": np.gradient(speed, TIME),
    }
    for side in ("fl", "fr", "rl", "rr"):
        found[side] = speed + (1 if side[1] == "r" else -1) * TRACK / 2 * rate
    return found


def write_log(folder: Path, dbc: str, values: Mapping[str, np.ndarray]) -> tuple[Path, Path]:
    """A log (candump) of all messages of a database every 40 ms, with these physical values by signal, else zero."""
    database, log = folder / "car.dbc", folder / "car.log"
    database.write_text(dbc, encoding="utf-8")
    lines = []
    for message in cantools.database.load_string(dbc, "dbc").messages:
        for row, time in enumerate(TIME):
            content = {s.name: values[s.name][row] if s.name in values else 0.0 for s in message.signals}
            data = message.encode(content, strict=False)
            lines.append(f"({START + time:.6f}) can0 {message.frame_id:03X}#{data.hex().upper()}\n")
    log.write_text("".join(sorted(lines)), encoding="utf-8")
    return log, database


@pytest.fixture
def german(tmp_path) -> tuple[Path, Path]:
    truth, degree = drive(), np.degrees
    noise = np.random.default_rng(1).standard_normal((2, len(TIME)))
    sides = {"VL": "fl", "VR": "fr", "HL": "rl", "HR": "rr"}
    values = {f"Radgeschw_{name}": 3.6 * truth[side] for name, side in sides.items()}
    return write_log(
        tmp_path,
        GERMAN,
        {
            **values,
            "Lenkradwinkel": np.abs(degree(truth["steering"])),
            "Lenkradwinkel_VZ": (truth["steering"] < 0).astype(float),
            "Lenkradwinkel_Geschw": degree(np.gradient(truth["steering"], TIME)),
            "Solllenkwinkel": 20 * noise[0],
            "Gierrate": degree(truth["yaw_rate"]),
            "Querbeschleunigung": -truth["lateral"],
            "Laengsbeschleunigung": truth["longitudinal"],
            "Gierrate_Status": np.mod(np.arange(len(TIME)), 200.0),
        },
    )


@pytest.fixture
def french(tmp_path) -> tuple[Path, Path]:
    truth = drive()
    sides = {"AVG": "fl", "AVD": "fr", "ARG": "rl", "ARD": "rr"}
    values = {f"VIT_ROUE_{name}": 3.6 * truth[side] for name, side in sides.items()}
    return write_log(
        tmp_path,
        FRENCH,
        {
            **values,
            "ANGLE_VOLANT": -np.degrees(truth["steering"]),
            "VITESSE_VOLANT": -np.degrees(np.gradient(truth["steering"], TIME)),
            "VITESSE_LACET": truth["yaw_rate"],
            "ACCEL_TRANSVERSALE": truth["lateral"] / 9.80665,
            "ACCEL_LONGITUDINALE": truth["longitudinal"],
            "CONSIGNE_LACET": truth["yaw_rate"],
        },
    )


@pytest.mark.parametrize("language", ["german", "french"])
def test_the_proposed_mapping_imports_unedited_what_the_car_did(language, request, tmp_path):
    """Whatever sign, unit and message a signal has: in the bag stand SI units and axes of ISO 8855."""
    log, dbc = request.getfixturevalue(language)
    done = CliRunner().invoke(main, ["can", str(log), "--dbc", str(dbc), "--output", str(tmp_path / "car.yaml")])
    assert done.exit_code == 0, done.output
    missing = [line for line in done.output.splitlines() if line.startswith("Not recognized")]
    assert set(missing) <= {"Not recognized: speed."}  # which neither bus has
    recording = vs.read(log, dbc=dbc, mapping=tmp_path / "car.yaml")
    truth = drive()
    wheels = recording["vehicle/wheel_speeds"]
    rim = wheels.columns["velocity"] * 0.32
    for column, name in enumerate(wheels.names):
        good = np.isfinite(rim[:, column])
        np.testing.assert_allclose(rim[good, column], truth[name.removeprefix("wheel_")], atol=0.01)
    imu = recording["imu/data"]
    for field, axis, quantity in (
        ("angular_velocity", 2, "yaw_rate"),
        ("linear_acceleration", 0, "longitudinal"),
        ("linear_acceleration", 1, "lateral"),
    ):
        np.testing.assert_allclose(imu.columns[field][:, axis], truth[quantity], atol=0.01)
    steering = recording["vehicle/steering"].columns["position"][:, 0]
    np.testing.assert_allclose(steering, truth["steering"], atol=0.01)


def test_guess_proposes_the_same_mapping_for_a_can_log(german):
    log, dbc = german
    done = CliRunner().invoke(main, ["import", str(log), "--dbc", str(dbc), "--guess"])
    assert done.exit_code == 0, done.output
    assert vs.survey_can(log, [dbc]).mapping() in done.output
    refused = CliRunner().invoke(main, ["import", str(log), "--guess"])
    assert refused.exit_code == 2
    assert "--dbc FILE" in refused.output


def test_a_magnitude_is_proposed_with_the_bit_of_its_sign(german):
    content = vs.survey_can(german[0], [german[1]])
    steering = content.roles.steering_wheel
    assert steering is not None
    assert steering.sign is not None
    assert (steering.signal.name, steering.sign.name) == ("Lenkradwinkel", "Lenkradwinkel_VZ")
    assert "sign: {signal: Lenkradwinkel_VZ" in content.mapping()


def test_without_a_database_identifiers_and_rates_are_listed(german):
    done = CliRunner().invoke(main, ["can", str(german[0])])
    assert done.exit_code == 0, done.output
    assert "0x101" in done.output
    assert "25 Hz" in done.output
    assert "Without a database" in done.output
    refused = CliRunner().invoke(main, ["can", str(german[0]), "--output", "x.yaml"])
    assert refused.exit_code == 2
    assert "--dbc FILE" in refused.output


def test_rates_and_ranges_are_those_of_the_log(german):
    heard = survey(*german[:1], [german[1]])
    assert [message.identifier for message in heard.messages] == [257, 258, 259]
    (rate,) = [signal for signal in heard.signals if signal.name == "Gierrate"]
    assert rate.rate == pytest.approx(25.0, rel=0.01)
    assert rate.high == pytest.approx(np.degrees(drive()["yaw_rate"].max()), abs=0.01)
    assert rate.unit == "Grad/s"


def test_a_bus_without_motion_gives_no_mapping(tmp_path):
    dbc = HEAD + 'BO_ 1 Klima: 8 ECU\n SG_ Temperatur : 0|8@1+ (1,-40) [-40|200] "C" ECU\n'
    log, database = write_log(tmp_path, dbc, {})
    done = CliRunner().invoke(main, ["can", str(log), "--dbc", str(database), "--output", str(tmp_path / "x.yaml")])
    assert done.exit_code == 2
    assert "no signal looks like wheel speeds" in done.output
    assert not (tmp_path / "x.yaml").exists()


def test_a_parked_car_is_recognized_by_its_names_and_that_is_said(tmp_path):
    log, database = write_log(tmp_path, GERMAN, {})
    content = vs.survey_can(log, [database])
    assert content.roles.yaw_rate is not None
    assert content.roles.yaw_rate.signal.name == "Gierrate"
    assert "by its name alone" in content.mapping()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("VSELatAcc", "vse_lat_acc"),
        ("ESP_VL_Radgeschw_02", "esp_vl_radgeschw"),
        ("StePinComp_An_Est", "ste_pin_comp_an_est"),
    ],
)
def test_names_are_divided_into_words(name, words):
    assert plain(name) == words


@pytest.mark.parametrize(
    ("concept", "name", "message"),
    [
        ("wheel_speed", "Radgeschw__HR_4_1", "Bremse_3"),
        ("wheel_speed", "FL", "Wheel_Speeds"),
        ("yaw_rate", "VehYaw_W_Actl", "Yaw_Data_FD1"),
        ("yaw_rate", "VITESSE_LACET", "DYN"),
        ("steering_wheel", "LW1_LRW", "Lenkwinkel_1"),
        ("steering_wheel", "StrgWhlAngHSC2", "SAS"),
        ("lateral_acceleration", "VehLat2_A_Actl", "Accel_Data_FD1"),
        ("longitudinal_acceleration", "BR8_Laengsbeschl", "Bremse_8"),
    ],
)
def test_names_of_three_languages_are_understood(concept, name, message):
    assert likeness(concept, name, message) > 0.5


@pytest.mark.parametrize(
    ("concept", "name"),
    [
        ("wheel_speed", "WHL_PUL_FL"),
        ("yaw_rate", "ESP_QBit_Gierrate"),
        ("steering_wheel", "STEER_ANGLE_RATE"),
        ("steering_wheel", "DAS_steeringAngleRequest"),
        ("lateral_acceleration", "LateralDistance"),
        ("longitudinal_acceleration", "ACC_Sollbeschleunigung"),
    ],
)
def test_what_only_sounds_like_a_measurement_is_none(concept, name):
    assert likeness(concept, name, "X") == 0.0


def test_wheels_are_told_apart_by_the_part_of_a_name_that_differs():
    names = {"fl": "P263_WhlFrtL", "fr": "P264_WhlFrtR", "rl": "P265_WhlBckL", "rr": "P266_WhlBckR"}
    keys = {
        wheel: {(row, key) for row, of_wheel, key in side_keys(name) if of_wheel == wheel}
        for wheel, name in names.items()
    }
    assert set.intersection(*keys.values())
