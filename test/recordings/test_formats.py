"""Every format gives the drive that was written into it, and bad files of it end in one sentence."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from recordings import formats
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

SECONDS = 3.0
LINES = ("csv", "aim", "racechrono", "vbo", "candump", "candump_view", "asc", "trc", "gvret")
BLOCKS = ("blf", "mcap", "mcap_packed_messages")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, formats.Made]:
    return {name: make(tmp_path_factory.mktemp(name), SECONDS) for name, make in formats.MAKERS.items()}


@pytest.mark.parametrize("name", formats.MAKERS)
def test_the_drive_comes_out_as_it_was_written(made: dict[str, formats.Made], name: str) -> None:
    path, options = made[name]
    found = import_recording(path, **options)
    count = round(SECONDS * formats.RATE)
    relative = name == "trc"  # python-can's writer leaves out the date
    for topic, channel in found.channels.items():
        assert len(channel) == count, topic
        np.testing.assert_allclose(np.diff(channel.seconds), 1 / formats.RATE, atol=1.1e-3)
        if not relative:
            assert abs(channel.stamp[0] - formats.START * 10**9) < 5_000_000, topic
    assert found.channels.keys() & {"imu/data", "gps/velocity", "gps/fix", "vehicle/wheel_speeds"}
    if "gps/velocity" in found:
        speed = np.hypot(*found["gps/velocity"].columns["linear"][:, :2].T)
        np.testing.assert_allclose(speed, formats.SPEED, rtol=1e-5)
        course = np.arctan2(*found["gps/velocity"].columns["linear"][:, [1, 0]].T)
        np.testing.assert_allclose(np.gradient(np.unwrap(course)) * formats.RATE, formats.YAW_RATE, atol=1e-2)
    if "imu/data" in found:
        rate = found["imu/data"].columns["angular_velocity"][:, 2]
        np.testing.assert_allclose(rate, formats.YAW_RATE, atol=6e-4)
    if "vehicle/wheel_speeds" in found:
        np.testing.assert_allclose(found["vehicle/wheel_speeds"].columns["velocity"] * 0.3, formats.SPEED, atol=0.02)
    if "gps/fix" in found:
        assert found["gps/fix"].columns["latitude"][0, 0] == pytest.approx(formats.ORIGIN[0])
        assert found["gps/fix"].columns["longitude"][0, 0] == pytest.approx(formats.ORIGIN[1])


def files_of(path: Path) -> Path:
    """The file of a recording that may be a folder."""
    if path.is_file():
        return path
    return next(f for f in sorted(path.iterdir()) if f.name != "metadata.yaml")


def read(path: Path, options: dict) -> Recording | None:
    """What is read of a file that may be bad: nothing else than one sentence may come instead."""
    try:
        return import_recording(path, **options)
    except InputError as error:
        text = str(error)
        assert "Traceback" not in text
        assert len(text) < 2000
        return None


@pytest.mark.parametrize("name", formats.MAKERS)
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.77, 0.999])
def test_a_file_that_is_cut_gives_what_is_there_or_one_sentence(
    made: dict[str, formats.Made], name: str, share: float, tmp_path: Path
) -> None:
    path, options = made[name]
    whole = files_of(path)
    data = whole.read_bytes()
    cut = tmp_path / whole.name
    cut.write_bytes(data[: int(share * len(data))])
    found = read(cut, options)
    assert share > 0.0 or found is None
    if share > 0.7 and name in (*LINES, "mcap", "mcap_packed_messages"):
        assert found is not None
        assert max(len(c) for c in found.channels.values()) > 0.6 * round(SECONDS * formats.RATE)


def begins_as(found: Recording, whole: Recording) -> bool:
    """True if each channel has the first messages of the same channel of the whole recording, unchanged."""
    return all(
        np.array_equal(channel.stamp, whole[topic].stamp[: len(channel)])
        and all(
            np.array_equal(values, whole[topic].columns[field][: len(channel)], equal_nan=True)
            for field, values in channel.columns.items()
        )
        for topic, channel in found.channels.items()
    )


def messages_of(recording: Recording) -> int:
    return sum(len(channel) for channel in recording.channels.values())


@pytest.mark.parametrize("name", [*LINES, *BLOCKS])
@given(left=st.integers(1, 400))
@settings(max_examples=15, deadline=None)
def test_wherever_a_file_is_cut_no_value_is_another_one_and_what_lacks_is_said(
    made: dict[str, formats.Made], tmp_path_factory: pytest.TempPathFactory, name: str, left: int
) -> None:
    path, options = made[name]
    whole = files_of(path)
    data = whole.read_bytes()[:-left]
    cut = tmp_path_factory.mktemp("cut") / whole.name
    cut.write_bytes(data)
    found, complete = read(cut, options), import_recording(path, **options)
    assert found is not None
    assert begins_as(found, complete)
    if messages_of(found) == messages_of(complete):
        return
    if name in LINES:
        lines, _, last = data.rpartition(b"\n")
        cut.write_bytes(lines + b"\n")
        without = read(cut, options)
        assert without is not None
        if not last.strip() or messages_of(found) > messages_of(without):
            return  # between two lines, or behind all that is a message
    assert set(found.notes) - set(complete.notes)


@pytest.mark.parametrize("name", ["csv", "aim", "vbo", "candump", "asc", "blf", "trc", "gvret", "mcap"])
@pytest.mark.parametrize("other", ["csv", "candump", "mcap", "mat"])
def test_two_formats_in_one_file_give_the_beginning_of_the_first_and_a_sentence_or_one_sentence(
    made: dict[str, formats.Made], name: str, other: str, tmp_path: Path
) -> None:
    if name == other:
        return
    path, options = made[name]
    data, behind = files_of(path).read_bytes(), files_of(made[other][0]).read_bytes()
    mixed = tmp_path / files_of(path).name
    mixed.write_bytes(data[: len(data) // 2] + behind[len(behind) // 2 :])
    found, complete = read(mixed, options), import_recording(path, **options)
    if found is not None:
        assert begins_as(found, complete)
        assert set(found.notes) - set(complete.notes)


@pytest.mark.parametrize("name", formats.MAKERS)
def test_another_format_under_this_name_is_one_sentence(
    made: dict[str, formats.Made], name: str, tmp_path: Path
) -> None:
    whole = files_of(made[name][0])
    for number, content in enumerate((b"", b"\x89PNG\r\n\x1a\n" + bytes(500), b"time,x\n1,2\n", bytes(range(256)) * 8)):
        file = tmp_path / f"{number}" / whole.name
        file.parent.mkdir()
        file.write_bytes(content)
        options = {k: v for k, v in made[name][1].items() if k != "dbc"}
        assert read(file, options) is None


@pytest.mark.parametrize(
    "name", ["csv", "vbo", "mat", "mat73", "candump", "asc", "blf", "gvret", "mcap", "sqlite3", "rosbag1"]
)
@given(where=st.floats(0.0, 1.0, exclude_max=True), byte=st.integers(0, 255))
@settings(max_examples=12, deadline=None)
def test_a_damaged_byte_is_at_most_one_sentence(
    made: dict[str, formats.Made], tmp_path_factory: pytest.TempPathFactory, name: str, where: float, byte: int
) -> None:
    path, options = made[name]
    whole = files_of(path)
    data = bytearray(whole.read_bytes())
    data[int(where * len(data))] = byte
    file = tmp_path_factory.mktemp("damaged") / whole.name
    file.write_bytes(data)
    read(file, options)


def test_text_where_numbers_are_due_is_told_with_its_place(tmp_path: Path) -> None:
    path, options = formats.csv(tmp_path, 1.0)
    lines = path.read_text().splitlines()
    lines[40] = lines[40].replace("72.0000000", "fast")
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"drive.csv, line 41, column 'speed': expected a number, found 'fast'"):
        import_recording(path, **options)


def bombs(folder: Path) -> dict[str, tuple[Path, dict]]:
    """Files of some kilobytes that promise gigabytes."""
    import h5py

    zeros = bytes(1 << 20)
    found: dict[str, tuple[Path, dict]] = {}
    hdf5 = folder / "bomb.mat"
    with h5py.File(hdf5, "w") as file:
        file.create_dataset("time", shape=(1, 1 << 34), dtype="f8", chunks=(1, 1 << 16), compression="gzip")
    found["mat73"] = hdf5, {"mapping": {"time": {"column": "time"}, "topics": {}}}
    packed = zstandard.ZstdCompressor(level=3).compressobj()
    sqlite = folder / "bomb.db3.zstd"
    with sqlite.open("wb") as file:
        file.write(packed.compress(b"SQLite format 3\0"))
        for _ in range(4096):
            file.write(packed.compress(zeros))
        file.write(packed.flush())
    found["sqlite3"] = sqlite, {}
    deflate = zlib.compressobj(9)
    body = b"".join(deflate.compress(zeros) for _ in range(3000)) + deflate.flush()
    header = struct.pack("<4sL", b"LOGG", 144) + bytes(136)
    size = 16 + 16 + len(body)
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + struct.pack("<H6xL4x", 2, 3000 << 20) + body
    blf = folder / "bomb.blf"
    blf.write_bytes(header + container + bytes(size % 4))
    (folder / "car.dbc").write_text(formats.DBC)
    (folder / "can.yaml").write_text(formats.CAN_MAPPING)
    found["blf"] = blf, {"dbc": folder / "car.dbc", "mapping": folder / "can.yaml"}
    return found


@pytest.mark.exam
def test_files_that_unpack_to_gigabytes_are_refused_in_bounded_memory(tmp_path: Path) -> None:
    import resource
    import subprocess
    import sys

    for name, (path, options) in bombs(tmp_path).items():
        assert path.stat().st_size < 8 << 20, name
        plain = {key: value if isinstance(value, dict) else str(value) for key, value in options.items()}
        code = (
            "import resource, sys\nfrom vsense_ros.bag.importers import import_recording\n"
            "from vsense_ros.errors import InputError\n"
            f"try:\n    import_recording({str(path)!r}, **{plain!r})\n"
            "except InputError as error:\n    print('refused:', error)\n"
            "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
        assert done.stdout.startswith("refused:"), (name, done.stdout, done.stderr[-2000:])
        assert int(done.stdout.split()[-1]) < 1_600_000, name  # [KiB]
    assert resource.getrlimit(resource.RLIMIT_DATA)[0] == resource.RLIM_INFINITY


@pytest.mark.exam
def test_a_table_of_text_takes_little_more_than_twice_its_size(tmp_path: Path) -> None:
    """What the libraries take at their first use is left out by a small table before."""
    import subprocess
    import sys

    (tmp_path / "small").mkdir()
    small, options = formats.csv(tmp_path / "small", 10.0)
    path, _ = formats.csv(tmp_path, 10_000.0)
    (tmp_path / "options.yaml").write_text(yaml.safe_dump(options["mapping"]))
    code = (
        "import sys\n"
        "from vsense_ros.bag.importers import import_recording\n"
        "def told(what):\n"
        "    lines = open('/proc/self/status').read().splitlines()\n"
        "    return next(int(line.split()[1]) for line in lines if line.startswith(what)) * 1024\n"
        "small, path, mapping = sys.argv[1:]\n"
        "import_recording(small, mapping=mapping)\n"
        "before = told('VmRSS')\n"
        "recording = import_recording(path, mapping=mapping)\n"
        "print(told('VmHWM') - before)\n"
    )
    command = [sys.executable, "-c", code, str(small), str(path), str(tmp_path / "options.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert int(done.stdout) < 2.7 * path.stat().st_size
