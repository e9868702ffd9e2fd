"""Which signals of a bus come from a satellite receiver: position, speed over ground and course."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from vsense_ros.bag.can_names import likeness, plain
from vsense_ros.bag.can_survey import HeardSignal
from vsense_ros.messages import units

_EXCLUDED = "acc|error|std|sigma|dop|sat|valid|stat|time|date|fix|qual"  # accuracies and states of a receiver
# The quantities of a receiver: patterns of the name, the quantity of the unit, the units that are tried where none is
# stated, and the least and largest value in the first of these.
_QUANTITIES: Mapping[str, tuple[str, str, tuple[str, ...], tuple[float, float]]] = MappingProxyType(
    {
        "latitude": ("lat(?!eral)|breite", "angle", ("deg",), (-90.0, 90.0)),
        "longitude": ("lon(?!gitudinal)|lng|laenge", "angle", ("deg",), (-180.0, 180.0)),
        "altitude": ("alt|height|hoehe", "length", ("m",), (-500.0, 9000.0)),
        "east": ("vel_?e(?:ast)?(?:_|$)|ve_|east_?(?:vel|speed)", "velocity", ("m/s", "km/h"), (-120.0, 120.0)),
        "north": ("vel_?n(?:orth)?(?:_|$)|vn_|north_?(?:vel|speed)", "velocity", ("m/s", "km/h"), (-120.0, 120.0)),
        "speed": ("speed|spd|geschw|velocity", "velocity", ("km/h", "m/s"), (0.0, 450.0)),
        "course": ("course|heading|track|kurs|cog(?:_|$)", "angle", ("deg",), (-180.0, 360.0)),
    }
)
# What a message of each kind must have, any of these.
_FORMS: Mapping[str, tuple[tuple[str, ...], ...]] = MappingProxyType(
    {"gnss_fix": (("latitude", "longitude"),), "gnss_velocity": (("east", "north"), ("speed", "course"))}
)
_WELCOME: Mapping[str, tuple[str, ...]] = MappingProxyType({"gnss_fix": ("altitude",), "gnss_velocity": ()})


@dataclass(frozen=True)
class GnssOutput:
    """A message of a satellite receiver: `kind` of the mapping's output, and each quantity's signal with its unit."""

    kind: str
    message: str
    signals: Mapping[str, tuple[HeardSignal, str]] = field(default_factory=dict)


def gnss_outputs(signals: Sequence[HeardSignal]) -> tuple[GnssOutput, ...]:
    """The position and the velocity of a satellite receiver, each made of the signals of one message.

    Of several messages that carry a quantity, the one that comes most often is taken.
    """
    by_message: dict[str, dict[str, tuple[HeardSignal, str]]] = defaultdict(dict)
    for signal in signals:
        quantity = _quantity(signal)
        if quantity is not None and quantity[0] not in by_message[signal.message]:
            by_message[signal.message][quantity[0]] = signal, quantity[1]
    outputs = []
    for kind, forms in _FORMS.items():
        candidates = [
            GnssOutput(kind, message, {name: carried[name] for name in (*form, *_WELCOME[kind]) if name in carried})
            for message, carried in by_message.items()
            for form in forms
            if set(form) <= set(carried)
        ]
        if candidates:
            outputs.append(max(candidates, key=lambda one: next(iter(one.signals.values()))[0].rate))
    return tuple(outputs)


def _quantity(signal: HeardSignal) -> tuple[str, str] | None:
    """Name of the quantity that a signal of a receiver carries, and its unit; None if it carries none of them."""
    if likeness("gnss", signal.name, signal.message) == 0:
        return None
    name = plain(signal.name)
    if re.search(_EXCLUDED, name):
        return None
    for quantity, (pattern, kind, choices, (low, high)) in _QUANTITIES.items():
        if not re.search(pattern, name):
            continue
        stated = units.canonical(signal.unit) if signal.unit else None
        unit = stated if stated is not None and units.quantity_of(stated) == kind else choices[0]
        scale = units.to_si(unit) / units.to_si(choices[0])
        if low <= signal.low * scale and signal.high * scale <= high:
            return quantity, unit
    return None
