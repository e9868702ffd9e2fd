"""Nodes as processes, started and ended by a program: for the demo and for tests. Needs no rclpy itself.

`run_through_ros` is the whole road: replay → bus, serial lines and topics → drivers → observer → recorder.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vsense_ros.bag import read_bag
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording
from vsense_ros.node.byte_log import write_byte_log
from vsense_ros.node.discovery import on_this_machine


@dataclass(frozen=True)
class ProcessSettings:
    """ROS domains of processes, and how long they may take: decisions of this project."""

    first_domain: int = 10  # below it are domains that people use
    last_domain: int = 100  # above 101 the ports of a domain collide with ephemeral ones
    far_apart: int = 37  # domains between those of processes started in a row; no divisor of their number
    domain_port: int = 7400  # port of domain 0 (DDS-RTPS 2.5, 9.6.2.3)
    startup: float = 180.0  # [s] for a node to become active; the observer may have to compile its model first
    discovery: float = 15.0  # [s] for nodes to see each other


SETTINGS = ProcessSettings()


@dataclass(frozen=True)
class RosRun:
    """What the processes made of a recording; the figures are those of `vsense_ros.observer.Run`."""

    output: Recording  # vsense/*
    step_us_median: float  # computing time of one message in the observer [µs]
    realtime_factor: float  # length of the recording over wall time
    messages_lost: int  # published by replay or drivers but not taken by the observer, or by it but not recorded
    diagnostics: list[Diagnostic]  # of the observer at the end
    parameters: dict[str, tuple[float, float]]  # value and standard deviation at the end
    latency_ms: dict[str, float]  # stamp of the estimate to its publication: p50, p90, p99, p99.9; empty with rate 0
    recording: Recording  # everything that was recorded, inputs as the drivers published them included
    accelerator: dict[str, int]  # requests by what became of them, as `accelerator.client.Client.counts`; or empty


def free_domain() -> int:
    """A ROS domain on this machine that nobody uses. Processes started one after the other search far apart, so that
    two that run at once do not choose the same."""
    span = SETTINGS.last_domain - SETTINGS.first_domain
    for i in range(span):
        domain = SETTINGS.first_domain + (SETTINGS.far_apart * os.getpid() + i) % span
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind(("", SETTINGS.domain_port + 250 * domain))
            return domain
    raise InputError(
        f"all ROS domains from {SETTINGS.first_domain} to {SETTINGS.last_domain} are in use on this machine"
    )


def ros_environment(domain: int) -> dict[str, str]:
    """The environment for the nodes of one run: this machine alone, quick discovery, nothing from a parent's wheels."""
    environment = dict(os.environ)
    # The wheels' bootstrapper must run again in the child, which may not inherit what it had set up.
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
    environment |= {
        "ROS_DOMAIN_ID": str(domain),
        **on_this_machine(),
        "PYTHONUNBUFFERED": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    if not environment.get("HOME"):  # rclpy.init fails without
        environment["HOME"] = _own_folder()
    return environment


def _own_folder() -> str:
    """A folder in which nobody else can put anything, in the place of a home: rclpy logs there, and compiled code is
    kept there."""
    folder = Path(tempfile.gettempdir()) / f"vsense_ros-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        return tempfile.mkdtemp(prefix="vsense_ros-")
    return str(folder)


class NodeProcess:
    """A node of this package as a child process. As a context manager it is stopped at the end."""

    def __init__(
        self,
        node: str,
        parameters: Mapping[str, Any],
        environment: Mapping[str, str],
        *,
        name: str | None = None,
        remappings: Mapping[str, str] | None = None,
    ) -> None:
        """`node` is a module of `vsense_ros.node`; `name` renames the node, `remappings` its topics and the like."""
        self.name = name or node
        command = [sys.executable, "-m", f"vsense_ros.node.{node}", "--ros-args", "--log-level", "rcl:=error"]
        if name is not None:
            command += ["-r", f"__node:={name}"]
        for key, value in (remappings or {}).items():
            command += ["-r", f"{key}:={value}"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={_parameter_text(value)}"]
        self._process = subprocess.Popen(
            command, env=dict(environment), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        self._lines: list[str] = []
        self._heard = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            with self._heard:
                self._lines.append(line.rstrip("\n"))
                self._heard.notify_all()
        with self._heard:
            self._heard.notify_all()

    @property
    def output(self) -> str:
        """What it has written to stderr so far."""
        with self._heard:
            return "\n".join(self._lines)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def says(self, text: str) -> bool:
        """True if a line of its log ends with `text` or has it before a colon."""
        with self._heard:
            return any(line.endswith(f": {text}") or f": {text}:" in line for line in self._lines)

    def wait_for(self, text: str, timeout: float) -> None:
        """Wait for a line of its log; `InputError` with its last words if it ends or is silent for `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while not self.says(text):
            if self.exit_code is not None:
                self._reader.join(1.0)
                if self.says(text):
                    return
                raise InputError(f"node {self.name} ended with {self.exit_code}: {self._last_words()}")
            if time.monotonic() > deadline:
                raise InputError(f"node {self.name}: no {text!r} within {timeout:g} s: {self._last_words()}")
            with self._heard:
                self._heard.wait(0.1)

    def wait_until_active(self, timeout: float = SETTINGS.startup) -> None:
        """Wait until the node is configured and active."""
        self.wait_for("active", timeout)

    def wait_until_ended(self, timeout: float) -> int:
        """Exit code, once it has ended by itself; `InputError` if it does not within `timeout` [s]."""
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise InputError(f"node {self.name} did not end within {timeout:g} s: {self._last_words()}") from None
        self._reader.join(1.0)
        return code

    def _last_words(self) -> str:
        return "\n".join(self.output.splitlines()[-8:]) or "it said nothing"

    def stop(self, timeout: float = 10.0) -> int:
        """End it as Ctrl-C would, with SIGTERM and at last SIGKILL if it does not react; returns the exit code."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if self.exit_code is not None:
                break
            self._process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout)
        self._reader.join(1.0)
        return self._process.wait()

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _parameter_text(value: Any) -> str:
    """A parameter as the YAML that `-p` takes."""
    if isinstance(value, list | tuple):
        return json.dumps(list(value))
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def run_through_ros(
    recording_bag: str | Path | None,
    vehicle_file: str | Path,
    *,
    topics: Sequence[str] = (),
    can_log: str | Path | None = None,
    can_log_channel: str = "",
    can_database: str | Path | None = None,
    can_mapping: str | Path | None = None,
    gnss_bytes: Sequence[tuple[int, bytes]] = (),
    gnss_protocol: str = "nmea",
    imu_bytes: Sequence[tuple[int, bytes]] = (),
    driver_parameters: Mapping[str, Mapping[str, Any]] | None = None,
    map_origin: tuple[float, float, float] | None = None,
    out_bag: str | Path | None = None,
    rate: float | None = None,
    output_rate: float = 100.0,
    accelerator: Mapping[str, Any] | None = None,
    progress: Callable[[float], None] | None = None,
) -> RosRun:
    """Run the nodes as separate processes on one drive, and collect what the observer published.

    From `recording_bag` the given `topics` are replayed (none given: all). `can_log`
    goes onto a bus to `can_driver`, `gnss_bytes` and `imu_bytes` (times [ns], bytes) over pseudo-terminals to
    `gps_driver` and `imu_driver`; `driver_parameters` are further parameters by node. `rate` is relative to real time;
    by default 1 with a bus or a serial line, else 0: as fast as observer and recorder can. `out_bag` keeps what was
    recorded. With parameters for `accelerator` that node solves the observer's systems. `progress` is called with the
    share done, 0 to 1.

    Raises `InputError` with the last words of a node that ended too early, or if the observer never started.
    """
    live = can_log is not None or bool(gnss_bytes) or bool(imu_bytes)
    rate = (1.0 if live else 0.0) if rate is None else rate
    environment = ros_environment(free_domain())
    with tempfile.TemporaryDirectory(prefix="vsense_") as scratch, contextlib.ExitStack() as running:
        folder = Path(scratch)
        bag = Path(out_bag) if out_bag is not None else folder / "output"
        source: dict[str, Any] = {"rate": rate, "consumers": 2, "topics": list(topics)}
        if recording_bag is not None:
            source["bag"] = str(recording_bag)
        drivers: dict[str, dict[str, Any]] = {}
        if can_log is not None:
            bus, drivers["can_driver"] = _can_bus(folder, can_log, can_log_channel, can_database, can_mapping)
            source |= bus
        if gnss_bytes:
            source |= _serial_line(folder, "gnss", gnss_bytes)
            drivers["gps_driver"] = {"port": str(folder / "gnss"), "protocol": gnss_protocol}
        if imu_bytes:
            source |= _serial_line(folder, "imu", imu_bytes)
            drivers["imu_driver"] = {"port": str(folder / "imu")}
        observer = {
            "vehicle": str(vehicle_file),
            "rate": output_rate,
            "publish_all": rate == 0,
            "map_origin": [] if map_origin is None else [float(v) for v in map_origin],
            **({} if accelerator is None else {"accelerator": "topics"}),
        }
        last = {} if accelerator is None else {"accelerator": accelerator}

        def start(node: str, parameters: Mapping[str, Any]) -> NodeProcess:
            common = {"use_sim_time": True, "summary": str(folder / f"{node}.json")}
            values = {**common, **parameters, **(driver_parameters or {}).get(node, {})}
            return running.enter_context(NodeProcess(node, values, environment))

        recorder = {"bag": str(bag), "overwrite": True}
        nodes = {
            name: start(name, parameters)
            for name, parameters in {"observer": observer, "recorder": recorder, **drivers, **last}.items()
        }
        elapsed = _driven(nodes, lambda: start("replay", source), tuple(drivers), tuple(last), progress)
        summaries = {name: _summary(folder / f"{name}.json") for name in (*nodes, "replay")}
        recording = read_bag(bag)
    return _result(recording, summaries, elapsed, rate, str(recording_bag or can_log or "recording"))


def _driven(
    nodes: Mapping[str, NodeProcess],
    start_replay: Callable[[], NodeProcess],
    drivers: Sequence[str],
    last: Sequence[str],
    progress: Callable[[float], None] | None,
) -> float:
    """Replay a drive to nodes once they are ready, stop them in the order of their messages, and return the time that
    the replay took [s]. Raises `InputError` if one fails."""
    for node in nodes.values():
        node.wait_until_active()
    # Estimates and measurements have their readers before the first of them is made.
    for name in ("observer", *drivers):
        nodes[name].wait_for("connected", SETTINGS.discovery)
    elapsed = _follow(start_replay(), nodes, progress)
    # Each node works off what has come, and waits until its readers have it.
    for name in (*drivers, "observer", "recorder", *last):
        if nodes[name].stop() != 0:
            raise InputError(f"node {name} failed at its end: {nodes[name].output[-2000:]}")
    return elapsed


def _can_bus(
    folder: Path, log: str | Path, log_channel: str, database: str | Path | None, mapping: str | Path | None
) -> tuple[dict[str, str], dict[str, str]]:
    """Parameters of the replay and of `can_driver` for a CAN log on a bus in `folder`. Raises `InputError` without a
    database or a mapping."""
    if database is None or mapping is None:
        raise InputError("a CAN log needs a database (DBC) and a mapping")
    channel = str(folder / "can")
    replay = {"can_log": str(log), "can_channel": channel, "can_log_channel": log_channel}
    driver = {"interface": "slcan", "channel": channel, "database": str(database), "mapping": str(mapping)}
    return replay, driver


def _serial_line(folder: Path, name: str, entries: Sequence[tuple[int, bytes]]) -> dict[str, str]:
    """Parameters of the replay for bytes on a pseudo-terminal, whose log is written into `folder`."""
    write_byte_log(folder / f"{name}.log", entries)
    return {f"{name}_bytes": str(folder / f"{name}.log"), f"{name}_port": str(folder / name)}


def _result(
    recording: Recording, summaries: Mapping[str, Mapping[str, Any]], elapsed: float, rate: float, name: str
) -> RosRun:
    """Result of a run from the recorded messages and the summaries of the nodes. Raises `InputError` if the observer
    never started."""
    estimates = {topic: channel for topic, channel in recording.channels.items() if topic.startswith("vsense/")}
    observed = summaries["observer"]
    if not estimates:
        text = "; ".join(f"{d['name']}: {d['message']}" for d in observed["diagnostics"])
        raise InputError(f"{name}: the observer never started ({text})")
    return RosRun(
        output=replace(recording, channels=estimates),
        step_us_median=observed["step_us_median"] or float("nan"),
        realtime_factor=summaries["replay"]["seconds"] / elapsed,
        messages_lost=lost(summaries) + recording.messages_lost,
        diagnostics=[
            Diagnostic(d["name"], Level(d["level"]), d["message"], d["values"]) for d in observed["diagnostics"]
        ],
        parameters={name: (value, deviation) for name, (value, deviation) in observed["parameters"].items()},
        latency_ms=observed["latency_ms"] if rate else {},
        recording=recording,
        accelerator=observed["accelerator"],
    )


def _percentages(lines: Sequence[str]) -> Iterator[int]:
    for line in lines:
        text = line.rpartition(": ")[2]
        if text.endswith(" %") and text[:-2].isdigit():
            yield int(text[:-2])


def _follow(replay: NodeProcess, nodes: Mapping[str, NodeProcess], progress: Callable[[float], None] | None) -> float:
    """Wait for the end of a replay; returns the seconds that it took from its first message on."""
    replay.wait_for("begins", SETTINGS.startup)
    began = time.monotonic()
    while replay.exit_code is None and not replay.says("finished"):
        for name, node in nodes.items():
            if node.exit_code is not None:
                raise InputError(f"node {name} ended with {node.exit_code} during the replay: {node.output[-2000:]}")
        if progress is not None:
            progress(max(_percentages(replay.output.splitlines()), default=0) / 100)
        time.sleep(0.05)
    elapsed = time.monotonic() - began
    if replay.wait_until_ended(30.0) != 0:
        raise InputError(f"node replay failed: {replay.output[-2000:]}")
    if progress is not None:
        progress(1.0)
    return elapsed


def _summary(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"node {path.stem} left no summary: {error}") from None


def lost(summaries: Mapping[str, Mapping[str, Any]]) -> int:
    """Messages that were published for somebody and did not reach him, by the summaries that the nodes of a run have
    left, by their names."""
    observer, recorder = summaries["observer"], summaries["recorder"]
    received, recorded = observer["received"], recorder["recorded"]
    missing = sum(summary.get("lost_in_bag", 0) for summary in summaries.values())
    missing += sum(count for summary in summaries.values() for count in summary.get("not_taken", {}).values())
    for name, summary in summaries.items():
        if name == "accelerator":
            continue  # whose answers nobody records; the observer counts them
        for topic, count in summary["published"].items():
            missing += max(count - recorded.get(topic.removeprefix("/"), 0), 0)
            if name != "observer" and topic in received:
                missing += max(count - received[topic], 0)
    return missing
