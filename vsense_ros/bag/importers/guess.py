"""A proposal of a column mapping, by names, units, sizes, and relations between signals; for people to confirm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from vsense_ros.bag.can_proposal import proposal
from vsense_ros.bag.can_roles import recognize
from vsense_ros.bag.can_survey import survey
from vsense_ros.bag.importers import aim_xrk, mat, mdf4, racelogic_vbo, text_table
from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.dialect import Dialect, dialect_of, rows_by_name, time_keys
from vsense_ros.bag.importers.guess_names import Heading, heading, is_time, meanings
from vsense_ros.bag.importers.guess_topics import topics_of
from vsense_ros.bag.importers.long_table import LongTable
from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Finding, Kind, Turn
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.sentences import sentence
from vsense_ros.checks.units import GRAVITY
from vsense_ros.driver.can_frames import UNIX
from vsense_ros.errors import InputError
from vsense_ros.messages import units
from vsense_ros.messages.topics import TOPICS

_NO_DATE = "no date in it: its times count from 1970 (key start of time)"
_SECOND_DAY = "1970-01-02T00:00:00Z"  # stamps of messages are not before 1970
_BAGS = ("mcap", "rosbag1", "rosbag2")  # importers whose mapping is one of topics
_MOST_TURNS = 3  # rounds of reversing signs, each of which may show another one
_LEAST_FORCE, _IN_G = 0.3, (0.06, 0.2)  # [m/s²] of lateral acceleration that shows its unit, and its ratio in g
_MOST_RADIANS = 2.0  # [rad/s] that a car turns at the most
_RADIUS = 0.32  # [m] of a wheel whose speed is that of its rim


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
    source = _columns(path)
    content, columns = source.content, source.columns
    remarks = list(source.remarks)
    topics: dict[str, Any] = {}
    taken = meanings(source.headings)
    for (topic, field), name in taken.items():
        signal = _signal(name, topic, field, source.headings[name].unit, columns[name], remarks)
        if signal is not None:
            _put(topics.setdefault(topic, {}), field, signal)
    _drop_halves(topics, remarks)
    _velocities_alike(topics, remarks)
    if not topics:
        raise InputError(f"{path}: none of its columns has a name that is known; found: {', '.join(columns)[:600]}")
    content["topics"] = topics
    _axes_without_gravity(topics, remarks)
    _unit_of_rates(topics, columns, remarks)
    _unit_of_forces(content, columns, remarks)
    _turn_signs(path, content, remarks)
    left = [name for name in columns if name not in taken.values()]
    if left:
        remarks.append(f"not used: {', '.join(left[:20])}{' …' if len(left) > 20 else ''}")
    return Proposal(_yaml(content), tuple(remarks))


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


@dataclass(frozen=True)
class _Source:
    """What a mapping has beside topics, the columns by what a mapping calls them, their headings, and remarks."""

    content: dict[str, Any]
    columns: Mapping[str, Array]
    headings: Mapping[str, Heading]
    remarks: Sequence[str] = ()


def _columns(path: Path) -> _Source:
    """The columns of a table or a measurement file, and how a mapping reads them."""
    if mdf4.matches(path):
        columns, stated = mdf4.channels(path)
        return _Source({}, columns, _headings(columns, stated))
    if aim_xrk.matches(path):
        columns, stated = aim_xrk.channels(path)
        return _Source({}, columns, _headings(columns, stated))
    if mat.matches(path):
        columns = mat.variables(path)
        time = next((name for name in columns if is_time(name)), None)
        if time is None:
            raise InputError(f"{path}: no variable is named like a time; found: {', '.join(columns)[:600]}")
        same = {name: values for name, values in columns.items() if len(values) == len(columns[time]) and name != time}
        return _Source({"time": {"column": time, "unit": "s"}}, same, _headings(same, {}), (_NO_DATE,))
    if racelogic_vbo.matches(path):
        others, stated = racelogic_vbo.other_columns(path)
        return _Source(
            {}, others, _headings(others, stated), ("GNSS position and velocity are read without a mapping",)
        )
    return _of_text(path)


def _headings(columns: Iterable[str], stated: Mapping[str, str]) -> dict[str, Heading]:
    return {name: heading(name, stated.get(name, "")) for name in columns}


def _of_text(path: Path) -> _Source:
    """The columns of a table of text, whatever its form."""
    table = dialect_of(path)
    wanted = mapping_file.ColumnMapping.model_validate({**table.keys, "topics": {}})
    header, stated = text_table.read_header(path, wanted)
    names = [name if header.count(name) == 1 else str(index) for index, name in enumerate(header, 1)]
    time, keys, remarks = _time_of(path, table, names, stated)
    content = {"time": {"column": int(time) if time.isdigit() else time, **keys}, **table.keys}
    if (rows := rows_by_name(table)) is not None:
        content["rows"] = rows
        long = LongTable(path, mapping_file.load({**content, "topics": {}}, path))
        units_of = {name: column.unit for name, column in long.signals.items()}
        columns = {name: long.values(name) for name in long.signals}
        return _Source(content, columns, _headings(columns, units_of), remarks)
    values_by_name = {}
    wanted = mapping_file.load({**content, "topics": {}}, path)
    for index, name in enumerate(names):
        if name != time and table.numbers(index) is not None:
            ref: str | int = int(name) if name.isdigit() else name
            values_by_name[name] = text_table.read_table(path, wanted, [ref]).column(mapping_file.Ref(ref)).values
    if not values_by_name:
        raise InputError(f"{path}: no column of numbers in it; its columns are {', '.join(header)[:600]}")
    own = {name: heading(header[i], stated[i]) for i, name in enumerate(names) if name in values_by_name}
    return _Source(content, values_by_name, own, remarks)


def _time_of(
    path: Path, table: Dialect, names: Sequence[str], stated: Sequence[str]
) -> tuple[str, dict[str, Any], list[str]]:
    """The column of time, what a mapping says of it, and remarks: of several that are named so the one with the finest
    steps, and of those one with a date."""
    candidates = []
    for index, name in enumerate(names[: len(table.header)]):
        unit = heading(table.header[index], stated[index]).unit
        keys = time_keys(table, index, unit)
        named = is_time(table.header[index])
        if keys is not None and (index == 0 or named):
            candidates.append(
                (named, len(set(table.cells(index))), _has_date(table, index, keys), -index, name, keys, unit)
            )
    if not candidates:
        raise InputError(f"{path}: no column of times that go on; its columns are {', '.join(table.header)[:600]}")
    _, _, dated, _, name, keys, unit = max(candidates, key=lambda one: one[:4])
    remarks = [] if dated else [_NO_DATE]
    if not dated and (values := table.numbers(names.index(name))) is not None and np.nanmin(values) < 0:
        keys = {**keys, "start": _SECOND_DAY}
        remarks[0] = f"no date in it, and times before zero: they count from {_SECOND_DAY}"
    if keys["unit"] in ("s", "ms", "us", "100us") and not unit:
        remarks.append(f"{name}: no unit is stated; {keys['unit']} by its name, its size and its steps")
    return name, keys, remarks


def _has_date(table: Dialect, index: int, keys: Mapping[str, Any]) -> bool:
    """True if a column of times says on which day they are."""
    if keys["unit"] == "iso" or "start" in keys:
        return True
    values = table.numbers(index)
    return (
        values is not None
        and keys["unit"] in units.QUANTITIES["time"]
        and bool(np.abs(values).max() * units.to_si(keys["unit"]) > UNIX)
    )


def _signal(name: str, topic: str, field: str, stated: str, values: Array, remarks: list[str]) -> dict[str, Any] | None:
    """A signal with a unit that is stated, or that follows from its size."""
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
        "forward": "km/h" if largest > 90 else "m/s",
        "left": "m/s",  # until `_velocities_alike` gives it the unit of `forward`
        "course": "deg" if largest > 7 else "rad",
        "position.steering_wheel": "deg" if largest > 15 else "rad",
        "position.road_wheel_front": "deg" if largest > 1 else "rad",
    }.get(field)
    if field.startswith("angular_velocity"):
        guessed = "deg/s" if largest > _MOST_RADIANS else "rad/s"
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


def _velocities_alike(topics: Mapping[str, Any], remarks: list[str]) -> None:
    """Give a velocity to the left that states no unit that of the one forward, and say what a reference is for."""
    for topic in ("reference/odometry", "vehicle/velocity"):
        if "left" in (fields := topics.get(topic, {})):
            forward, left = fields["forward"], fields["left"]
            if any(remark.startswith(f"{left['column']}: no unit") for remark in remarks):
                left["unit"] = forward["unit"]
            if topic == "reference/odometry":
                remarks.append(
                    f"{forward['column']}, {left['column']}: taken for a reference, which estimates are compared with; "
                    "as vehicle/velocity they would correct them"
                )


def _axes_without_gravity(topics: dict[str, Any], remarks: list[str]) -> None:
    """Leave roll and pitch rates out where no accelerations of all axes show how the sensor's housing lies."""
    imu = topics.get("imu/data", {})
    rates, forces = imu.get("angular_velocity"), imu.get("linear_acceleration") or [None]
    if rates is None or all(forces):
        return
    dropped = [str(signal["column"]) for signal in rates[:2] if signal is not None]
    rates[:2] = [None, None]
    if rates[2] is None:
        imu.pop("angular_velocity")
        if not imu:
            topics.pop("imu/data")
    if dropped:
        remarks.append(
            f"{', '.join(dropped)}: left out; without accelerations along all axes nothing shows how the sensor lies"
        )


