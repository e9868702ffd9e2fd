"""Numbers by which checks decide, each with its unit, its meaning and where it comes from."""

from __future__ import annotations

from dataclasses import field, fields
from typing import Any

# Most thresholds were chosen so that planted faults are named and drives without a fault are not doubted.
EXAMINATION = "`make recordings`: 35 planted faults in 200 drives, and 100 drives without a fault"
JUDGEMENT = "judgement"


def setting(value: float | tuple[float, ...], unit: str, meaning: str, source: str = EXAMINATION) -> Any:
    """A field of a settings dataclass: its default `value`, its unit ("-" for none), what it means, and its source."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "source": source})


def described(settings: type[Any]) -> dict[str, tuple[str, str, str]]:
    """Unit, meaning and source of each field of a settings dataclass, by name."""
    return {
        one.name: (one.metadata["unit"], one.metadata["meaning"], one.metadata["source"]) for one in fields(settings)
    }
