"""Everything that reads, each as a function of bytes that may raise `InputError` and nothing else."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import can
import numpy as np

from fuzz.mutations import mutated
from recordings import formats
from vsense_ros.bag import read_bag, read_whole_bag
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.bag.importers import import_recording
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_mapping import load_mapping
from vsense_ros.driver.imu import XbusDecoder, encode_mtdata2
from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.ubx import UbxDecoder
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder
from vsense_ros.files.tyre import load_tyre
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages import cdr, yaml_text
from vsense_ros.messages.recording import FIELDS, Sample
from vsense_ros.runner import Runner

START = 1_700_000_000_000_000_000
STEP = 10_000_000

Feed = Callable[[bytes], Any]


@dataclass(frozen=True)
class Target:
    """`make(folder)` gives the function that is fed, and seeds; `share` of all inputs go there."""

    name: str
    share: float
    make: Callable[[Path], tuple[Feed, list[bytes]]]


def finite(samples: Iterable[Sample]) -> None:
    """What drivers make is finite, but for axes that an inertial sensor on CAN does not have."""
    for sample in samples:
        for name, value in sample.values.items():
            if name not in ("angular_velocity", "linear_acceleration"):
                assert np.isfinite(value).all(), f"{sample.topic}: {name} is {value}"
            assert not np.isinf(value).any(), f"{sample.topic}: {name} is {value}"


def bag(seconds: float = 2.0) -> Any:
    whole = read_bag(shared_folder("bags") / "double_lane_change")
    end = whole.start + round(seconds * 1e9)
    return replace(whole, channels={t: c.select(c.received <= end) for t, c in whole.channels.items()})


def stream(decoder: Any, data: bytes, clock: list[int]) -> None:
    clock[0] += STEP
    finite(decoder.feed(data, clock[0]))


def of_nmea(_: Path) -> tuple[Feed, list[bytes]]:
    seeds = [data for _, data in gnss_byte_stream(bag(), "nmea")][:20]
    more = (
        "$GPVTG,84.4,T,,M,022.4,N,041.5,K*43\r\n",
        "$GPZDA,123519.00,23,03,2023,00,00*60\r\n",
        "$GPHDT,274.07,T*03\r\n",
    )
    gst = "$GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031*6A\r\n"
    return partial(stream, NmeaDecoder(), clock=[START]), [*seeds, *(s.encode() for s in (*more, gst))]


def checked_sentence(feed: Feed) -> Feed:
    """Half of the sentences get the checksum that their content has, so that it is looked at."""
    count = [0]

    def feed_checked(data: bytes) -> None:
        count[0] += 1
        body, star, _ = data.strip().removeprefix(b"$").partition(b"*")
        if count[0] % 2 and star and b"$" not in body:
            total = 0
            for byte in body:
                total ^= byte
            data = b"$" + body + b"*%02X\r\n" % total
        feed(data)

    return feed_checked


def of_ubx(_: Path) -> tuple[Feed, list[bytes]]:
    seeds = [data for _, data in gnss_byte_stream(bag(), "ubx")][:20]

    def feed(data: bytes, clock: list[int], decoder: UbxDecoder, count: list[int]) -> None:
        count[0] += 1
        if count[0] % 2 and len(data) > 8:
            a = b = 0
            for byte in data[2:-2]:
                a = (a + byte) & 0xFF
                b = (b + a) & 0xFF
            data = data[:-2] + bytes((a, b))
        stream(decoder, data, clock)

    return partial(feed, clock=[START], decoder=UbxDecoder(), count=[0]), seeds


def of_xbus(_: Path) -> tuple[Feed, list[bytes]]:
    seeds = [encode_mtdata2(sample, n) for n, sample in enumerate(bag(0.1)["imu/data"])]

    def feed(data: bytes, clock: list[int], decoder: XbusDecoder, count: list[int]) -> None:
        count[0] += 1
        if count[0] % 2 and len(data) > 5:
            data = data[:-1] + bytes(((-sum(data[1:-1])) & 0xFF,))
        stream(decoder, data, clock)

    return partial(feed, clock=[START], decoder=XbusDecoder(), count=[0]), seeds


def of_can(folder: Path) -> tuple[Feed, list[bytes]]:
    (folder / "car.dbc").write_text(formats.DBC)
    (folder / "car.yaml").write_text(formats.CAN_MAPPING)
    decoder = CanDecoder(folder / "car.dbc", folder / "car.yaml")
    clock = [START]

    def feed(data: bytes) -> None:
        clock[0] += STEP
        identifier = int.from_bytes(data[:4].ljust(4, b"\0"), "little")
        frame = can.Message(
            timestamp=clock[0] * 1e-9,
            arbitration_id=768 + identifier % 4 if identifier % 3 else identifier & 0x1FFFFFFF,
            is_extended_id=identifier % 3 == 0,
            is_fd=bool(identifier & 0x100),
            is_error_frame=identifier % 97 == 0,
            is_remote_frame=identifier % 89 == 0,
            data=None if identifier % 89 == 0 else data[4:68],
            dlc=8 if identifier % 89 == 0 else len(data[4:68]),
            check=False,
        )
        finite(decoder.feed(frame, clock[0]))

    return feed, [bytes(4) + bytes(frame.data) for frame in formats.frames(0.2)]


def of_cdr(_: Path) -> tuple[Feed, list[bytes]]:
    kinds = sorted(FIELDS)
    seeds = []
    for channel in bag(0.5).channels.values():
        seeds += [bytes([kinds.index(channel.kind)]) + row.tobytes() for row in cdr.encode_channel(channel)[:3]]

    def feed(data: bytes) -> None:
        if data:
            cdr.decode(kinds[data[0] % len(kinds)], data[1:], "topic")

    return feed, seeds


def of_file(folder: Path, seeds: list[bytes], name: str, read: Callable[[Path], Any]) -> tuple[Feed, list[bytes]]:
    path = folder / name

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        read(path)

    return feed, seeds


def of_mcap(folder: Path) -> tuple[Feed, list[bytes]]:
    seeds = []
    for compression in ("zstd", "lz4", ""):
        from vsense_ros.bag import write_bag

        write_bag(folder / f"seed_{compression}", bag(0.3), compression=compression)
        seeds += [file.read_bytes() for file in (folder / f"seed_{compression}").glob("*.mcap")]
    return of_file(folder, seeds, "bag.mcap", read_whole_bag)


def of_metadata(folder: Path) -> tuple[Feed, list[bytes]]:
    from vsense_ros.bag import write_bag

    write_bag(folder / "bag", bag(0.1))
    path = folder / "bag" / "metadata.yaml"
    return of_file(folder / "bag", [path.read_bytes()], "metadata.yaml", lambda file: read_bag(file.parent))


def of_yaml(folder: Path) -> tuple[Feed, list[bytes]]:
    files = sorted(shared_folder("config").rglob("*.yaml"))
    small = [f.read_bytes() for f in files if f.stat().st_size < 6000]
    readers = (load_vehicle, load_mapping, load_tyre, yaml_text.load_file)
    count = [0]

    def read(path: Path) -> None:
        count[0] += 1
        readers[count[0] % len(readers)](path)

    return of_file(folder, small, "file.yaml", read)


def of_dbc(folder: Path) -> tuple[Feed, list[bytes]]:
    return of_file(folder, [formats.DBC.encode()], "car.dbc", read_database)


def of_importers(folder: Path) -> tuple[Feed, list[bytes]]:
    """A file of each format; the first byte of an input says of which it is."""
    made = []
    for number, (name, make) in enumerate(formats.MAKERS.items()):
        place = folder / f"seed_{number}"
        place.mkdir()
        path, options = make(place, 0.3)
        if path.is_file():
            made.append((name, path.name, options, path.read_bytes()))
    for name in ("candump_view", "gvret"):
        assert any(n == name for n, *_ in made) or name not in formats.MAKERS

    def feed(data: bytes) -> None:
        if not data:
            return
        _, name, options, _ = made[data[0] % len(made)]
        path = folder / name
        path.write_bytes(data[1:])
        import_recording(path, **options)

    return feed, [bytes([i]) + seed for i, (*_, seed) in enumerate(made)]


def of_observer(_: Path) -> tuple[Feed, list[bytes]]:
    """Messages of a drive, wrong ones between them: what comes out stays finite, with covariances that are definite."""
    observer = Runner(load_vehicle(shared_folder("config") / "vehicles" / "prototype_model.yaml"))
    samples = list(bag(10.0).samples(tuple(observer.topics)))
    state = {"next": 0, "offset": 0}
    period = samples[-1].stamp - samples[0].stamp + STEP

    def feed(data: bytes) -> None:
        if state["next"] == len(samples):
            state["next"], state["offset"] = 0, state["offset"] + period
        sample = samples[state["next"]]
        state["next"] += 1
        stamp, received = sample.stamp + state["offset"], (sample.received or 0) + state["offset"]
        random = np.random.default_rng(int.from_bytes(data[:8].ljust(8, b"\0"), "little"))
        values = {name: np.array(value) for name, value in sample.values.items()}
        if random.random() < 0.05:
            name = list(values)[int(random.integers(len(values)))]
            wrong = random.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0, 1e-300, 1e6, 5e-324])
            if len(values[name]):
                values[name][int(random.integers(len(values[name])))] = wrong
        if random.random() < 0.01:
            stamp += int(random.choice([-(10**18), 10**18, -(10**9), 10**9, -(10**7), -stamp]))
        names = sample.names if random.random() > 0.01 else tuple(random.permutation(sample.names).tolist())
        frame = sample.frame_id if random.random() > 0.01 else "elsewhere"
        observer.add(replace(sample, values=values, stamp=stamp, received=received, names=names, frame_id=frame))
        if state["next"] % 20 == 0 and observer.started:
            for out in observer.estimate():
                for name, value in out.values.items():
                    if out.topic == "vsense/sideslip":  # whose deviation is infinite at rest
                        continue
                    # No sensor of this car measures a height, which is absent.
                    known = value[:2] if (out.topic, name) == ("vsense/odometry", "position") else value
                    assert np.isfinite(known).all(), f"{out.topic}: {name}"
            _, covariance = observer.filter.belief()
            assert (covariance.diagonal() >= 0).all(), "a variance is negative"

    return feed, [bytes(8)]


TARGETS = [
    Target("NMEA", 0.22, lambda folder: (checked_sentence((made := of_nmea(folder))[0]), made[1])),
    Target("UBX", 0.2, of_ubx),
    Target("XBus", 0.2, of_xbus),
    Target("CAN", 0.15, of_can),
    Target("CDR", 0.1, of_cdr),
    Target("MCAP", 0.03, of_mcap),
    Target("metadata of bags", 0.005, of_metadata),
    Target("YAML", 0.02, of_yaml),
    Target("DBC", 0.005, of_dbc),
    Target("importers", 0.01, of_importers),
    Target("observer", 0.06, of_observer),
]


def fuzz(target: Target, count: int, seed: int, done: Callable[[int], None] = lambda n: None) -> None:
    """Feed a target; raises at the first input that breaks it, which the message holds in hexadecimal digits."""
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="vsense_") as folder:
        feed, seeds = target.make(Path(folder))
        for number in range(count):
            data = mutated(seeds[int(random.integers(len(seeds)))], random, seeds)
            try:
                feed(data)
            except InputError:
                pass
            except BaseException as error:
                error.add_note(f"{target.name}, input {number} of seed {seed}: {data[:2000].hex()}")
                raise
            if number % 64 == 0:
                done(number)
