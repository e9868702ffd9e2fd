"""A proposal of a column mapping, by names, units, sizes, and relations between signals; for people to confirm."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from vsense_ros.bag.can_names import WHEEL_SIDES, likeness, side_keys
from vsense_ros.bag.can_proposal import proposal
from vsense_ros.bag.can_roles import recognize
from vsense_ros.bag.can_survey import survey
from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers import mat, mdf4, text_table
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.guess_topics import topics_of
from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Kind
from vsense_ros.checks.sentences import sentence
from vsense_ros.errors import InputError
from vsense_ros.messages import units
from vsense_ros.messages.topics import TOPICS, WHEELS

_START = r"^(?:.*[ ._:])?"
_END = r"(?:[ _]?\[.*|[ _]?\(.*|_?\d*)?$"
# What a signal may be called, by topic and field: the first that fits, in this order.
_ACC = r"acc(?:eleration)?"
_SIDES = {
    "fl": "fl|vl|lf|front[ _]?left",
    "fr": "fr|vr|rf|front[ _]?right",
    "rl": "rl|hl|lr|rear[ _]?left",
    "rr": "rr|hr|rear[ _]?right",
}
_WHEEL = r"(?:wheel|whl|rad|v|n|ws)?[ _]?(?:speed|spd)?[ _]?(?:{})(?:[ _]?(?:speed|spd))?"
_STEERING = r"(?:steer(?:ing)?[ _]?(?:wheel)?[ _]?(?:angle)?|lenk(?:rad)?winkel|swa|lwi)"
_SPEED = r"(?:gps|gnss)?[ _]?(?:speed|velocity|sog|ground[ _]?speed|geschwindigkeit|v)"
_NAMES: tuple[tuple[str, str, str], ...] = (
    ("gps/fix", "latitude", r"(?:gps|gnss)?[ _]?lat(?:itude)?"),
    ("gps/fix", "longitude", r"(?:gps|gnss)?[ _]?lon(?:g|gitude)?"),
    ("gps/fix", "altitude", r"(?:gps|gnss)?[ _]?(?:alt|altitude|height)"),
    ("gps/velocity", "speed", _SPEED),
    ("gps/velocity", "course", r"(?:gps|gnss)?[ _]?(?:course|heading|bearing|cog|track)"),
    ("imu/data", "angular_velocity.2", r"(?:yaw[ _]?rate|gierrate|psip|wz|gyro[ _]?z|rate[ _]?z|omega[ _]?z)"),
    (
        "imu/data",
        "linear_acceleration.0",
        rf"(?:gps[ _]?)?(?:lon(?:g|gitudinal)?[ _]?{_ACC}|acc[ _]?x|ax|a[ _]?long|a_x)",
    ),
    ("imu/data", "linear_acceleration.1", rf"(?:gps[ _]?)?(?:lat(?:eral)?[ _]?{_ACC}|acc[ _]?y|ay|a[ _]?lat|a_y)"),
    ("imu/data", "linear_acceleration.2", rf"(?:vert(?:ical)?[ _]?{_ACC}|acc[ _]?z|az|a_z)"),
    ("vehicle/steering", "position.steering_wheel", _STEERING),
    ("vehicle/steering", "position.road_wheel_front", r"(?:road[ _]?wheel[ _]?angle|delta|df)"),
    *(("vehicle/wheel_speeds", f"velocity.wheel_{wheel}", _WHEEL.format(_SIDES[wheel])) for wheel in WHEELS),
)
_TIME = re.compile(_START + r"(?:time|timestamp|zeit|t|utc|elapsed(?:[ _]time)?|seconds)" + _END, re.IGNORECASE)
_BAGS = ("mcap", "rosbag1", "rosbag2")  # importers whose mapping is one of topics
_MOST_TURNS = 3  # rounds of reversing signs, each of which may show another one
_RADIUS = 0.32  # [m] of a wheel whose speed is told at its rim


@dataclass(frozen=True)
class Proposal:
    """A mapping as YAML, and what was assumed."""

    text: str
    remarks: tuple[str, ...]


def guess(path: Path, dbc: Path | None = None) -> Proposal:
    """A mapping for a table, an MDF or a MATLAB file, for the topics of a bag, or with a database for a CAN log.

    Raises `InputError` where nothing in it has a name or a type that is known.
    """
    from vsense_ros.bag.importers import find_importer

    importer = find_importer(path, () if dbc is None else ("dbc",)).name
    if importer in _BAGS:
        return _of_bag(path)
    if importer == "can_log":
        if dbc is None:
            raise InputError(f"{path}: a CAN log is frames of bytes; what they mean needs a database (--dbc FILE)")
        heard = survey(path, [dbc])
        return Proposal(proposal(heard, recognize(heard)), ())
    content, columns, stated = _columns(path)
    remarks: list[str] = []
    topics: dict[str, Any] = {}
    taken: set[str] = set()
    wheels = _wheels(columns)
    for topic, field, pattern in _NAMES:
        expression = re.compile(_START + pattern + _END, re.IGNORECASE)
        name = next((name for name in columns if name not in taken and expression.match(name)), None)
        if topic == "vehicle/wheel_speeds" and name is None:
            name = wheels.get(field.removeprefix("velocity.wheel_"))
        if name is None:
            continue
        taken.add(name)
        signal = _signal(name, topic, field, stated.get(name, ""), columns[name], remarks)
        if signal is not None:
            _put(topics.setdefault(topic, {}), field, signal)
    _drop_halves(topics, remarks)
    if not topics:
        raise InputError(f"{path}: none of its columns has a name that is known; found: {', '.join(columns)[:600]}")
    content["topics"] = topics
    _turn_signs(path, content, remarks)
    left = [name for name in columns if name not in taken]
    if left:
        remarks.append(f"not used: {', '.join(left[:20])}{' …' if len(left) > 20 else ''}")
    return Proposal(_yaml(content), tuple(remarks))


def _wheels(columns: Mapping[str, Array]) -> dict[str, str]:
    """Columns of the speeds of four wheels by wheel, if there are four whose names differ in the wheel alone."""
    families: dict[tuple[int, str], dict[str, str]] = {}
    for name in columns:
        if likeness("wheel_speed", name, "") > 0:
            for row, side, key in side_keys(name):
                families.setdefault((row, key), {}).setdefault(side, name)
    return next((family for family in families.values() if set(family) == set(WHEEL_SIDES)), {})


def _of_bag(path: Path) -> Proposal:
    """A mapping for the topics of a bag that are not called as those of this project."""
    from vsense_ros.bag.importers import import_recording

    recording = import_recording(path)
    topics, remarks = topics_of(recording)
    if not topics:
        own = [topic for topic in recording.channels if topic in TOPICS]
        why = f"; {', '.join(own)} are read as they are" if own else ""
        raise InputError(
            f"{path}: no topic of it measures something under another name{why}; it has "
            f"{', '.join(recording.channels) or 'none that can be read'}"
        )
    return Proposal(_yaml({"topics": topics}, in_lines=True), tuple(remarks))


def _yaml(content: Mapping[str, Any], *, in_lines: bool = False) -> str:
    """A mapping as text, each entry in a line of its own if `in_lines`, else short ones in one line."""
    text = StringIO()
    writer = YAML(typ="safe")
    writer.default_flow_style = False if in_lines else None
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    writer.width = 118
    writer.dump(content, text)
    return text.getvalue()


def _columns(path: Path) -> tuple[dict[str, Any], dict[str, Array], dict[str, str]]:
    """What a mapping has beside topics, the columns by name, and their stated units."""
    if mdf4.matches(path):
        found, stated = mdf4.channels(path)
        return {}, found, stated
    if mat.matches(path):
        found = mat.variables(path)
        time = next((name for name in found if _TIME.match(name)), None)
        if time is None:
            raise InputError(f"{path}: no variable is named like a time; found: {', '.join(found)[:600]}")
        same = {name: values for name, values in found.items() if len(values) == len(found[time]) and name != time}
        return {"time": {"column": time, "unit": "s"}}, same, {}
    best: tuple[list[str], list[str], str] | None = None
    for delimiter in ",;\t":
        header, stated_units = text_table.read_header(path, _empty(delimiter))
        if best is None or len(header) > len(best[0]):
            best = header, stated_units, delimiter
    assert best is not None
    header, stated_units, delimiter = best
    names = [name if header.count(name) == 1 else str(index) for index, name in enumerate(header, 1)]
    time = next((name for name in names if _TIME.match(name)), names[0])
    content: dict[str, Any] = {"time": {"column": time, "unit": "s"}}
    if delimiter != ",":
        content["delimiter"] = delimiter
    found = _of_table(path, content, [name for name in names if name != time], delimiter)
    return content, found, dict(zip(names, stated_units, strict=True))


def _empty(delimiter: str) -> mapping_file.ColumnMapping:
    return mapping_file.ColumnMapping(delimiter=delimiter, topics={})


def _of_table(path: Path, content: dict[str, Any], names: list[str], delimiter: str) -> dict[str, Array]:
    """Columns of numbers of a table; the unit of time and the decimal sign that let it be read go into `content`."""
    found: dict[str, Array] = {}
    refusal: InputError | None = None
    for unit in ("s", "iso", "hms"):
        for decimal in (".", ",") if delimiter != "," else (".",):
            time = {**content["time"], "unit": unit}
            try:
                for name in names:
                    ref = int(name) if name.isdigit() else name
                    signals = {"steering_wheel": {"column": ref, "unit": "rad"}}
                    one = {"time": time, "delimiter": delimiter, "decimal": decimal}
                    wanted = mapping_file.load({**one, "topics": {"vehicle/steering": {"position": signals}}}, path)
                    try:
                        table = text_table.read_table(path, wanted)
                    except InputError as error:
                        if "column" in str(error) and repr(name) in str(error):
                            continue  # text, which is no signal
                        raise
                    found[name] = table.column(mapping_file.Ref(ref)).values
            except InputError as error:
                refusal = error
                found.clear()
                continue
            if found:
                content["time"]["unit"] = unit
                content |= {} if decimal == "." else {"decimal": decimal}
                return found
    raise refusal or InputError(f"{path}: no column of numbers in it")


def _signal(name: str, topic: str, field: str, stated: str, values: Array, remarks: list[str]) -> dict[str, Any] | None:
    """A signal with a unit that is stated, or that its size tells."""
    good = values[np.isfinite(values)]
    if len(good) < 2:
        return None
    largest = float(np.max(np.abs(good)))
    signal: dict[str, Any] = {"column": int(name) if name.isdigit() else name}
    quantity = units.quantity_of(stated) if stated else None
    if quantity not in (None, "number"):
        signal["unit"] = units.canonical(stated)
        if topic == "vehicle/wheel_speeds" and quantity == "velocity":
            signal["radius"] = _RADIUS
            remarks.append(f"{name}: a rolling radius of {_RADIUS} m is assumed; put in that of the car")
        return signal
    guessed = {
        "latitude": "deg",
        "longitude": "deg",
        "altitude": "m",
        "speed": "km/h" if largest > 90 else "m/s",
        "course": "deg" if largest > 7 else "rad",
        "angular_velocity.2": "deg/s" if largest > 2 else "rad/s",
        "position.steering_wheel": "deg" if largest > 15 else "rad",
        "position.road_wheel_front": "deg" if largest > 1 else "rad",
    }.get(field)
    if guessed is None and field.startswith("linear_acceleration"):
        typical = float(np.median(np.abs(good)))
        in_g = (0.8 < typical < 1.2) if field.endswith("2") else largest < 1.6
        guessed = "g" if in_g else "m/s²"
    if guessed is None:
        guessed = "km/h" if largest > 130 else "rad/s"
        if guessed == "km/h":
            signal["radius"] = _RADIUS
            remarks.append(f"{name}: a rolling radius of {_RADIUS} m is assumed; put in that of the car")
    remarks.append(f"{name}: no unit is stated; {guessed} by its size (up to {largest:.4g})")
    return signal | {"unit": guessed}


def _put(fields: dict[str, Any], field: str, signal: dict[str, Any]) -> None:
    name, _, part = field.partition(".")
    if not part:
        fields[name] = signal
    elif part.isdigit():
        fields.setdefault(name, [None, None, None])[int(part)] = signal
    else:
        fields.setdefault(name, {})[part] = signal


def _drop_halves(topics: dict[str, Any], remarks: list[str]) -> None:
    """Topics of which a part is missing without which the rest is nothing."""
    for topic, needed in (("gps/fix", {"latitude", "longitude"}), ("gps/velocity", {"speed", "course"})):
        if topic in topics and not needed <= topics[topic].keys():
            alone = topics.pop(topic)
            if topic == "gps/velocity" and "speed" in alone:
                topics["vehicle/velocity"] = {"speed": alone["speed"]}
                remarks.append("a speed without a course becomes vehicle/velocity")


def _turn_signs(path: Path, content: dict[str, Any], remarks: list[str]) -> None:
    """Reverse what the other sensors contradict."""
    from vsense_ros.bag.importers import import_recording

    for _ in range(_MOST_TURNS):
        found = findings(import_recording(path, mapping=content))
        turned = False
        for finding in found:
            if finding.kind is not Kind.SIGN or not finding.signal:
                continue
            signal = _signal_of(content["topics"][finding.topic], finding.signal)
            if signal is None or "sign" in signal:
                continue
            signal["sign"] = -1
            remarks.append(f"{signal['column']}: reversed, as {sentence(finding)}")
            turned = True
        if not turned:
            remarks += [f"look at {f.topic}: {sentence(f)}" for f in found if f.kind is not Kind.SIGN]
            return


def _signal_of(fields: Mapping[str, Any], name: str) -> dict[str, Any] | None:
    """The entry of a signal in the fields of a topic: of a component of a vector, or of a joint; None if there is
    none."""
    field, _, axis = name.partition(".")
    if axis:
        signals = fields.get(field)
        return signals["xyz".index(axis)] if isinstance(signals, list) else None
    return next((joints[name] for joints in fields.values() if isinstance(joints, dict) and name in joints), None)
