"""What the vote can find to be wrong alone: an axis of an inertial sensor, a wheel, a whole sensor, an input."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Suspect:
    """Components of a sensor that fail together, by the place of the sensor and their own places.

    An input has no innovation of its own: if it is wrong, its error is estimated from all other sensors, as the
    element `input_error` of the state. `words` say within a sensor's line what it is, `name` says it alone. A suspect
    that is a `part_of_many` is one of several that make up a whole sensor.
    """

    sensor: int
    components: tuple[int, ...]
    name: str
    words: str
    input_error: int | None = None
    part_of_many: bool = False


@dataclass
class Out:
    """A suspect that is not believed, what for, and how its readings have agreed with the other sensors of late."""

    since: int  # [ns]
    why: str
    agreed_from: int = 0  # [ns]
    count: int = 0
    squares: float = 0.0
    total: float = 0.0  # of innovations of its first component, in its units
    value: float = 0.0  # of its first component when it was last compared, and how often it had been the same
    same: int = 0
    offset: float = 0.0  # of an input: what its error was before it was left out
