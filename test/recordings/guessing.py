"""How often a proposed mapping reads a log rightly, unedited, and how often it reads it wrongly without a word.

Right is a mapping that gives every signal of the log, at its times and in its unit, and nothing that is not so.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from recordings.logs import Columns, Log, drive
from vsense_ros.bag.importers import import_recording
from vsense_ros.bag.importers.guess import Proposal, guess
from vsense_ros.checks.inspect import inspect
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording

NEAR = 0.02  # [-] of a signal's range, or of 1 in SI units if that is more, by which it may be off
ON_TIME = 2e-3  # [s]
IN_PLACE = 2e-7  # [deg] of latitude and longitude
_WHEELS = ("fl", "fr", "rl", "rr")


@dataclass(frozen=True)
class Verdict:
    """What became of a proposal: right, or else why not, and whether nobody was warned of it."""

    name: str
    why: str = ""
    silent: bool = False

    @property
    def right(self) -> bool:
        return not self.why


def measured(recording: Recording) -> Iterator[tuple[str, str, Channel, np.ndarray]]:
    """The signals of a recording by the names of `logs.drive`: topic, name, channel, values (n,) in SI units."""
    for topic, channel in recording.channels.items():
        columns = channel.columns
        if topic == "imu/data":
            for field, letter in (("angular_velocity", "w"), ("linear_acceleration", "a")):
                absent = columns.get(f"{field}_covariance", np.zeros((1, 1)))[0, 0] == -1.0
                for i, axis in enumerate("xyz"):
                    if not absent:
                        yield topic, f"{letter}{axis}", channel, columns[field][:, i]
        elif topic == "gps/fix":
            for name in ("latitude", "longitude", "altitude"):
                yield topic, name, channel, columns[name][:, 0]
        elif topic == "gps/velocity":
            east, north = columns["linear"][:, 0], columns["linear"][:, 1]
            yield topic, "speed", channel, np.hypot(east, north)
            yield topic, "course", channel, np.degrees(np.unwrap(np.arctan2(east, north)))
        elif topic == "vehicle/velocity":
            yield topic, "speed", channel, columns["linear"][:, 0]
        elif topic == "vehicle/steering":
            yield topic, "steering", channel, columns["position"][:, 0]
        elif topic == "vehicle/wheel_speeds":
            for name, values in zip(channel.names, columns["velocity"].T, strict=True):
                yield topic, name.removeprefix("wheel_"), channel, values
        else:
            yield topic, topic, channel, np.zeros(len(channel))


def _expected(name: str, d: Columns, at: np.ndarray) -> np.ndarray:
    if name == "course":
        values = np.degrees(np.unwrap(np.radians(d["course"])))
        values = values - 360 * np.round(values.mean() / 360)
    else:
        values = d[name]
    return np.interp(at, d["t"], values)


def wrongs(recording: Recording, log: Log, d: Columns) -> dict[str, str]:
    """What a recording has wrong or lacks, by topic."""
    found: dict[str, str] = {}
    seen: set[str] = set()
    starts = [channel.stamp[0] for channel in recording.channels.values()]
    base = min(starts) * 1e-9 if log.begin is None else log.begin
    for topic, name, channel, values in measured(recording):
        good = np.isfinite(values)
        if not good.any():
            continue
        seen.add(name)
        if name not in d:
            found[topic] = f"{topic} is nothing that the log has"
            continue
        at = channel.stamp * 1e-9 - base
        if at.min() < -0.05 or at.max() > d["t"][-1] + 0.05 or np.ptp(at) < 0.8 * np.ptp(d["t"]):
            found[topic] = f"{topic} is at {at.min():.3f} to {at.max():.3f} s of {d['t'][-1]:.3f} s"
            continue
        expected = _expected(name, d, at)
        off = np.abs(values - expected)
        off = np.minimum(off, np.abs(off - 360)) if name == "course" else off
        allowed = IN_PLACE if name in ("latitude", "longitude") else NEAR * max(np.ptp(d[name]), 1e-3)
        slope = np.abs(np.gradient(_expected(name, d, d["t"]), d["t"])).max() * (ON_TIME + 0.003)
        if np.percentile(off[good], 99) > allowed + slope:
            found[topic] = f"{name} of {topic} is off by {np.percentile(off[good], 99):.3g}, allowed {allowed:.3g}"
    missing = [name for name in log.signals if name not in seen]
    return found | ({"": f"not read: {', '.join(missing)}"} if missing else {})


def judged(name: str, log: Log, folder: Path, d: Columns | None = None) -> Verdict:
    """What becomes of a log that is read by the mapping that is proposed for it."""
    d = drive() if d is None else d
    path = log.write(folder, d)
    options: dict[str, Any] = {}
    if log.dbc is not None:
        options["dbc"] = folder / "car.dbc"
        options["dbc"].write_text(log.dbc, encoding="utf-8")
    try:
        proposal = guess(path, options.get("dbc"))
        if log.dbc is None:
            options["mapping"] = YAML(typ="safe").load(proposal.text)
        else:
            options["mapping"] = folder / "mapping.yaml"
            options["mapping"].write_text(proposal.text, encoding="utf-8")
        recording = import_recording(path, **options)
    except InputError as error:
        return Verdict(name, f"refused: {error}")
    except Exception:
        return Verdict(name, f"fails: {traceback.format_exc()}")
    found = wrongs(recording, log, d)
    if not found:
        return Verdict(name)
    said = [*inspect(recording).problems, *(text for text in proposal.remarks if text.startswith("look at"))]
    silent = any(topic and not any(topic in text for text in said) and not _assumed(topic, proposal) for topic in found)
    return Verdict(name, "; ".join(found.values()), silent)


def _assumed(topic: str, proposal: Proposal) -> bool:
    """True if a remark says of a column of a topic that its unit is assumed."""
    part = str(YAML(typ="safe").load(proposal.text).get("topics", {}).get(topic))
    columns = (text.partition(": no unit")[0] for text in proposal.remarks if ": no unit" in text)
    return any(f"'{column}'" in part for column in columns)


def verdicts(logs: dict[str, Log]) -> Iterator[Verdict]:
    """What becomes of each log."""
    d = drive()
    for name, log in logs.items():
        with TemporaryDirectory() as folder:
            yield judged(name, log, Path(folder), d)