def _unit_of_rates(topics: Mapping[str, Any], columns: Mapping[str, Array], remarks: list[str]) -> None:
    """The unit of rates that state none: one for all axes, by the largest value of any."""
    rates = [signal for signal in topics.get("imu/data", {}).get("angular_velocity") or [] if signal is not None]
    bare = [signal for signal in rates if any(r.startswith(f"{signal['column']}: no unit") for r in remarks)]
    if not bare:
        return
    largest = max(float(np.nanmax(np.abs(columns[str(signal["column"])]))) for signal in bare)
    unit, why = ("deg/s" if largest > _MOST_RADIANS else "rad/s"), f"by the size of all axes (up to {largest:.4g})"
    for signal in bare:
        if signal["unit"] != unit:
            signal["unit"] = unit
            remarks.append(f"{signal['column']}: {unit}, {why}")


def _turn_signs(path: Path, content: dict[str, Any], remarks: list[str]) -> None:
    """Reverse what the other sensors contradict."""
    from vsense_ros.bag.importers import import_recording

    for _ in range(_MOST_TURNS):
        reported = findings(import_recording(path, mapping=content))
        turned = _turn_axes(content, reported, remarks)
        for finding in reported:
            fields = content["topics"].get(finding.topic)
            if finding.kind is not Kind.SIGN or not finding.signal or isinstance(finding.mend, Turn) or not fields:
                continue
            signal = _signal_of(fields, finding.signal)
            if signal is None or "sign" in signal:
                continue
            signal["sign"] = -1
            remarks.append(f"{signal['column']}: reversed, as {sentence(finding)}")
            turned = True
        if not turned:
            reported = [one for one in reported if not _with_gravity(content["topics"], one, remarks)]
            remarks += [f"look at {f.topic}: {sentence(f)}" for f in reported if f.kind is not Kind.SIGN]
            return


