"""What columns of tables are called, in the words of loggers: which field of which topic a name means.

A name is looked at as words: capitals within it, underscores, slashes and points divide it, units in brackets or at its
end are taken off. `gyroRotationZ(rad/s)`, `Gyr_Z` and `/imu/data/angular_velocity/z` mean the same.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from vsense_ros.bag.can_names import WHEEL_SIDES, likeness, side_keys
from vsense_ros.messages import units


@dataclass(frozen=True)
class Heading:
    """The heading of a column as words, and the unit that it ends with, empty if none."""

    words: str
    unit: str = ""


_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]?")
# Units that stand at the end of a name without brackets: SPEED_KPH, HEADING_DEG, "time since start in ms". Xsens counts
# SampleTimeFine in tenths of a millisecond.
_UNIT_WORDS = {
    "kph": "km/h", "kmh": "km/h", "mph": "mph", "mps": "m/s", "deg": "deg", "rad": "rad", "meter": "m", "meters": "m",
    "ft": "ft", "ms": "ms", "msec": "ms", "us": "us", "usec": "us", "ns": "ns", "nsec": "ns", "sec": "s", "secs": "s",
    "fine": "100us", "dps": "deg/s", "degs": "deg/s", "degps": "deg/s", "rads": "rad/s", "radps": "rad/s",
    "mps2": "m/s²", "mpss": "m/s²",
}  # fmt: skip


def heading(name: str, stated: str = "") -> Heading:
    """The words of a column's name, and its unit: the one that is stated, or that its last word is."""
    bare = _BRACKETS.sub(lambda match: f" {match[1]} " if match[1].strip().lower() in ("x", "y", "z") else " ", name)
    divided = re.sub(r"(?<=[a-zäöüß])(?=[A-ZÄÖÜ])|(?<=[A-Z])(?=[A-Z][a-z])", " ", bare)
    words = re.sub(r"[^a-zäöüßéè0-9]+", " ", divided.lower()).split()
    while len(words) > 1 and words[-1].isdigit() and len(words[-1]) < 3:
        words.pop()
    last = _UNIT_WORDS.get(words[-1], "") if len(words) > 1 else ""
    if last:
        words.pop()
        if len(words) > 1 and words[-1] == "in":
            words.pop()
    return Heading(" ".join(words), stated or last)


_ACC = r"(?:acc(?:el(?:eration|erometer)?)?|g ?force|beschl(?:eunigung)?)"
_GYRO = r"(?:gyr(?:o(?:scope)?)?|(?:angular|rotation|rotational) (?:rate|velocity|speed)|rate|omega|rotation)"
_AXIS = {
    axis: rf"(?:{_GYRO}(?: rotation| rate| velocity)? ?{axis}v?|{axis} {_GYRO}(?: of rotation| gyroscope)?)"
    for axis in "xyz"
}
_GPS = r"(?:gps|gnss|location|ins)"
_ROAD_WHEEL = r"(?:road ?wheel ?(?:steer(?:ing)? )?angle|delta|df)"
_VELOCITY = r"(?:v|vel|velocity|speed|geschwindigkeit)"
# Velocities in the axes of the car, which mean something together.
_AXES_OF_CAR = {
    "forward": re.compile(
        rf"(?:.* )?(?:{_VELOCITY} ?(?:x|long?|longitudinal|forward)|u ?x|(?:long?|longitudinal|forward) {_VELOCITY})"
    ),
    "left": re.compile(rf"(?:.* )?(?:{_VELOCITY} ?(?:y|lat|lateral)|u ?y|(?:lat|lateral) {_VELOCITY})"),
}  # fmt: skip
_SPEED = r"(?:speed|velocity|sog|ground ?speed|geschwindigkeit|spd)(?: (?:2d|over ground|horizontal))?"


@dataclass(frozen=True)
class Named:
    """The field of a topic that has certain names, and the quantity that their unit must be one of."""

    topic: str
    field: str
    pattern: str
    quantity: str


