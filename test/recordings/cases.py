"""What public bug reports show of recordings, each made anew: what was given, and what has to come of it.

Each case is a function that takes an empty folder and raises `AssertionError` where the outcome is another.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from functools import reduce
from pathlib import Path

import can
import numpy as np
import pytest

from recordings import planted
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.bag.importers import build, import_recording
from vsense_ros.checks.inspect import inspect
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_log import read_frames
from vsense_ros.driver.can_mapping import CanMapping
from vsense_ros.driver.imu import ImuSettings, XbusDecoder
from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.ubx import UbxDecoder, fletcher
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.tir import read_tir
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.sensors import unheard

NOON = 1_714_564_800  # 2024-05-01 12:00:00 UTC
SECOND = 1_000_000_000

DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 37 STEER: 8 X
 SG_ ANGLE : 7|16@0+ (0.1,-3276.8) [0|6553.5] "deg" X
BO_ 2364540158 EEC1: 8 X
 SG_ SPEED : 24|16@1+ (0.125,0) [0|8031.875] "rpm" X
BO_ 256 MUX: 8 X
 SG_ SEL M : 0|8@1+ (1,0) [0|255] "" X
 SG_ YAW : 8|16@1- (0.01,0) [-320|320] "deg/s" X
 SG_ P0 m0 : 32|8@1+ (1,0) [0|255] "" X
 SG_ P1 m1 : 32|8@1+ (1,0) [0|255] "" X
BO_ 512 FD18: 18 X
 SG_ WFL : 0|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ WRR : 128|16@1+ (0.01,0) [0|300] "km/h" X
BO_ 768 YAWM: 8 X
 SG_ YR : 0|16@1- (0.01,0) [-320|320] "deg/s" X
BO_ 769 ACCM: 8 X
 SG_ AY : 0|16@1- (0.01,0) [-320|320] "m/s^2" X
BO_ 770 WF: 4 X
 SG_ FL : 0|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ FR : 16|16@1+ (0.01,0) [0|300] "km/h" X
BO_ 771 WR: 4 X
 SG_ RL : 0|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ RR : 16|16@1+ (0.01,0) [0|300] "km/h" X
"""


def imu_output(message: str, axis: str, signal: str, unit: str) -> dict:
    """An output of one axis of imu/data."""
    told = {"signals": signal, "unit": unit, "standard_deviation": 0.01}
    return {"kind": "imu", "topic": "imu/data", "frame_id": "imu_link", "message": message, "axes": {axis: told}}


def wheels_output(message: str, **wheels: str) -> dict:
    """An output of some wheels."""
    joints = {f"wheel_{w}": {"signals": s, "unit": "km/h", "rolling_radius": 0.3} for w, s in wheels.items()}
    topic = "vehicle/wheel_speeds"
    return {"kind": "joint_state", "topic": topic, "message": message, "field": "velocity", "joints": joints}


def decoder(folder: Path, *outputs: dict, dbc: str = DBC) -> CanDecoder:
    """The CAN driver's decoder with a database and a mapping."""
    (folder / "car.dbc").write_text(dbc, encoding="utf-8")
    return CanDecoder(folder / "car.dbc", CanMapping.model_validate({"name": "car", "outputs": outputs}))


def frame(count: int, identifier: int, data: bytes, **more: bool) -> can.Message:
    """A frame at 100 Hz."""
    return can.Message(
        timestamp=NOON + 0.01 * count, arbitration_id=identifier, is_extended_id=identifier > 0x7FF, data=data, **more
    )


def nmea(body: str) -> bytes:
    """A sentence with its checksum."""
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}\r\n".encode()


def pvt(payload_bytes: int = 92, valid: int = 0x07) -> bytes:
    """A NAV-PVT frame of noon with a fix and 10 m/s to the north."""
    payload = bytearray(92)
    struct.pack_into("<IHBBBBBBIi", payload, 0, 0, 2024, 5, 1, 12, 0, 0, valid, 50, 0)
    payload[20:24] = bytes((3, 1, 0, 12))
    struct.pack_into("<iiiiII", payload, 24, 110_000_000, 480_000_000, 500_000, 453_000, 1500, 2000)
    struct.pack_into("<iiiiiII", payload, 48, 10_000, 0, 0, 10_000, 0, 100, 1000)
    body = bytes((1, 7)) + struct.pack("<H", payload_bytes) + bytes(payload[:payload_bytes])
    return b"\xb5\x62" + body + fletcher(body)


