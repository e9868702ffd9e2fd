"""What `tools/bench_against.py` times: a process of its own for each checkout, so that neither loads the other's code.

`python tools/bench_parts.py FOLDER`, with the checkout's package first in PYTHONPATH, reads names of parts from its
standard input, and prints for each the processor time [s] of the quickest of some slots, as JSON. Only what users have
is called, so that checkouts of other days can be compared.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test/recordings"))

import formats  # noqa: E402

BAGS = ("double_lane_change", "sine_with_dwell", "hills")
VEHICLE = "prototype_model"
SPEED, STEP = 15.0, 0.004  # [m/s], [s]
SLOT = 2e-3  # [s] of one measurement of something short, which the machine rarely interrupts
SLOTS = 40
MESSAGES = 50_000  # of the bag that is read
FRAMES = 4_000  # of a bus
SECONDS = 200.0  # of the table that is imported

Job = Callable[[], Any]


class Part:
    """Something that is timed: `make(folder)` prepares it and returns the job, which does `count` of a `unit`."""

    def __init__(self, make: Callable[[Path], Job], unit: str, count: int = 1, short: bool = False) -> None:
        self.make, self.unit, self.count, self.short = make, unit, count, short


def observer_step(name: str) -> Callable[[Path], Job]:
    """Predict, linearise, correct by inertial sensor and wheel speeds, of a car that keeps its speed."""

    def make(folder: Path) -> Job:
        import vsense_ros as vs
        from vsense_ros.observer.catalogue import FILTERS
        from vsense_ros.observer.sensors import sensors_of

        car = vs.load_vehicle(VEHICLE)
        if name == "spi":
            estimated = {"chassis.mass": {"deviation": 100.0}, "road.friction": {"deviation": 0.2, "lower": 0.1}}
            raw = car.model_dump()
            raw["observer"] |= {"parameters": estimated, "parameter_filter": "ekf"}
            car = type(car).model_validate(raw)
        sensors = sensors_of(car)
        observer = FILTERS[name].make(car, sensors)
        observer.start_rolling(SPEED)
        wheel = car.physics.front.unloaded_radius
        measured = {"imu": np.array([0, 0, 0, 0, 0, 9.80665]), "wheel_speeds": np.full(4, SPEED / wheel)}
        known = [(sensor, value, sensors[sensor].deviations() ** 2, 1e9) for sensor, value in measured.items()]

        def step() -> None:
            observer.predict(STEP)
            for what in known:
                observer.correct(*what)

        return step

    return make


def heard(folder: Path) -> Job:
    """The messages of a bag one by one, as a node hears them: read, checked, judged, used and kept for late ones."""
    import vsense_ros as vs
    from vsense_ros.runner import Runner

    car, recording = vs.load_vehicle(VEHICLE), vs.read(ROOT / "bags" / BAGS[0])
    samples = list(recording.samples(tuple(Runner(car).topics)))[:HEARD]

    def hear() -> None:
        observer = Runner(car, recording.map_origin)
        for sample in samples:
            observer.add(sample)

    return hear


def run(bag: str) -> Callable[[Path], Job]:
    """`vsense run` in a process that is warm: from the file to the data of the report."""

    def make(folder: Path) -> Job:
        import vsense_ros as vs

        return lambda: vs.estimate(ROOT / "bags" / bag, VEHICLE)

    return make


def command(folder: Path) -> Job:
    """`vsense run` as a command, with all that a process does at its start; what is compiled is there already."""
    line = [sys.executable, "-m", "vsense_ros.cli", "run", str(ROOT / "bags" / BAGS[0]), "--vehicle", VEHICLE]
    line += ["--out", str(folder / "run")]
    return lambda: subprocess.run(line, check=True, capture_output=True)


def explain(folder: Path) -> Job:
    import vsense_ros as vs

    return lambda: vs.explain([ROOT / "bags" / BAGS[0]], VEHICLE, observe=False)


def mcap(folder: Path) -> Job:
    from vsense_ros.bag import read_bag, write_bag
    from vsense_ros.messages.recording import FIELDS, Channel, Recording

    kind, noise = "sensor_msgs/msg/Imu", np.random.default_rng(0)
    stamp = 1_600_000_000_000_000_000 + np.arange(MESSAGES) * 4_000_000
    columns = {name: noise.normal(size=(MESSAGES, width)) for name, width in FIELDS[kind].items()}
    recording = Recording({"imu/data": Channel("imu/data", kind, stamp, stamp, columns, "imu_link")}, "imu")
    write_bag(folder / "imu", recording)
    return lambda: read_bag(folder / "imu")


def live_can(folder: Path) -> Job:
    """Frames as a node hears them, one by one: half of them are of a message that is mapped."""
    import cantools

    from vsense_ros.driver.can import CanDecoder

    (folder / "car.dbc").write_text(formats.DBC)
    (folder / "car.yaml").write_text(formats.CAN_MAPPING)
    database = cantools.database.load_file(folder / "car.dbc")
    decoder = CanDecoder(folder / "car.dbc", folder / "car.yaml")
    wheels = dict.fromkeys(("FL", "FR", "RL", "RR"), 72.0)
    contents = (("YAWM", {"YR": 5.0}), ("WHEELS", wheels), ("WHEELS", wheels), ("YAWM", {"YR": 5.1}))
    kinds = [database.get_message_by_name(name) for name, _ in contents]
    data = [kind.encode(values) for kind, (_, values) in zip(kinds, contents, strict=True)]
    clock = iter(range(10**9))

    def feed() -> None:
        for i in range(FRAMES):
            which = i % 4
            at = formats.START + 0.0025 * next(clock)
            decoder.feed(can.Message(at, kinds[which].frame_id, is_extended_id=False, data=data[which]))

    return feed


def csv(folder: Path) -> Job:
    from vsense_ros.bag.importers import import_recording

    path, options = formats.MAKERS["csv"](folder, SECONDS)
    return lambda: import_recording(path, **options)


def gnss(protocol: str) -> Callable[[Path], Job]:
    """Bytes of a receiver, fix by fix."""

    def make(folder: Path) -> Job:
        import vsense_ros as vs
        from vsense_ros.bag.gnss_bytes import gnss_byte_stream
        from vsense_ros.driver.nmea import NmeaDecoder
        from vsense_ros.driver.ubx import UbxDecoder

        stream = gnss_byte_stream(vs.read(ROOT / "bags" / BAGS[0]), protocol)

        def feed() -> None:
            decoder = (NmeaDecoder if protocol == "nmea" else UbxDecoder)()
            for received, data in stream:
                decoder.feed(data, received)

        return feed

    return make


FIXES = 120  # of the double lane change, and
HEARD = 5_000  # of its messages
PARTS = {
    "step error_ekf": Part(observer_step("error_ekf"), "step", short=True),
    "step spi": Part(observer_step("spi"), "step", short=True),
    "messages one by one": Part(heard, "message", HEARD),
    **{f"run {bag}": Part(run(bag), "run") for bag in BAGS},
    "command run": Part(command, "command"),
    "explain": Part(explain, "answer"),
    "read mcap": Part(mcap, "message", MESSAGES),
    "live can": Part(live_can, "frame", FRAMES),
    "import csv": Part(csv, "row", round(SECONDS * formats.RATE)),
    "live nmea": Part(gnss("nmea"), "fix", FIXES),
    "live ubx": Part(gnss("ubx"), "fix", FIXES),
}


def processor_time() -> float:
    """Processor time of this process and of those that it started [s]; waiting on a busy machine does not count."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def timed(job: Job, part: Part) -> float:
    """Processor time of one of what the part does [s], in the quickest slot of some if it is short."""
    if not part.short:
        before = processor_time()
        job()
        return (processor_time() - before) / part.count
    found = []
    for _ in range(SLOTS):
        before, calls = time.perf_counter(), 0
        while time.perf_counter() - before < SLOT:
            job()
            calls += 1
        found.append((time.perf_counter() - before) / calls)
    return min(found)


def main() -> None:
    folder = Path(sys.argv[1])
    answers, sys.stdout = sys.stdout, sys.stderr
    warnings.simplefilter("ignore")
    jobs: dict[str, Job] = {}
    for line in sys.stdin:
        name = line.strip()
        try:
            if name not in jobs:
                place = folder / name.replace(" ", "_")
                place.mkdir(parents=True, exist_ok=True)
                jobs[name] = PARTS[name].make(place)
                jobs[name]()  # imports and compiles what is not there yet
            answer: dict[str, Any] = {"seconds": timed(jobs[name], PARTS[name])}
        except Exception as error:  # a checkout of another day may not have it
            answer = {"error": f"{type(error).__name__}: {error}".splitlines()[0][:200]}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
