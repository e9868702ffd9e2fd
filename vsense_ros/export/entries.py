"""The elements of the exported vectors, and the variables of a unit, in words: for headers and descriptions."""

from __future__ import annotations

from dataclasses import dataclass

from vsense_ros.model.coordinates import DISTURBANCES, INPUTS, WHEELS

FIELDS = {
    "state": "coordinates, velocities, forces beyond the model's, disturbances, biases",
    "inputs": "what drives the model",
    "covariance": "of the errors of the state, row-major",
    "effects": "what physical effects remember of the past",
    "udot": "the last linearisation: derivatives of the velocities",
    "by_q": "... by z, roll, pitch and the travels, column-major",
    "by_u": "... by the velocities",
    "by_disturbances": "... by the disturbances",
    "by_q_rates": "by_q times the rates of these coordinates by the velocities",
    "parameters": "of the vehicle",
    "estimates": "of parameters, which stand in `parameters` too",
    "parameter_covariance": "of their errors",
    "sensitivity": "of the estimated state to them, column-major",
    "information": "on them in the measurements since the start",
    "by_estimates": "the accelerations by them, column-major",
    "reversion_mean": "what the states behind the velocities go back to; a map may have slopes and their changes",
    "surveyed": "where the road was last looked up, and whether its slopes along and across were known there",
    "process_kind": "length of the step [5 us] for which decay and noise were made, and whether brakes may act",
    "decay": "of the states behind the velocities in a step",
    "noise": "variance added to them in a step",
}


@dataclass(frozen=True)
class Entry:
    """An element of a vector in words."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Variable:
    """An array of the unit: where it is in C, and what its elements are."""

    name: str
    place: str
    kind: str  # PARAMETER, INPUT, OUTPUT, TIME
    elements: tuple[Entry, ...]
    start: float | None = None
    may_miss: bool = False  # NaN marks what was not measured

    @property
    def size(self) -> int:
        return len(self.elements)


@dataclass(frozen=True)
class Sensor:
    """A sensor that corrects: its name in C, where its values stand among those measured."""

    name: str
    elements: tuple[Entry, ...]
    first: int

    @property
    def size(self) -> int:
        return len(self.elements)


def _state_entries() -> tuple[Entry, ...]:
    axes = ("x", "y", "z")
    entries = [Entry(a.upper(), "m", f"position of cog in the map, {a}") for a in axes]
    entries += [Entry(a.upper(), "rad", f"{a} angle, z-y-x sequence") for a in ("roll", "pitch", "yaw")]
    entries += [Entry(f"TRAVEL_{w.upper()}", "m", "compression of the suspension") for w in WHEELS]
    entries += [Entry(f"SPIN_{w.upper()}", "rad", "angle of the wheel about its axle") for w in WHEELS]
    entries += [Entry(f"VELOCITY_{a.upper()}", "m/s", f"of cog along the body's {a}") for a in axes]
    entries += [Entry(f"RATE_{a.upper()}", "rad/s", f"about the body's {a}") for a in axes]
    entries += [Entry(f"TRAVEL_RATE_{w.upper()}", "m/s", "of the suspension") for w in WHEELS]
    entries += [Entry(f"SPIN_RATE_{w.upper()}", "rad/s", "of the wheel") for w in WHEELS]
    entries += [Entry(f"MISSING_FORCE_{a.upper()}", "N", f"beyond the model's, along the body's {a}") for a in axes]
    entries += [Entry(f"MISSING_MOMENT_{a.upper()}", "N m", f"beyond the model's, about the body's {a}") for a in axes]
    entries += [Entry(f"MISSING_TRAVEL_FORCE_{w.upper()}", "N", "beyond the model's, on the travel") for w in WHEELS]
    entries += [Entry(f"MISSING_TORQUE_{w.upper()}", "N m", "beyond the model's, on the wheel") for w in WHEELS]
    around = {
        "grade": ("rad", "slope of the road along the car, positive uphill"),
        "bank": ("rad", "slope across, positive where the left side is higher"),
        "grade_change": ("rad/m", "of the grade along the way: the road is bent upwards where it is positive"),
        "bank_change": ("rad/m", "of the bank along the way"),
        "road_height": ("m", "of the road below cog over the map's origin"),
        "steering_offset": ("rad", "by which the measured road-wheel angle is too large"),
        "radius_error": ("-", "relative error of the tyre radius"),
    }
    return (*entries, *(Entry(name.upper(), *around[name]) for name in DISTURBANCES))


STATE_ENTRIES = _state_entries()
_ANGLES = {
    "steering": "mean angle of the front wheels, positive to the left",
    "rear_steering": "angle of the rear wheels, positive to the left; 0 where they are not steered",
}
INPUT_ENTRIES = tuple(
    Entry(name.upper(), "rad", _ANGLES[name])
    if name in _ANGLES
    else Entry(name.upper(), "N m", "on the wheel, drive minus brake; 0 where unknown")
    for name in INPUTS
)