def xbus(*packets: tuple[int, bytes]) -> bytes:
    """An MTData2 message."""
    body = b"".join(struct.pack(">HB", identifier, len(data)) + data for identifier, data in packets)
    message = b"\xfa\xff\x36" + bytes([len(body)]) + body
    return message + bytes([-sum(message[1:]) & 0xFF])


def vtg_mode_n(folder: Path) -> None:
    subject = NmeaDecoder()
    got = []
    for second in range(8):
        clock = f"1200{second:02d}.00"
        if second < 5:
            said = [f"GPGGA,{clock},4800.0000,N,01100.{second * 224:04d},E,1,09,0.9,500.0,M,47.0,M,,",
                    "GPVTG,90.0,T,,M,54.0,N,100.0,K,A"]  # fmt: skip
        else:
            said = [f"GPGGA,{clock},,,,,0,00,99.9,,M,,M,,", "GPVTG,0.00,T,,M,0.00,N,0.00,K,N"]
        for body in said:
            got += subject.feed(nmea(body), (NOON + second) * SECOND)
    velocities = [sample for sample in got if "linear" in sample.values]
    assert [round((v.stamp - NOON * SECOND) / SECOND) for v in velocities] == [0, 1, 2, 3, 4]
    (told,) = [d for d in subject.diagnostics((NOON + 7) * SECOND) if "velocity" in d.name]
    assert "no fix" in told.message


def csv_duplicate_columns(folder: Path) -> None:
    (folder / "lap.csv").write_text("time,speed,course,speed\n0.0,36,90,40\n0.1,36,90,40\n0.2,36,90,40\n")
    velocity = {"speed": {"column": "speed", "unit": "km/h"}, "course": {"column": "course", "unit": "deg"}}
    mapping = {"time": {"column": "time"}, "topics": {"gps/velocity": velocity}}
    with pytest.raises(InputError, match="'speed' stands 2 times, as columns 2, 4; say which by its number"):
        import_recording(folder / "lap.csv", mapping=mapping)
    velocity["speed"]["column"] = 4
    found = import_recording(folder / "lap.csv", mapping=mapping)["gps/velocity"]
    np.testing.assert_allclose(found.columns["linear"][:, 0], 40 / 3.6)


def dbc_one_bad_line(folder: Path) -> None:
    bad = 'BO_ 300000000 OTHER: 8 X\n SG_ A : 0|8@1+ (1,0) [0|255] "" X\nVAL_ 37 GONE 0 "off" 1 "on" ;\n'
    text = (
        "\ufeff" + DBC.replace("[0|6553.5]", "[-3276.8|3276.7]") + 'BO_ 9 2ND: 8 X\n SG_ B : 0|8@1+ (1,0) [0|1] "" X\n'
    )
    for more in (bad, ' SG_ 0BAD : 0|8@1+ (1,0) [0|255] "" X\n', 'CM_ SG_ 37 "whose?";\n'):
        (folder / "car.dbc").write_text(text + more, encoding="utf-8")
        read = read_database(folder / "car.dbc")
        assert "not a correct DBC" in read.notes[0]
        assert read.database.get_message_by_name("STEER").signals[0].name == "ANGLE"
        assert any("2ND left out" in note for note in read.notes)
    steering = {"steering_wheel": {"signals": "ANGLE", "unit": "deg"}}
    output = {"kind": "joint_state", "topic": "vehicle/steering", "message": "STEER", "field": "position"}
    subject = decoder(folder, output | {"joints": steering}, dbc=text + bad)
    (sample,) = subject.feed(frame(0, 37, struct.pack(">H", 32768 + 900) + bytes(6)))
    np.testing.assert_allclose(sample.values["position"], math.pi / 2)
    assert any("identifier 0x11e1a300 is taken for one of 29 bits" in note for note in subject.notes)


