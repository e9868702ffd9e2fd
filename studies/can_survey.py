"""`vsense can` on cars of opendbc: are the signals that measure the car's motion found among all others?

A log is made of each database: a drive with bends, braking and driving whose speeds, rates, accelerations and steering
angle go into the signals that carry them by their meaning in openpilot, while all other signals of all messages get
constants, counters and random walks. What is found is compared with that meaning, and the proposed mapping is used.

The databases are not part of this project: github.com/commaai/opendbc, whose folder `opendbc/dbc` is given.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from cantools.database import Message
from numpy.typing import NDArray

from vsense_ros.api.can import survey_can
from vsense_ros.bag.can_names import WHEEL_SIDES
from vsense_ros.bag.can_roles import Recognized, Roles
from vsense_ros.bag.importers import import_recording
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_signal import SignalField
from vsense_ros.errors import InputError
from vsense_ros.messages.units import to_si

Array = NDArray[np.float64]

ROLES = ("wheels", "steering_wheel", "yaw_rate", "lateral_acceleration", "longitudinal_acceleration")
_IMPORT = re.compile(r'CM_ "IMPORT (.*?)";\n')
_DURATION, _RATE, _OTHER_RATE = 60.0, 25.0, 1.0  # [s], [Hz] of the messages that count, and of all others
_RADIUS = 0.33  # [m]
_BEGIN = 1_700_000_000  # [s] Unix time


@dataclass(frozen=True)
class Car:
    """A database and the signals of each role, as `message.signal unit`, with `-` before the unit where the signal is
    positive to the right or backwards, and `±signal` for the bit of a magnitude's sign. Several may carry a role."""

    file: str
    roles: Mapping[str, tuple[str, ...]]


def _wheels(message: str, pattern: str, unit: str, sides: str = "FL FR RL RR") -> tuple[str, ...]:
    """The four wheels, where `*` of a message's and a signal's name stands for the side."""
    return tuple(f"{message}.{pattern.replace('*', side)} {unit}" for side in sides.split())


def _axles(front: str, rear: str, pattern: str, unit: str, sides: str = "FL FR RL RR") -> tuple[str, ...]:
    names = sides.split()
    return tuple(
        f"{message}.{pattern.replace('*', side)} {unit}"
        for message, side in zip((front, front, rear, rear), names, strict=True)
    )