def _with_gravity(topics: Mapping[str, Any], finding: Finding, remarks: list[str]) -> bool:
    """Add gravity to a vertical acceleration that lacks it, if that is what a finding says."""
    forces = topics.get(finding.topic, {}).get("linear_acceleration")
    if finding.reason is not Reason.NO_GRAVITY or not forces or forces[2] is None or "sign" in forces[2]:
        return False
    forces[2]["offset"] = round(GRAVITY / units.to_si(forces[2]["unit"]), 5)
    remarks.append(
        f"{forces[2]['column']}: gravity is added, which an accelerometer feels; along the other axes of a tilted car "
        "0.17 m/s² of it per degree stay absent"
    )
    return True


def _turn_axes(content: dict[str, Any], findings: Sequence[Finding], remarks: list[str]) -> bool:
    """Exchange and reverse the axes of vectors as findings say; True if there were any."""
    turned = False
    for finding in findings:
        fields = content["topics"].get(finding.topic, {})
        if not isinstance(finding.mend, Turn) or finding.topic != "imu/data":
            continue
        for field in finding.mend.fields:
            old = fields.get(field)
            if not isinstance(old, list):
                continue
            matrix = np.array(finding.mend.matrix)
            source = np.argmax(np.abs(matrix), axis=1)
            fields[field] = [
                None if old[axis] is None else _with_sign(old[axis], int(matrix[row, axis]))
                for row, axis in enumerate(source)
            ]
            turned = True
            reversed_ones = [one["column"] for one, new in zip(old, fields[field], strict=True) if one and new != one]
            if finding.kind is Kind.SIGN:
                remarks += [f"{column}: reversed, as {sentence(finding)}" for column in reversed_ones]
        if finding.kind is not Kind.SIGN:
            remarks.append(f"{finding.topic}: {sentence(finding)}")
    return turned