def canfd_padding(folder: Path) -> None:
    subject = decoder(folder, wheels_output("FD18", fl="WFL", rr="WRR"))
    data = struct.pack("<H", 3600) + bytes(14) + struct.pack("<H", 7200)
    for length, expected in ((18, 1), (20, 1), (24, 1), (16, 0)):
        padded = (data + bytes(8))[:length]
        assert len(subject.feed(frame(length, 512, padded, is_fd=True))) == expected
    (sample,) = subject.feed(frame(30, 512, data + bytes(2), is_fd=True))
    np.testing.assert_allclose(sample.values["velocity"], [10 / 0.3, 20 / 0.3])


def mux_unknown_page(folder: Path) -> None:
    subject = decoder(folder, imu_output("MUX", "angular_velocity_z", "YAW", "deg/s"))
    got = [
        s
        for i in range(6)
        for s in subject.feed(frame(i, 256, bytes((13 if i % 2 else 0,)) + struct.pack("<h", 100) + bytes(5)))
    ]
    np.testing.assert_allclose([s.values["angular_velocity"][2] for s in got], [math.radians(1.0)] * 6)
    (told,) = [d for d in subject.diagnostics(round((NOON + 0.05) * SECOND)) if "MUX" in d.name]
    assert told.message == "ok"


def small_bag(folder: Path, name: str = "good") -> tuple[Path, Recording]:
    """A bag of a second of IMU."""
    stamp = NOON * SECOND + np.arange(100) * 10_000_000
    imu = build.imu(stamp, np.random.default_rng(0).normal(size=(100, 3)), np.zeros((100, 3)))
    recording = Recording({"imu/data": imu})
    write_bag(folder / name, recording)
    return folder / name, recording


def metadata_empty_storage_identifier(folder: Path) -> None:
    path, _ = small_bag(folder)
    metadata = path / "metadata.yaml"
    text = metadata.read_text()
    for old, new in (
        ("storage_identifier: mcap", 'storage_identifier: ""'),
        ('compression_mode: ""', "compression_mode: NONE"),
    ):
        assert old in text
        metadata.write_text(text.replace(old, new))
        assert len(read_bag(path)["imu/data"]) == 100


def split_bag_last_file_empty(folder: Path) -> None:
    path, _ = small_bag(folder)
    (path / "metadata.yaml").unlink()
    (path / "good_1.mcap").write_bytes(b"")
    found = read_bag(path)
    assert len(found["imu/data"]) == 100
    assert any("good_1.mcap: the file is empty" in note for note in found.notes)
    assert any("good_1.mcap" in problem for problem in inspect(found).problems)


def gnss_velocity_wrong_frame(folder: Path) -> None:
    drive = planted.drive("steady_state_circle", "prototype_real", 0)
    assert inspect(drive).problems == ()
    for change, told in (
        (planted.in_axes_of_car, "axes of the car"),
        (planted.north_east, "east and north are exchanged"),
    ):
        problems = inspect(planted.changed(drive, "gps/velocity", change)).problems
        assert len(problems) == 1, problems
        assert problems[0].startswith("gps/velocity: is not the change of gps/fix"), problems
        assert told in problems[0]


def mdf_unit_contradicts_mapping(folder: Path) -> None:
    from asammdf import MDF, Signal

    time = np.arange(0, 5, 0.01)
    with MDF(version="4.10") as file:
        file.append([Signal(np.full(len(time), 5.0), time, name="YawRate", unit="deg/s")])
        file.save(folder / "drive.mf4")
    rate = {"column": "YawRate", "unit": "rad/s"}
    mapping = {"topics": {"imu/data": {"angular_velocity": [None, None, rate]}}}
    with pytest.raises(InputError, match="gives 'YawRate' in 'deg/s', the mapping says 'rad/s'"):
        import_recording(folder / "drive.mf4", mapping=mapping)
    del rate["unit"]
    found = import_recording(folder / "drive.mf4", mapping=mapping)["imu/data"]
    np.testing.assert_allclose(found.columns["angular_velocity"][:, 2], math.radians(5.0))
    for stated, said in (("°", "rad"), ("degree", "rad"), ("KPH", "m/s"), ("m/s2", "g")):
        dbc = DBC.replace('"deg" X', f'"{stated}" X')
        if said == "g":
            output = imu_output("STEER", "linear_acceleration_y", "ANGLE", said)
        else:
            joint = {"signals": "ANGLE", "unit": said} | ({"rolling_radius": 0.3} if said == "m/s" else {})
            field = "velocity" if said == "m/s" else "position"
            output = {"kind": "joint_state", "topic": "a", "message": "STEER", "field": field, "joints": {"x": joint}}
        with pytest.raises(InputError, match=f"in '{stated}', the mapping says '{said}'"):
            decoder(folder, output, dbc=dbc)


