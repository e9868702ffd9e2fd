"""Findings and transformations in words: the one place where the checks make sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from vsense_ros.checks.finding import Confidence, Exchange, Finding, Kind, Rename, Scale, Turn
from vsense_ros.checks.motion import ACCELEROMETER, GNSS, GYRO, WHEELS

# What a source of a motion measures, and what the components of an inertial sensor are.
_WORDS: Mapping[str, str] = {
    GNSS: "the turning of the GNSS course",
    WHEELS: "the difference of the wheels on the right and left",
    GYRO: "the yaw rate",
    ACCELEROMETER: "the lateral acceleration",
    "angular_velocity.z": "the yaw rate",
    "linear_acceleration.x": "the longitudinal acceleration",
    "linear_acceleration.y": "the lateral acceleration",
}
_MEASURED_AS_NAMED = (Kind.JUMP, Kind.QUANTISED, Kind.FROZEN, Kind.MISSING)  # findings about values of a field
_AXES = ("forward", "left", "up")
_GROUND_AXES = ("east", "north", "up")


def sentence(finding: Finding) -> str:
    """What is wrong, in words that follow the name of the topic."""
    begin, end = finding.span or (np.nan, np.nan)
    in_words = {} if finding.kind in _MEASURED_AS_NAMED else _WORDS
    words = {
        "signal": in_words.get(finding.signal, finding.signal),
        "against": _WORDS.get(finding.against, finding.against),
        "begin": begin,
        "duration": end - begin,
        "given": finding.mend.given if isinstance(finding.mend, Scale) else "",
        "convention": "",
        "undecided": ", or the IMU is turned by 180° about z" if finding.confidence is Confidence.UNDECIDED else "",
        "behind": _behind(finding.evidence) if finding.kind is Kind.LAG else "",
    }
    return finding.reason.value.format(**{**words, **finding.evidence, **finding.names}).strip()


def sentences(findings: Iterable[Finding]) -> list[str]:
    """Findings in words, each after the name of its topic."""
    return [f"{finding.topic}: {sentence(finding)}" for finding in findings]


def mend_in_words(finding: Finding) -> str:
    """What would put a topic right, after its name. Raises `ValueError` for a finding that nothing mends."""
    return f"{finding.topic}: {_transformation(finding)}"


def _transformation(finding: Finding) -> str:
    match finding.mend:
        case Rename():
            return "left and right exchanged"
        case Exchange(fields=fields):
            return f"{' and '.join(fields)} exchanged"
        case Turn(matrix=matrix):
            names = _GROUND_AXES if finding.mend.fields == ("linear",) else _AXES
            axes = ", ".join(f"{axis} is {_direction(row)}" for axis, row in zip(names, matrix, strict=True))
            return f"{sentence(finding)}: {axes}"
        case Scale(factor=-1.0, column=column):
            return f"{column}: the sign reversed" if column else "the sign reversed"
        case Scale(column=column, given=given, expected=expected):
            return f"{column}: degrees into {expected}" if column else f"{given} into {expected}"
    raise ValueError(f"{finding.topic}: expected a finding with a transformation, found none for {finding.reason.name}")


def _direction(row: Iterable[float]) -> str:
    values = np.array(tuple(row))
    axis = int(np.argmax(np.abs(values)))
    return f"{'−' if values[axis] < 0 else '+'}{'xyz'[axis]}"


def _behind(lags: Mapping[str, float]) -> str:
    return ", ".join(f"{abs(lag):.2f} s {'behind' if lag > 0 else 'ahead of'} {topic}" for topic, lag in lags.items())
