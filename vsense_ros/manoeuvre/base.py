"""What a manoeuvre is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vsense_ros.model.simulation.closed_loop import Driver
from vsense_ros.model.simulation.surface import Surface
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class Manoeuvre:
    """One test drive, from a straight run at `speed` [m/s] along the map's x axis.

    `driver` makes a fresh driver for a vehicle. `friction` replaces that of the vehicle's road where the manoeuvre is
    defined on a road of its own. On a `surface` it is the car with all its bodies and linkages that drives, if the
    vehicle file has them.
    """

    name: str
    title: str
    source: str  # the standard or paper that defines it, and where this one departs from it
    duration: float  # [s]
    speed: float
    driver: Callable[[Vehicle], Driver]
    friction: float | None = None
    surface: Callable[[], Surface] | None = None  # makes the road; None: level ground
    biased: bool = True  # whether the sensors have biases besides their noise