def tir_empty_values_and_no_relaxation(folder: Path) -> None:
    import re

    text = (shared_folder("config") / "tyres" / "pacejka_2006_205_60r15.tir").read_text(encoding="utf-8")
    (folder / "empty.tir").write_text(re.sub(r"(?m)^(FZM(?:IN|AX))\s*=.*$", r"\1 =", text), encoding="utf-8")
    without = "\n".join(line for line in text.splitlines() if not line.startswith(("FZMIN", "FZMAX")))
    (folder / "without.tir").write_text(without, encoding="utf-8")
    assert read_tir(folder / "empty.tir") == read_tir(folder / "without.tir")
    pty = re.sub(r"(?m)^FITTYP\s*=\s*61", "FITTYP = 52", text) + "\n[LATERAL_COEFFICIENTS]\nPTY1 = 0\nPTY2 = 0\n"
    (folder / "pty.tir").write_text(pty, encoding="utf-8")
    assert read_tir(folder / "pty.tir").lateral.pty1 == 0.0


def ubx_short_pvt_unresolved_time(folder: Path) -> None:
    short = UbxDecoder().feed(pvt(84), NOON * SECOND)
    assert [s.stamp for s in short] == [NOON * SECOND] * 2
    for one, other in zip(short, UbxDecoder().feed(pvt(92), NOON * SECOND), strict=True):
        assert {name: v.tolist() for name, v in one.values.items()} == {n: v.tolist() for n, v in other.values.items()}
    subject = UbxDecoder()
    assert subject.feed(pvt(92, valid=0x03), NOON * SECOND) == []
    assert any("time not resolved" in d.message for d in subject.diagnostics(NOON * SECOND))


def xsens_delta_or_fixed_point(folder: Path) -> None:
    rate, force = np.array([0.1, -0.2, 0.3]), np.array([1.0, -2.0, 9.81])

    def fixed(values: np.ndarray) -> bytes:
        whole = np.floor(values).astype(int)
        return b"".join(
            struct.pack(">Ih", round((v - w) * 2**32) % 2**32, w) for v, w in zip(values, whole, strict=True)
        )

    angle = np.linalg.norm(rate) * 0.01
    quaternion = (math.cos(angle / 2), *(rate / np.linalg.norm(rate) * math.sin(angle / 2)))
    forms = {
        "fixed": ((0x4022, fixed(force)), (0x8022, fixed(rate))),
        "high rate": ((0x4040, struct.pack(">3f", *force)), (0x8040, struct.pack(">3f", *rate))),
        "increments": ((0x4010, struct.pack(">3f", *(force * 0.01))), (0x8030, struct.pack(">4f", *quaternion))),
    }
    for name, packets in forms.items():
        subject = XbusDecoder(ImuSettings(frozen_after=100))
        got = []
        for i in range(5):
            clock = (0x1060, struct.pack(">I", 100 * i))
            got += subject.feed(xbus(clock, *packets), NOON * SECOND + i * 10_000_000)
        assert len(got) >= 4, name
        np.testing.assert_allclose(got[-1].values["angular_velocity"], rate, atol=1e-5)
        np.testing.assert_allclose(got[-1].values["linear_acceleration"], force, atol=1e-5)
    subject = XbusDecoder()
    subject.feed(xbus((0x2034, bytes(12))), NOON * SECOND)
    assert any("the sensor sends 0x2034 × 1; set it to" in d.message for d in subject.diagnostics(NOON * SECOND))


