"""GNSS receivers that a simulated car may have (Leung 2010, table 4.8): standard deviations of position and velocity.

Where the table has a range of positions its middle is taken. Prices are of 2010.
"""

from __future__ import annotations

from dataclasses import dataclass

from vsense_ros.errors import InputError
from vsense_ros.model.sensors import GnssPosition, GnssVelocity
from vsense_ros.model.sensors.base import Transmission
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class ReceiverRates:
    """Rates of fixes that receivers have."""

    least: float = 0.1  # [Hz]
    largest: float = 100.0  # [Hz]


RATES = ReceiverRates()


@dataclass(frozen=True)
class Receiver:
    """Standard deviations, east and north alike."""

    title: str
    position: float  # [m]
    velocity: float  # [m/s]


RECEIVERS = {
    "survey": Receiver("survey grade, above 12 000 US$", 0.01, 0.01),
    "mapping": Receiver("mapping grade, 500 to 12 000 US$", 3.5, 0.10),
    "consumer": Receiver("consumer grade, below 500 US$", 17.5, 0.50),
    "dg_100": Receiver("GlobalSat DG-100, about 75 US$", 3.5, 0.04),
    "dg_100_antenna": Receiver("GlobalSat DG-100 with an antenna, about 95 US$", 1.5, 0.017),
}


def with_receiver(vehicle: Vehicle, name: str | None = None, rate: float | None = None) -> Vehicle:
    """The vehicle with this receiver instead of its own, or with its own, and with so many fixes a second [Hz].

    A vehicle without GNSS gets one at cog. Raises `InputError` for an unknown name and an impossible rate.
    """
    if name is not None and name not in RECEIVERS:
        raise InputError(f"no receiver {name!r}; known are {', '.join(RECEIVERS)}")
    if rate is not None and not RATES.least <= rate <= RATES.largest:
        raise InputError(f"a receiver gives {RATES.least:g} to {RATES.largest:g} fixes a second, not {rate:g}")
    sensors = dict(vehicle.sensors)
    for kind, key in ((GnssPosition, "position"), (GnssVelocity, "velocity")):
        receivers = [place for place, sensor in sensors.items() if isinstance(sensor, kind)]
        if not receivers and name is not None:
            key = key if key not in sensors else f"gnss_{key}"
            sensors[key], receivers = kind(), [key]
        for place in receivers:
            changes: dict[str, object] = {}
            if name is not None:
                changes["noise"] = getattr(RECEIVERS[name], kind.model_fields["kind"].default.removeprefix("gnss_"))
            if rate is not None:
                present = sensors[place].transmission or Transmission()
                changes["transmission"] = present.model_copy(update={"period": 1 / rate})
                changes["timeout"] = max(sensors[place].timeout, 2.5 / rate)
            sensors[place] = sensors[place].model_copy(update=changes)
    return vehicle.model_copy(update={"sensors": sensors})