CARS: Mapping[str, Car] = {
    "Toyota (TSS 2)": Car(
        "generator/toyota/toyota_nodsu_pt.dbc",
        {
            "wheels": _wheels("WHEEL_SPEEDS", "WHEEL_SPEED_*", "km/h"),
            "steering_wheel": ("STEER_ANGLE_SENSOR.STEER_ANGLE deg", "STEER_TORQUE_SENSOR.STEER_ANGLE deg"),
            "yaw_rate": ("KINEMATICS.YAW_RATE deg/s",),
            "lateral_acceleration": ("KINEMATICS.ACCEL_Y -m/s²",),
            "longitudinal_acceleration": ("KINEMATICS.ACCEL_X m/s²",),
        },
    ),
    "Honda Civic": Car(
        "generator/honda/honda_civic_touring_2016_can.dbc",
        {
            "wheels": _wheels("WHEEL_SPEEDS", "WHEEL_SPEED_*", "km/h"),
            "steering_wheel": ("STEERING_SENSORS.STEER_ANGLE deg", "STEERING_SENSORS.STEER_WHEEL_ANGLE deg"),
            "lateral_acceleration": ("VEHICLE_DYNAMICS.LAT_ACCEL -m/s²", "KINEMATICS.LAT_ACCEL -m/s²"),
            "longitudinal_acceleration": ("VEHICLE_DYNAMICS.LONG_ACCEL m/s²", "KINEMATICS.LONG_ACCEL m/s²"),
        },
    ),
    "GM Global A": Car(
        "generator/gm/gm_global_a_powertrain.dbc",
        {
            "wheels": _axles("EBCMWheelSpdFront", "EBCMWheelSpdRear", "*WheelSpd", "km/h"),
            "steering_wheel": ("PSCMSteeringAngle.SteeringWheelAngle deg",),
            "yaw_rate": ("EBCMVehicleDynamic.YawRate deg/s", "EBCMVehicleDynamic.YawRate2 deg/s"),
            "lateral_acceleration": ("EBCMVehicleDynamic.LateralAcceleration m/s²",),
        },
    ),
    "Cadillac CT6": Car(
        "cadillac_ct6_powertrain.dbc",
        {
            "wheels": _axles("EBCMWheelSpdFront", "EBCMWheelSpdRear", "*WheelSpd", "km/h"),
            "steering_wheel": ("PSCMSteeringAngle.SteeringWheelAngle -deg",),
            "yaw_rate": ("EBCMVehicleDynamic.YawRate deg/s",),
            "lateral_acceleration": ("EBCMVehicleDynamic.LateralAcceleration m/s²",),
        },
    ),
    "Hyundai 2015": Car(
        "hyundai_2015_ccan.dbc",
        {
            "wheels": _wheels("WHL_SPD11", "WHL_SPD_*", "km/h"),
            "steering_wheel": ("SAS11.SAS_Angle deg", "MDPS11.CR_Mdps_StrAng deg"),
            "yaw_rate": ("ESP12.YAW_RATE deg/s",),
            "lateral_acceleration": ("ESP12.LAT_ACCEL -m/s²",),
            "longitudinal_acceleration": ("ESP12.LONG_ACCEL m/s²",),
        },
    ),
    "Hyundai CAN FD": Car(
        "generator/hyundai/hyundai_canfd.dbc",
        {
            "wheels": _wheels("WHEEL_SPEEDS", "WHL_Spd*Val", "km/h"),
            "steering_wheel": ("STEERING_SENSORS.STEERING_ANGLE deg",),
            "yaw_rate": ("IMU_01_10ms.IMU_YawRtVal deg/s", "ESC_02_10ms.ESC_YawRtVal deg/s"),
            "lateral_acceleration": ("IMU_01_10ms.IMU_LatAccelVal g", "ESC_02_10ms.ESC_LatAccelVal g"),
            "longitudinal_acceleration": ("IMU_01_10ms.IMU_LongAccelVal g", "ESC_02_10ms.ESC_LongAccelVal g"),
        },
    ),
    "Nissan Leaf": Car(
        "generator/nissan/nissan_leaf_2018.dbc",
        {
            "wheels": _axles("WHEEL_SPEEDS_FRONT", "WHEEL_SPEEDS_REAR", "WHEEL_SPEED_*", "km/h"),
            "steering_wheel": ("STEER_ANGLE_SENSOR.STEER_ANGLE deg", "STEER_TORQUE_SENSOR.STEER_ANGLE deg"),
        },
    ),
    "Subaru Global": Car(
        "generator/subaru/subaru_global_2017.dbc",
        {
            "wheels": _wheels("Wheel_Speeds", "*", "km/h"),
            "steering_wheel": (
                "Steering_Torque.Steering_Angle deg",
                "Steering.Steering_Angle deg",
                "Steering_2.Steering_Angle deg",
                "Brake_Pressure_L_R.Steering_Angle deg",
            ),
            "lateral_acceleration": ("G_Sensor.Lateral -m/s²",),
            "longitudinal_acceleration": ("G_Sensor.Longitudinal m/s²",),
        },
    ),
    "Mazda CX-5": Car(
        "mazda_2017.dbc",
        {
            "wheels": _wheels("WHEEL_SPEEDS", "*", "km/h"),
            "steering_wheel": ("STEER.STEER_ANGLE deg", "STEER2.STEER_ANGLE deg"),
        },
    ),
    "Volkswagen MQB": Car(
        "vw_mqb.dbc",
        {
            "wheels": _wheels("ESP_19", "ESP_*_Radgeschw_02", "km/h", "VL VR HL HR"),
            "steering_wheel": ("LWI_01.LWI_Lenkradwinkel deg ±LWI_VZ_Lenkradwinkel",),
            "yaw_rate": ("ESP_02.ESP_Gierrate deg/s ±ESP_VZ_Gierrate",),
            "lateral_acceleration": ("ESP_02.ESP_Querbeschleunigung g",),
            "longitudinal_acceleration": ("ESP_02.ESP_Laengsbeschl m/s²",),
        },
    ),
    "Volkswagen PQ": Car(
        "vw_pq.dbc",
        {
            "wheels": _wheels("Bremse_3", "Radgeschw__*_4_1", "km/h", "VL VR HL HR"),
            "steering_wheel": ("Lenkwinkel_1.LW1_LRW deg ±LW1_LRW_Sign",),
            "yaw_rate": ("Bremse_5.BR5_Giergeschw deg/s ±BR5_Vorzeichen",),
            "lateral_acceleration": ("Bremse_2.Querbeschleunigung g",),
            "longitudinal_acceleration": ("Bremse_8.BR8_Laengsbeschl m/s²",),
        },
    ),
    "Audi MLB": Car(
        "vw_mlb.dbc",
        {
            "wheels": _wheels("ESP_03", "ESP_*_Radgeschw", "km/h", "VL VR HL HR"),
            "steering_wheel": ("LWI_01.LWI_Lenkradwinkel deg ±LWI_VZ_Lenkradwinkel",),
            "yaw_rate": ("ESP_02.ESP_Gierrate deg/s ±ESP_VZ_Gierrate",),
            "lateral_acceleration": ("ESP_02.ESP_Querbeschleunigung g",),
            "longitudinal_acceleration": ("ESP_02.ESP_Laengsbeschl m/s²",),
        },
    ),
    "Volkswagen MEB": Car(
        "generator/volkswagen/vw_meb.dbc",
        {
            "wheels": _wheels("ESC_51", "*_Radgeschw", "km/h", "VL VR HL HR"),
            "steering_wheel": (
                "LWI_01.LWI_Lenkradwinkel deg ±LWI_VZ_Lenkradwinkel",
                "QFK_01.Steering_Angle deg ±Steering_Angle_VZ",
            ),
            "yaw_rate": ("ESC_50.Yaw_Rate deg/s ±Yaw_Rate_Sign",),
            "lateral_acceleration": ("ESC_50.Lateral_Accel m/s²",),
            "longitudinal_acceleration": ("ESC_50.Longitudinal_Accel m/s²",),
        },
    ),
    "Tesla Model 3": Car(
        "tesla_model3_party.dbc",
        {
            "wheels": _wheels("ESP_wheelSpeeds", "ESP_wheelSpeed*", "km/h", "FrL FrR ReL ReR"),
            "steering_wheel": ("SCCM_steeringAngleSensor.SCCM_steeringAngle -deg",),
        },
    ),
    "Ford": Car(
        "ford_lincoln_base_pt.dbc",
        {
            "wheels": _wheels("WheelSpeed", "Whl*_W_Meas", "rad/s", "Fl Fr Rl Rr"),
            "steering_wheel": (
                "SteeringPinion_Data.StePinComp_An_Est -deg",
                "SteeringPinion_Data_Alt.StePinComp_An_Est -deg",
            ),
            "yaw_rate": ("Yaw_Data_FD1.VehYaw_W_Actl rad/s", "BrakeSnData_3.VehYawComp_W_Actl deg/s"),
            "lateral_acceleration": ("Accel_Data_FD1.VehLat2_A_Actl m/s²", "BrakeSnData_3.VehLatComp_A_Actl m/s²"),
            "longitudinal_acceleration": (
                "Accel_Data_FD1.VehLong2_A_Actl m/s²",
                "BrakeSnData_3.VehLongComp_A_Actl m/s²",
                "DesiredTorqBrk.VehLongOvrGnd_A_Est m/s²",
            ),
        },
    ),
    "Chrysler Pacifica": Car(
        "generator/chrysler/chrysler_pacifica_2017_hybrid.dbc",
        {
            "wheels": _wheels("ESP_6", "WHEEL_SPEED_*", "rpm"),
            "steering_wheel": ("STEERING.STEERING_ANGLE deg", "STEERING_2.STEER_ANGLE_2 deg"),
        },
    ),
    "Alfa Romeo Giulia": Car(
        "fca_giorgio.dbc",
        {
            "wheels": _wheels("ABS_1", "WHEEL_SPEED_*", "m/s"),
            "steering_wheel": ("EPS_1.STEERING_ANGLE deg",),
            "yaw_rate": ("ABS_2.YAW_RATE rad/s", "ABS_7.YAW_RATE_RAW rad/s"),
            "lateral_acceleration": ("ABS_2.LATERAL_ACCEL m/s²", "ABS_7.LATERAL_ACCEL_RAW m/s²"),
            "longitudinal_acceleration": ("ABS_2.LONG_ACCEL m/s²", "ABS_7.LONG_ACCEL_RAW m/s²"),
        },
    ),
    "BMW E90": Car(
        "bmw_e9x_e8x.dbc",
        {
            "wheels": _wheels("WheelSpeeds", "Wheel_*", "km/h"),
            "steering_wheel": (
                "SteeringWheelAngle.SteeringPosition deg",
                "SteeringWheelAngle_DSC.SteeringPosition deg",
                "SteeringWheelAngle_slow.SteeringPosition deg",
            ),
            "yaw_rate": ("Speed.YawRate deg/s", "Accelerometer1.YawRate deg/s", "Accelerometer2.YawRate deg/s"),
            "lateral_acceleration": ("Accelerometer2.LateralAcceleration m/s²",),
        },
    ),
    "Peugeot AEE2010": Car(
        "psa_aee2010_r3.dbc",
        {
            "wheels": (
                "Dyn4_FRE.P263_VehV_VPsvValWhlFrtL km/h",
                "Dyn4_FRE.P264_VehV_VPsvValWhlFrtR km/h",
                "Dyn4_FRE.P265_VehV_VPsvValWhlBckL km/h",
                "Dyn4_FRE.P266_VehV_VPsvValWhlBckR km/h",
            ),
            "steering_wheel": ("STEERING.ANGLE deg", "STEERING_ALT.ANGLE deg"),
            "longitudinal_acceleration": (
                "HS2_DYN_UCF_MDD_32D.ACCEL_LONGI_CALIB m/s²",
                "HS2_DYN_ABR_38D.ACCEL_LONGI_ROUES m/s²",
            ),
        },
    ),
    "Volvo V60": Car(
        "volvo_v60_2015_pt.dbc",
        {
            "wheels": _axles("wheelspeed0", "wheelspeed1", "WhlSpd*", "km/h", "LF RF LR RR"),
            "steering_wheel": ("SAS0.SteeringAngle deg ±SteeringDirection", "fromWhere.SteeringAngle deg"),
        },
    ),
}