def rolled_over_log_time(folder: Path) -> None:
    path, recording = small_bag(folder)
    file = path / "good_0.mcap"
    from vsense_ros.bag import BagWriter

    imu = recording["imu/data"]
    with BagWriter(folder / "rolled", compression="") as writer:
        for sample in imu:
            writer.write(sample)
    file = folder / "rolled" / "rolled_0.mcap"
    data = bytearray(file.read_bytes())
    for row, time in ((40, 2**64 - 3 * SECOND), (41, 0)):
        old = struct.pack("<QQ", int(imu.received[row]), int(imu.received[row]))
        at = data.index(old)
        data[at : at + 16] = struct.pack("<QQ", time, time)
    # The checksum of the chunk no longer holds: 0 says that there is none.
    chunk = data.index(b"\x06", 8)
    data[chunk + 9 + 24 : chunk + 9 + 28] = bytes(4)
    file.write_bytes(data)
    found = read_bag(folder / "rolled")
    assert any("2 messages with impossible arrival times" in note for note in found.notes), found.notes
    assert found.duration == pytest.approx(0.99)
    assert np.array_equal(found["imu/data"].received, imu.received)


def replay_without_common_time(folder: Path) -> None:
    (folder / "de.asc").write_text(
        "date Mit Mai 1 02:00:00.123 pm 2024\nbase hex  timestamps absolute\ninternal events logged\n"
        "// version 9.0.0\nBegin Triggerblock Mit Mai 1 02:00:00.123 pm 2024\n"
        "   0.010000 1  25              Rx   d 8 0F FF 01 00 00 00 00 B4\nEnd TriggerBlock\n"
    )
    assert read_frames(folder / "de.asc").time[0] == pytest.approx(NOON + 7200.133, abs=1e-4)
    try:
        from vsense_ros.node.replay_sources import check_overlap
    except ImportError:  # without ROS
        return
    times = np.array([(NOON + 7200) * SECOND, NOON * SECOND, (NOON + 1) * SECOND])
    with pytest.raises(InputError, match="GNSS and CAN have no time in common"):
        check_overlap(times, [("CAN", print), ("GNSS", print)], [(0, None), (1, None), (1, None)])


def explain_blames_recording(folder: Path) -> None:
    car = load_vehicle(vehicle_path("genesis_start"))
    drive = planted.drive("step_steer", "prototype_real", 0)
    channels = {t: c for t, c in drive.channels.items() if t not in ("gps/velocity", "gps/fix")}
    said = " ".join(build_dataset([replace(drive, channels=channels)], car).remarks)
    expected = "has no sensor for vehicle/wheel_speeds, which the recording has: add wheel_speeds to sensors"
    assert expected in said
    assert any(expected in text for text in unheard(channels, car.sensors.values(), car.name))


def imported_tables(folder: Path) -> None:
    rows = "0.0,36,90\n0.1,36,90\n"
    header = "time,speed,course\n"
    packed = "".join(f"{120058 + i // 10 if i < 20 else 120100 + (i - 20) // 10}.{i % 10}0,36,90\n" for i in range(40))
    velocity = {"speed": {"column": "speed", "unit": "km/h"}, "course": {"column": "course", "unit": "deg"}}
    tables = {
        "unitsrow": (header + "s,km/h,deg\n" + rows, {}, 2),
        "iso": (header + "2024-05-01T12:00:00.000Z,36,90\n2024-05-01T12:00:00.100Z,36,90\n", {"unit": "iso"}, 2),
        "hms": (header + "12:00:00.0,36,90\n12:00:00.1,36,90\n", {"unit": "hms", "start": "2024-05-01"}, 2),
        "packed": (header + packed, {"unit": "hhmmss", "start": "2024-05-01"}, 40),
        "dash": (header + "0.0,-,90\n0.1,36,90\n0.2,n/a,90\n0.3,36,90\n", {}, 4),
        "footer": (header + rows + "\n#end of file\n", {}, 2),
    }
    for name, (text, time, count) in tables.items():
        (folder / f"{name}.csv").write_text(text)
        mapping = {"time": {"column": "time", **time}, "topics": {"gps/velocity": velocity}}
        found = import_recording(folder / f"{name}.csv", mapping=mapping)["gps/velocity"]
        assert len(found) == count, name
        assert np.nanmin(found.columns["linear"][:, 0]) == pytest.approx(10.0)
        np.testing.assert_allclose(np.diff(found.seconds), 0.1, atol=1e-6)
        if time.get("unit") in ("iso", "hms"):
            assert found.stamp[0] == NOON * SECOND
    (folder / "latin1.csv").write_bytes("time,Lenkwinkel [°]\n0.0,1\n0.1,1\n".encode("cp1252"))
    steering = {"position": {"steering_wheel": {"column": "Lenkwinkel [°]"}}}
    mapping = {"time": {"column": "time"}, "topics": {"vehicle/steering": steering}}
    found = import_recording(folder / "latin1.csv", mapping=mapping)
    np.testing.assert_allclose(found["vehicle/steering"].columns["position"], math.radians(1.0))
    (folder / "aim.csv").write_text(
        '"Format","AiM CSV File"\n"Session","x"\n"Sample Rate","20"\n\n"Time","GPS Speed","GPS Heading","GPS LatAcc"\n'
        '"s","km/h","deg","g"\n\n"0.000","36.0","90.0","0.1"\n"0.050","36.0","90.0","0.1"\n'
    )
    found = import_recording(folder / "aim.csv")["gps/velocity"]
    np.testing.assert_allclose(found.columns["linear"][:, 0], 10.0)


