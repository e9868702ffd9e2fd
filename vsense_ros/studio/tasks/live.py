"""The topics of a running observer, recorded for a while and shown as curves that grow.

The recorder node does the listening; what it has written is read again every second, so that everything that reads
bags serves here, too.
"""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.atomic import atomic_write
from vsense_ros.messages.recording import Recording
from vsense_ros.studio.curves import CurveWriter
from vsense_ros.studio.tasks.data import EAST, NORTH

LIVE = "live.json"  # names the newest set of curves, and how long it is
_PERIOD = 1.0  # [s] between two looks
_FILE = 20  # [s] of a file of the recorder's bag, of which the newest two are shown
_KEPT = 3  # sets of curves


def listen(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Listen to the topics of the observer below a namespace, until the job is cancelled or the recorder ends.

    Raises `InputError` where ROS 2 is not on this machine, or the recorder cannot run.
    """
    if importlib.util.find_spec("rclpy") is None:
        raise InputError(
            "ROS 2 is not on this machine (rclpy cannot be imported), so there is no running observer to listen to; "
            "an estimate can be played below as if it were live"
        )
    bag = folder / "bag"
    shutil.rmtree(bag, ignore_errors=True)
    command = [sys.executable, "-m", "vsense_ros.node.recorder", "--ros-args", "-p", f"bag:={bag}", "-p"]
    command += [f"max_bagfile_duration:={_FILE}.0", "-r", f"__ns:=/{str(options.get('namespace', '')).strip('/')}"]
    with (folder / "recorder.txt").open("w") as words:
        recorder = subprocess.Popen(command, stdout=words, stderr=subprocess.STDOUT)
    count = 0
    while recorder.poll() is None:
        time.sleep(_PERIOD)
        if (recording := _newest(bag)) is not None:
            count += 1
            end = _write(recording, folder / f"live{count}")
            with atomic_write(folder / LIVE) as file:
                json.dump({"set": f"live{count}", "end": end}, file)
            shutil.rmtree(folder / f"live{count - _KEPT}", ignore_errors=True)
    last = (folder / "recorder.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:]
    raise InputError(f"the recorder ended: {last[0] if last else 'it said nothing'}")


def _newest(bag: Path) -> Recording | None:
    """The newest two files of a bag that is being written, as one recording; None before there is a message."""
    channels: dict[str, Any] = {}
    for path in sorted(bag.glob("*.mcap"), key=lambda one: one.stat().st_mtime)[-2:]:
        try:
            channels |= import_recording(path).channels
        except (InputError, OSError):  # its first bytes are not written yet
            continue
    return Recording(channels) if channels else None


def _write(recording: Recording, folder: Path) -> float:
    """Curves of the estimates; returns the time of the last one [s]."""
    signals = read_signals(recording, "vsense")
    start = min((int(one.stamp[0]) for one in signals.values()), default=0)
    writer = CurveWriter(folder, name="live", laps=[])
    for name, one in signals.items():
        time_of = (one.stamp - start) * 1e-9
        if one.value.shape[1] == 2:
            path = {EAST: one.value[:, 0], NORTH: one.value[:, 1]}
            writer.add(time_of, path, unit="m", label="path", topic="path")
            continue
        parts = {name: one.shown()}
        if (band := one.band()) is not None:
            parts |= {f"{name}:low": one.shown() - band, f"{name}:high": one.shown() + band}
        writer.add(time_of, parts, unit=one.signal.shown_unit, label=one.signal.label, topic="estimates")
    writer.close()
    return max((float((one.stamp[-1] - start) * 1e-9) for one in signals.values()), default=0.0)