def examine(folder: Path) -> dict[str, Any]:
    """What `vsense can` finds on each car; `folder` is `opendbc/dbc`. Raises `InputError` where that is not there."""
    if not (folder / "generator").is_dir():
        raise InputError(f"{folder}: the databases of opendbc are not here; clone github.com/commaai/opendbc")
    cars: dict[str, Any] = {}
    with TemporaryDirectory() as temporary:
        for seed, (name, car) in enumerate(CARS.items()):
            cars[name] = _examined(Path(temporary), folder, car, np.random.default_rng(seed))
    complete = sum(all(car["roles"].values()) for car in cars.values())
    return {"found": complete, "of": len(cars), "cars": cars}


def _examined(temporary: Path, folder: Path, car: Car, rng: np.random.Generator) -> dict[str, Any]:
    dbc, log, mapping = temporary / "car.dbc", temporary / "car.log", temporary / "car.yaml"
    dbc.write_text(database(folder / car.file), encoding="utf-8")
    truth = drive(rng)
    log.write_text(candump(dbc, car, truth, rng), encoding="utf-8")
    content = survey_can(log, [dbc])
    found = {role: _is_found(content.roles, role, car.roles[role]) for role in ROLES if role in car.roles}
    try:
        mapping.write_text(content.mapping(), encoding="utf-8")
        recording = import_recording(log, dbc=dbc, mapping=mapping)
    except InputError as error:
        return {"roles": found, "imports": str(error)}
    return {"roles": found, "imports": sorted(recording.channels), "errors": _errors(recording, truth)}