def can_one_topic_two_messages(folder: Path) -> None:
    outputs = (
        wheels_output("WF", fl="FL", fr="FR"),
        wheels_output("WR", rl="RL", rr="RR"),
        imu_output("YAWM", "angular_velocity_z", "YR", "deg/s"),
        imu_output("ACCM", "linear_acceleration_y", "AY", "m/s^2"),
    )
    subject = decoder(folder, *outputs)
    frames = [
        frame(2 * i + late, identifier, data)
        for i in range(50)
        for late, identifier, data in (
            (0, 770, struct.pack("<HH", 3600, 3600)),
            (0.2, 771, struct.pack("<HH", 7200, 7200)),
            (0.4, 768, struct.pack("<h6x", 100)),
            (0.6, 769, struct.pack("<h6x", 200)),
        )
    ]
    got = [sample for message in frames for sample in subject.feed(message)]
    assert {s.names for s in got if s.topic == "vehicle/wheel_speeds"} == {
        ("wheel_fl", "wheel_fr"),
        ("wheel_rl", "wheel_rr"),
    }
    with can.Logger(folder / "drive.log") as logger:
        for message in frames:
            logger(message)
    (folder / "map.yaml").write_text(_yaml({"name": "car", "outputs": list(outputs)}))
    found = import_recording(folder / "drive.log", dbc=folder / "car.dbc", mapping=folder / "map.yaml")
    wheels = found["vehicle/wheel_speeds"]
    assert wheels.names == ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    np.testing.assert_allclose(np.nanmax(wheels.columns["velocity"], axis=0), np.array([10, 10, 20, 20]) / 0.3)
    assert np.isnan(wheels.columns["velocity"]).sum() == 2 * len(wheels)
    assert not [p for p in inspect(found).problems if "NaN" in p or "gaps" in p]


def _yaml(content: object) -> str:
    from io import StringIO

    from ruamel.yaml import YAML

    text = StringIO()
    YAML(typ="safe").dump(content, text)
    return text.getvalue()


CASES = {
    "01_vtg_mode_N": vtg_mode_n,
    "02_csv_duplicate_columns": csv_duplicate_columns,
    "03_dbc_one_bad_line": dbc_one_bad_line,
    "05_canfd_padding": canfd_padding,
    "06_mux_unknown_page": mux_unknown_page,
    "07_metadata_empty_storage_identifier": metadata_empty_storage_identifier,
    "08_split_bag_last_file_empty": split_bag_last_file_empty,
    "10_gnss_velocity_wrong_frame": gnss_velocity_wrong_frame,
    "11_mdf_unit_contradicts_mapping": mdf_unit_contradicts_mapping,
    "12_tir_empty_values_and_no_relaxation": tir_empty_values_and_no_relaxation,
    "13_ubx_short_pvt_unresolved_time": ubx_short_pvt_unresolved_time,
    "14_xsens_delta_or_fixed_point": xsens_delta_or_fixed_point,
    "15_rolled_over_log_time": rolled_over_log_time,
    "16_replay_without_common_time": replay_without_common_time,
    "18_explain_blames_recording": explain_blames_recording,
    "19_imported_tables": imported_tables,
    "20_can_one_topic_two_messages": can_one_topic_two_messages,
}
