"""The thresholds of the verdict, from the file `thresholds.yaml` beside this one, with the data they came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write

FILE = Path(__file__).with_suffix(".yaml")
KEYS = {"value", "unit", "meaning", "source"}  # of each threshold in the file


@dataclass(frozen=True)
class Thresholds:
    """What the verdict is decided by; the file states unit, meaning and source of each."""

    least_gain: float
    short_driving: float
    small_independent_share: float
    most_asked: float
    further_share: float
    clear_further_gain: float
    evident_gain: float
    form_error: float
    least_term_gain: float
    term_advantage: float
    negligible_size: float
    lasting_share: float
    spoilt_share: float
    rival_share: float
    rival_left: float
    surpassed_share: float
    sure_share: float
    partial_gain: float
    unexplained: float
    signal_off: float
    noise_level: float
    mended: float
    disagreement: float
    unnoticed_change: float
    least_telling: float
    many_windows: int
    remarkable_gain: float
    least_compared: float
    trusted: float
    clear_name: float
    improbable: float
    by_lead: float
    refused: float
    least_confidence: float
    size_error: float
    odds: float
    little: float
    little_rolling_resistance: float
    little_brake_drag: float
    little_steering_compliance: float

    def little_of(self, effect: str) -> float:
        """What every car has of an effect, as a share of a typical size."""
        own: float = getattr(self, f"little_{effect}", self.little)
        return own

    def least_gain_on(self, driven: float) -> float:
        """Least gain of an effect on so much driving [s]: the less there is, the more of it chance explains."""
        return self.least_gain * max(1.0, self.short_driving / driven)


def read(path: Path = FILE) -> Thresholds:
    """The thresholds in a file. Raises `InputError` where one is missing, unknown, or has no number, unit, meaning or
    source."""
    entries = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    names = {field.name for field in fields(Thresholds)}
    if not isinstance(entries, dict) or entries.keys() != names:
        differ = ", ".join(sorted(names ^ set(entries or ())))
        raise InputError(f"{path}: expected the thresholds of the verdict, found others or not all: {differ}")
    for name, entry in entries.items():
        if not isinstance(entry, dict) or entry.keys() != KEYS or not isinstance(entry["value"], int | float):
            raise InputError(f"{path}: {name}: expected value (a number), unit, meaning and source, found {entry}")
    return Thresholds(**{name: entry["value"] for name, entry in entries.items()})


def write(changes: Mapping[str, tuple[float, str]], path: Path = FILE) -> None:
    """Write values of thresholds, by name and each with the data it came from, into a file; all else in it stays."""
    yaml = YAML()
    yaml.preserve_quotes, yaml.width = True, 1000  # lines are those of the file
    content: Any = yaml.load(path.read_text(encoding="utf-8"))
    for name, (value, source) in changes.items():
        content[name]["value"], content[name]["source"] = value, source
    with atomic_write(path) as file:
        yaml.dump(content, file)


THRESHOLDS = read()