def database(path: Path) -> str:
    """The text of a database with what it imports, as opendbc's generator puts it together."""
    text = path.read_text(encoding="utf-8", errors="replace")
    parts = [(path.parent / name).read_text(encoding="utf-8") for name in _IMPORT.findall(text)]
    return "\n".join([*parts, _IMPORT.sub("", text)])


def drive(rng: np.random.Generator) -> dict[str, Array]:
    """A drive of a car with unknown track, wheelbase and ratio: quantities [SI, ISO 8855] over time [s]."""
    time = np.arange(0.0, _DURATION, 1.0 / _RATE)
    phase = rng.uniform(0, 2 * np.pi, 4)
    speed = 15 + 7 * np.sin(2 * np.pi * time / 31 + phase[0]) + 3 * np.sin(2 * np.pi * time / 9 + phase[1])
    curvature = 0.012 * np.sin(2 * np.pi * time / 11 + phase[2]) + 0.006 * np.sin(2 * np.pi * time / 4.3 + phase[3])
    yaw_rate = speed * curvature
    track, wheelbase, ratio = rng.uniform(1.45, 1.65), rng.uniform(2.5, 3.0), rng.uniform(12, 18)
    understeer = 1 + (speed / 28) ** 2
    quantities = {
        "time": time,
        "steering_wheel": ratio * wheelbase * curvature * understeer + 0.005 * rng.standard_normal(len(time)),
        "yaw_rate": yaw_rate + 0.002 * rng.standard_normal(len(time)),
        "lateral_acceleration": speed * yaw_rate + 0.1 * rng.standard_normal(len(time)),
        "longitudinal_acceleration": np.gradient(speed, time) + 0.05 * rng.standard_normal(len(time)),
        "speed": speed,
    }
    for side in WHEEL_SIDES:
        half = track / 2 if side.endswith("r") else -track / 2
        turned = np.hypot(speed + half * yaw_rate, wheelbase * yaw_rate * side.startswith("f"))
        quantities[f"wheel_{side}"] = turned + 0.01 * rng.standard_normal(len(time))
    return quantities