def _with_sign(signal: dict[str, Any], sign: int) -> dict[str, Any]:
    """A signal with its sign multiplied."""
    rest = {key: value for key, value in signal.items() if key != "sign"}
    return rest if signal.get("sign", 1) * sign > 0 else rest | {"sign": -1}


def _unit_of_forces(content: dict[str, Any], columns: Mapping[str, Array], remarks: list[str]) -> None:
    """The unit of accelerations that state none, by the speed times the yaw rate, which is the lateral one."""
    forces = content["topics"].get("imu/data", {}).get("linear_acceleration")
    rate = (content["topics"].get("imu/data", {}).get("angular_velocity") or [None] * 3)[2]
    speeds = _speeds(content["topics"])
    if not forces or forces[1] is None or rate is None or not speeds:
        return
    names = [str(signal["column"]) for signal in (forces[1], rate, *speeds)]
    if len({len(columns[name]) for name in names}) > 1:
        return
    side, turning, *rolling = (columns[name] for name in names)
    factors = [
        units.to_si(one["unit"]) * (1.0 if units.quantity_of(one["unit"]) == "velocity" else _RADIUS) for one in speeds
    ]
    speed = np.mean([values * factor for values, factor in zip(rolling, factors, strict=True)], axis=0)
    expected = float(np.nanstd(speed * turning * units.to_si(rate["unit"])))
    if expected < _LEAST_FORCE:
        return
    ratio = float(np.nanstd(side)) / expected
    unit = "g" if _IN_G[0] < ratio < _IN_G[1] else "m/s²"
    for signal in forces:
        if (
            signal is not None
            and signal["unit"] != unit
            and any(r.startswith(f"{signal['column']}: no unit") for r in remarks)
        ):
            signal["unit"] = unit
            remarks.append(
                f"{signal['column']}: {unit}, as the lateral acceleration is {ratio:.2g} times speed and yaw rate"
            )


def _speeds(topics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The signals of a mapping that say how fast the car is."""
    for topic in ("gps/velocity", "vehicle/velocity"):
        if "speed" in topics.get(topic, {}):
            return [topics[topic]["speed"]]
    return list(topics.get("vehicle/wheel_speeds", {}).get("velocity", {}).values())


def _signal_of(fields: Mapping[str, Any], name: str) -> dict[str, Any] | None:
    """The entry of a signal in the fields of a topic: of a component of a vector, or of a joint; None if there is
    none."""
    field, _, axis = name.partition(".")
    if axis:
        signals = fields.get(field)
        return signals["xyz".index(axis)] if isinstance(signals, list) else None
    return next((joints[name] for joints in fields.values() if isinstance(joints, dict) and name in joints), None)
