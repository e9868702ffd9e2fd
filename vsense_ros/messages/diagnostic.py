"""Health of a sensor or of an estimator, in the terms of REP-107, without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One status line: who, how well, in words, and the figures behind it."""

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)