# In this order: a name of several meanings means the first one that is still free.
NAMES: tuple[Named, ...] = (
    Named("imu/data", "angular_velocity.0", rf"(?:roll ?(?:rate|velocity)|w ?x|{_AXIS['x']})", "angular velocity"),
    Named("imu/data", "angular_velocity.1", rf"(?:pitch ?(?:rate|velocity)|w ?y|{_AXIS['y']})", "angular velocity"),
    Named(
        "imu/data", "angular_velocity.2",
        rf"(?:(?:gyro )?yaw ?(?:rate|velocity|speed)|gierrate|psip|w ?z|r|gps gyro|{_AXIS['z']})",
        "angular velocity",
    ),
    Named("imu/data", "angular_velocity.2", r"(?:gyro )?yaw", "angular velocity"),  # where no column says rate
    Named(
        "imu/data", "linear_acceleration.0",
        rf"(?:(?:lon(?:g|gitudinal)?|längs|laengs|line?a?) ?{_ACC}|(?:linear )?{_ACC} ?(?:xv?|lon(?:g|gitudinal)?)"
        rf"|a ?x(?: g)?|a ?long|x {_ACC}|g x|line?al? ?gs?|longitudinal ?gs?|acceleration ?gs)",
        "acceleration",
    ),
    Named(
        "imu/data", "linear_acceleration.1",
        rf"(?:(?:lat(?:eral)?|quer) ?{_ACC}|(?:linear )?{_ACC} ?(?:yv?|lat(?:eral)?)|a ?y(?: g)?|a ?lat|y {_ACC}|g y"
        r"|lateral ?gs?)",
        "acceleration",
    ),
    Named(
        "imu/data", "linear_acceleration.2",
        rf"(?:vert(?:ical)? ?{_ACC}|(?:linear )?{_ACC} ?(?:zv?|vert(?:ical)?)|a ?z(?: g)?|z {_ACC}|g z|vertical ?g)",
        "acceleration",
    ),
    Named("gps/fix", "latitude", r"lat(?:itude)?(?: y position)?", "angle"),
    Named("gps/fix", "longitude", r"(?:lon(?:g|gitude)?|lng)(?: x position)?", "angle"),
    Named("gps/fix", "altitude", r"(?:alt(?:itude)?|height|elevation)", "length"),
    Named("gps/velocity", "speed", rf"{_GPS} {_SPEED}", "velocity"),
    Named("gps/velocity", "speed", rf"(?:{_SPEED}|v|v ?x|v ?ego)", "velocity"),
    Named(
        "gps/velocity", "course",
        r"(?:course(?: over ground)?|heading|bearing|cog|track(?: 2d| angle)?|direction|location orientation)", "angle",
    ),
    Named(
        "vehicle/steering", "position.steering_wheel",
        r"(?:(?:steer(?:ing|ed)?|strg) ?(?:wheel|whl)? ?(?:angle|ang)?|lenk(?:rad)?winkel|swa|lwi|lrw"
        r"|delta ?hw|hand ?wheel(?: angle)?)", "angle",
    ),
    Named("vehicle/steering", "position.road_wheel_front", _ROAD_WHEEL, "angle"),
)  # fmt: skip
# Before a name these words make something else of it: a speed of the engine is none of the car.
_OTHER_THINGS = re.compile(
    r"\b(?:engine|motor|rpm|wind|fan|turbo|turbine|shaft|pump|predicted|target|desired|demand|setpoint|limit|lead|cruise"
    r"|accuracy|error|std|stddev|sigma|deviation|variance|covariance|raw|uncalibrated|bias|offset|calculated|relative"
    r"|magnetic|magnetometer|gravity|vibration|quaternion|base|reference|ref|lap|start|user|slip|field orientation"
    r"|vertical(?= speed| velocity)|vert(?= vel)|wheel(?= speed| spd| velocity| [a-z]+ speed)|motion(?! rotation| user)"
    r")\b"
)
_TIME = re.compile(
    r"(?:.* )?(?:time|timestamp|zeit|t|utc|elapsed(?: time)?|seconds(?: elapsed)?|offset|date time|sample time"
    r"|time(?:stamp)? since (?:start|1970)|timestamp since1970|yyyy mo dd hh mi ss sss)"
)


def is_time(name: str) -> bool:
    """True if a column is called like one of times."""
    words = heading(name).words
    return bool(_TIME.fullmatch(words)) and not re.search(r"\b(?:lap|predicted|best|fragment|sector)\b", words)


def meanings(headings: Mapping[str, Heading]) -> dict[tuple[str, str], str]:
    """The columns by what they mean, topic and field; each column means one thing, and each thing is one column.

    A column whose unit is one of another quantity means nothing.
    """
    names: dict[tuple[str, str], str] = {}
    for named in NAMES:
        expression = re.compile(rf"(?:.* )?{named.pattern}")
        for name, own in headings.items():
            if (named.topic, named.field) in names:
                break
            if name in names.values() or not expression.fullmatch(own.words) or _OTHER_THINGS.search(own.words):
                continue
            if units.quantity_of(own.unit) in (None, "number", named.quantity):
                names[named.topic, named.field] = name
    for wheel, name in _wheels({name: own for name, own in headings.items() if name not in names.values()}).items():
        names["vehicle/wheel_speeds", f"velocity.wheel_{wheel}"] = name
    _add_velocities(names, headings)
    return names


def _add_velocities(names: dict[tuple[str, str], str], headings: Mapping[str, Heading]) -> None:
    """Add velocities forward and to the left: beside another speed they are a reference, else a measurement."""
    pair = {field: _velocity(expression, headings) for field, expression in _AXES_OF_CAR.items()}
    if not all(pair.values()):
        return
    alone = ("gps/velocity", "speed")
    if names.get(alone) == pair["forward"] and ("gps/velocity", "course") not in names:
        del names[alone]
    if not set(pair.values()).isdisjoint(names.values()):
        return
    has_other = alone in names or any(topic == "vehicle/wheel_speeds" for topic, _ in names)
    names.update({("reference/odometry" if has_other else "vehicle/velocity", k): name for k, name in pair.items()})


def _velocity(expression: re.Pattern[str], headings: Mapping[str, Heading]) -> str:
    """The first column whose name is such a velocity; empty if there is none."""
    return next(
        (
            name
            for name, own in headings.items()
            if expression.fullmatch(own.words)
            and not _OTHER_THINGS.search(own.words)
            and units.quantity_of(own.unit) in (None, "number", "velocity")
        ),
        "",
    )


def _wheels(headings: Mapping[str, Heading]) -> dict[str, str]:
    """Columns of the speeds of four wheels by wheel, if there are four whose names differ in the wheel alone."""
    families: dict[tuple[int, str], dict[str, str]] = {}
    short = re.compile(
        r"(?:.* )?(?:v|n|w|ws|rad|omega|wheel|rot ?v)(?: ?(?:fl|fr|rl|rr|vl|vr|hl|hr|lf|rf|lr))(?: rot ?v)?"
    )
    for name, own in headings.items():
        if units.quantity_of(own.unit) not in (None, "number", "velocity", "angular velocity"):
            continue
        if likeness("wheel_speed", name, "") > 0 or short.fullmatch(own.words):
            for row, side, key in side_keys(name):
                families.setdefault((row, key), {}).setdefault(side, name)
    return next((family for family in families.values() if set(family) == set(WHEEL_SIDES)), {})