def candump(dbc: Path, car: Car, truth: Mapping[str, Array], rng: np.random.Generator) -> str:
    """A log of all messages of a database: those that count at `_RATE` with the drive, the others once a second."""
    filled: dict[str, dict[str, Array]] = {}
    for role, carriers in car.roles.items():
        for place, carrier in enumerate(carriers):
            quantity = f"wheel_{WHEEL_SIDES[place]}" if role == "wheels" else role
            label, unit, *bit = carrier.split(" ")
            message, name = label.split(".")
            value = truth[quantity] / to_si(unit.lstrip("-")) * (-1 if unit.startswith("-") else 1)
            if role == "wheels" and unit in ("rad/s", "rpm"):
                value = value / _RADIUS
            signals = filled.setdefault(message, {})
            signals[name] = np.abs(value) if bit else value
            if bit:
                signals[bit[0].lstrip("±")] = (value < 0).astype(float)
    lines: list[tuple[float, str]] = []
    for message in read_database(dbc).database.messages:
        mine = filled.get(message.name, {})
        step = 1 if mine else round(_RATE / _OTHER_RATE)
        lines += _frames(message, mine, truth["time"], step, rng)
    return "".join(line for _, line in sorted(lines))


def _frames(
    message: Message, mine: Mapping[str, Array], time: Array, step: int, rng: np.random.Generator
) -> list[tuple[float, str]]:
    """Frames of a message with the signals in `mine`, and in those bits that are left with whatever other signals."""
    rows = np.arange(0, len(time), step)
    fields = {signal.name: SignalField.of(signal, message) for signal in message.signals}
    # The page of a multiplexed message on which the signals that count are.
    page = {selector.name: min(values) for name in mine for selector, values in fields[name].pages}
    taken, columns = 0, []
    for name in sorted(fields, key=lambda one: one not in {*mine, *page}):
        field = fields[name]
        if field.last >= message.length:
            continue
        mask = _placed((1 << field.length) - 1, field, message.length)
        if mask & taken:
            continue
        taken |= mask
        low, high = field.raw_range
        if name in mine:
            raw = np.clip(np.round((mine[name][rows] - field.offset) / field.scale), low, high).astype(object)
        elif name in page:
            raw = np.full(len(rows), page[name], dtype=object)
        elif rng.uniform() < 0.5:
            raw = np.full(len(rows), int(rng.integers(low, min(high, low + 2**31), endpoint=True)), dtype=object)
        else:
            walk = np.cumsum(rng.integers(-3, 4, len(rows))).astype(object)
            raw = low + walk % (high - low + 1)
        columns.append((field, raw))
    delay = rng.uniform(0, 1 / _RATE)
    width, mark = 8 if message.is_extended_frame else 3, "##0" if message.length > 8 else "#"
    found = []
    for row, index in enumerate(rows):
        bits = 0
        for field, raw in columns:
            bits |= _placed(int(raw[row]) & ((1 << field.length) - 1), field, message.length)
        data = bits.to_bytes(message.length, "big").hex().upper()
        at = _BEGIN + time[index] + delay
        found.append((at, f"({at:.6f}) can0 {message.frame_id:0{width}X}{mark}{data}\n"))
    return found


