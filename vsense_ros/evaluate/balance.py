"""How well the estimated tyre forces of a drive add up to what the inertial sensor feels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.evaluate.signals import find_channel
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car.balance import SHARES, CarBalance
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

SETTLED = 2.0  # [s] from the first estimate on, which do not count


@dataclass(frozen=True)
class Balance:
    """Imbalance of the forces at n estimates, low-passed."""

    stamp: NDArray[np.int64]  # (n,) [ns]
    shares: Array  # (n, 6), as `SHARES`, NaN where the inertial sensor lacks the axes

    @property
    def measured(self) -> list[str]:
        """Names of what could be compared."""
        return [name for name in SHARES if np.isfinite(self.of(name)).any()]

    def of(self, name: str) -> Array:
        """The share of this name, (n,)."""
        return np.asarray(self.shares[:, SHARES.index(name)])

    @property
    def percent(self) -> Mapping[str, float]:
        """Root mean squares once the observer has settled, by name [%]."""
        settled = self.stamp > self.stamp[0] + SETTLED * 1e9
        rows = settled if settled.any() else slice(None)
        return {name: 100 * float(np.sqrt(np.nanmean(self.of(name)[rows] ** 2))) for name in self.measured}


def balance(output: Recording, vehicle: Vehicle) -> Balance | None:
    """The balance of forces of an observer's output with this vehicle; None where no inertial sensor was heard, or a
    filter knows no forces."""
    channel = find_channel(output, "vsense/balance")
    if channel is None or not len(channel):
        return None
    wrench = np.hstack([channel.columns["force"], channel.columns["torque"]])
    return Balance(channel.stamp, CarBalance(vehicle.physics).shares(wrench))
