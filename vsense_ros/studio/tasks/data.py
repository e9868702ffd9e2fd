"""Reading recordings: their curves, streams, path and laps."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsense_ros.bag import write_bag
from vsense_ros.bag.reading import glance_at_bag
from vsense_ros.evaluate.signals import find_channel
from vsense_ros.messages.laps import FIX, METRES, laps
from vsense_ros.messages.recording import Recording
from vsense_ros.studio.curves import CURVES, DISTANCE, GLANCE, CurveWriter, driven
from vsense_ros.studio.project import content_hash

if TYPE_CHECKING:  # the first curves are drawn before it could be imported
    from vsense_ros.checks.inspect import TopicInfo

EAST, NORTH, SPEED = "east", "north", "speed"
_GAPS_SHOWN = 200  # of one topic on the timeline
_SPEED_TOPICS = (("gps/velocity", 2), ("vehicle/velocity", 2), ("vehicle/speed", 1), ("reference/odometry", 2))


def recording_of(one: Mapping[str, Any]) -> Recording:
    """A recording of the project: its path, with the mapping and the database that its format may need."""
    import vsense_ros as vs

    options = {key: one[key] for key in ("mapping", "dbc") if one.get(key)}
    return vs.read(one["path"], **options)


def recordings_of(chosen: list[dict[str, Any]]) -> list[Recording]:
    """Several recordings of the project, with names that are distinct."""
    from vsense_ros.api.recording import read_all

    return read_all([recording_of(one) for one in chosen])[0]


def read(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Read a recording: a first look if it is large, then curves of all its signals, then what a timeline shows."""
    shutil.rmtree(folder / CURVES, ignore_errors=True)
    first = None if options.get("mapping") else glance_at_bag(options["path"])
    if first is not None:
        write_curves(first, folder / GLANCE, broken=False)
        progress(0.2)
    recording = recording_of(options)
    progress(0.6)
    write_curves(recording, folder / CURVES)
    progress(0.8)
    content_hash(Path(options["path"]), folder.parent.parent)  # which later steps need, and find there
    progress(0.9)
    return _streams(recording)


def _streams(recording: Recording) -> dict[str, Any]:
    """What was recorded when: topics with rates, gaps and held values."""
    from vsense_ros.checks.inspect import inspect
    from vsense_ros.model.sensors import known_topics

    inspection = inspect(recording, known_topics())
    return {
        "name": recording.name,
        "duration": recording.duration,
        "notes": list(recording.notes),
        "missing": list(inspection.missing),
        "topics": [_stream(info, recording) for info in inspection.topics],
        "problems": len(inspection.problems),
        "curves": CURVES,
    }


def _stream(info: TopicInfo, recording: Recording) -> dict[str, Any]:
    from vsense_ros.checks.held import period_of_updates
    from vsense_ros.checks.subject import measured

    channel = recording[info.topic]
    first = recording.first_stamp
    seconds = (channel.stamp - first) * 1e-9
    held = {name: period for name, values in measured(channel) if (period := period_of_updates(values[:, None]))}
    return {
        "topic": info.topic,
        "kind": info.kind.split("/")[-1],
        "count": info.count,
        "rate": info.rate_hz,
        "begin": float(seconds.min()) if len(seconds) else 0.0,
        "end": float(seconds.max()) if len(seconds) else 0.0,
        "gaps": [[gap.start, gap.length] for gap in info.gaps[:_GAPS_SHOWN]],
        "latency": info.latency_median,
        "held": held,
        "problems": list(info.problems),
    }


def write_curves(recording: Recording, folder: Path, *, broken: bool = True) -> None:
    """Curves of all signals of a recording over the time since its first stamp, with path, distance and laps. Lines
    are drawn across gaps if they are not `broken`."""
    limits = [(lap.first_stamp - recording.first_stamp) * 1e-9 for lap in laps(recording)]
    writer = CurveWriter(folder, name=recording.name, laps=[*limits, recording.duration] if len(limits) > 1 else [])
    for table in recording.tables():
        time = ""
        for column in table.columns:
            if not column.is_absent:
                time = time or writer.add_time(table.seconds(recording.first_stamp), broken=broken)
                part = column.name.removeprefix(f"{table.name}/").removeprefix(table.name).strip("/.") or "value"
                label = part.replace("_", " ")
                writer.add(time, {column.name: column.value}, unit=column.unit, label=label, topic=table.name)
    _add_path(recording, writer)
    writer.close()


def _add_path(recording: Recording, writer: CurveWriter) -> None:
    fix = find_channel(recording, FIX)
    if fix is not None:
        latitude, longitude = (fix.columns[name][:, 0] for name in ("latitude", "longitude"))
        good = np.isfinite(latitude) & np.isfinite(longitude)
        if good.any():
            origin = latitude[good][0], longitude[good][0]
            east = METRES * (longitude - origin[1]) * np.cos(np.radians(origin[0]))
            north = METRES * (latitude - origin[0])
            time = (fix.stamp - recording.first_stamp) * 1e-9
            order = np.argsort(time[good], kind="stable")
            at = writer.add_time(time[good][order])
            for name, value in ((EAST, east), (NORTH, north)):
                writer.add(at, {name: value[good][order]}, unit="m", label=name, topic="path")
    for topic, count in _SPEED_TOPICS:
        channel = find_channel(recording, topic)
        if channel is not None:
            speed = np.linalg.norm(channel.columns["linear"][:, :count], axis=1)
            time = (channel.stamp - recording.first_stamp) * 1e-9
            order = np.argsort(time, kind="stable")
            time, speed = time[order], speed[order]
            writer.add(time, {SPEED: speed}, unit="m/s", label="speed", topic="path")
            writer.add(time, {DISTANCE: driven(time, speed)}, unit="m", label="distance", topic="path")
            return


def propose(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Propose a mapping for a table, a measurement file or a bag."""
    from vsense_ros.bag.importers.guess import guess

    proposal = guess(Path(options["path"]), Path(options["dbc"]) if options.get("dbc") else None)
    return {"text": proposal.text, "remarks": list(proposal.remarks)}


def join(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Join recordings of one drive by the motion that all of them measure, and write the bag to `target`."""
    from vsense_ros.bag.join import joined

    recordings = recordings_of(options["recordings"])
    progress(0.4)
    whole = joined(recordings, keep_times=bool(options.get("keep_times")))
    write_bag(Path(options["target"]), whole, overwrite=True)
    return {"target": options["target"], "notes": list(whole.notes)}