def _placed(raw: int, field: SignalField, length: int) -> int:
    """The bits of a signal in its place in the data of a message, as one number, first byte first."""
    if field.big_endian:
        return raw << (field.shift + 8 * (length - 1 - field.last))
    return int.from_bytes((raw << (field.shift + 8 * field.first)).to_bytes(length + 8, "little")[:length], "big")


def _is_found(roles: Roles, role: str, carriers: tuple[str, ...]) -> bool:
    """True if a role is given to one of the signals that carry it; all wheels to theirs, each with its sign bit."""
    if role == "wheels":
        labels = {side: one.signal.label for side, one in roles.wheels.items()}
        return labels == {side: carrier.split(" ")[0] for side, carrier in zip(WHEEL_SIDES, carriers, strict=True)}
    found: Recognized | None = getattr(roles, role)
    if found is None:
        return False
    sign = f" ±{found.sign.name}" if found.sign is not None else ""
    wanted = {(c.split(" ")[0] + "".join(f" {part}" for part in c.split(" ")[2:])) for c in carriers}
    return found.signal.label + sign in wanted


def _errors(recording: Any, truth: Mapping[str, Array]) -> dict[str, float]:
    """Relative errors of what the proposed mapping imports, where its unit and sign are right a few percent."""
    found = {}
    places = {
        "yaw_rate": ("imu/data", "angular_velocity", 2),
        "lateral_acceleration": ("imu/data", "linear_acceleration", 1),
        "longitudinal_acceleration": ("imu/data", "linear_acceleration", 0),
        "steering_wheel": ("vehicle/steering", "position", 0),
    }
    for role, (topic, field, column) in places.items():
        if topic not in recording:
            continue
        channel = recording[topic]
        values = channel.columns[field][:, column]
        good = np.isfinite(values)
        covariance = channel.columns.get(f"{field}_covariance")
        if covariance is not None:
            good &= covariance[:, 0] != -1  # parts of the message that another frame gives
        if good.any():
            at = channel.stamp[good] * 1e-9 - _BEGIN
            expected = np.interp(at, truth["time"], truth[role])
            found[role] = float(np.std(values[good] - expected) / np.std(truth[role]))
    return found


def report(result: Mapping[str, Any]) -> str:
    """The examination as lines."""
    lines = [f"{'car':<20} {'wheels':>7} {'steering':>9} {'yaw rate':>9} {'lateral':>8} {'longit.':>8}  imported"]
    for name, car in result["cars"].items():
        marks = ["–" if role not in car["roles"] else "yes" if car["roles"][role] else "NO" for role in ROLES]
        imported = car["imports"] if isinstance(car["imports"], str) else f"{len(car['imports'])} topics"
        widths = (7, 9, 9, 8, 8)
        cells = " ".join(f"{mark:>{width}}" for mark, width in zip(marks, widths, strict=True))
        wrong = [role for role, error in car.get("errors", {}).items() if error > 0.3 and role in car["roles"]]
        lines.append(f"{name:<20} {cells}  {imported}{'; wrong values of ' + ', '.join(wrong) if wrong else ''}")
    lines.append(f"all signals of {result['found']} of {result['of']} cars")
    return "\n".join(lines)


def run(folder: Path, out: Path) -> None:
    """Examine, print, and write the figures as JSON."""
    result = examine(folder)
    print(report(result))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
