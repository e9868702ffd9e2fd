"""The innovations of one sensor in a row.

If the filter is right about itself, they are white noise of the covariance that it states (Mehra 1970), and the product
of their densities is the likelihood of the measurements (Schweppe 1965).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_OUTLIERS = 0.05  # of the messages of a sensor


@dataclass(frozen=True)
class Innovations:
    """Of one sensor on one recording, in order of measurement.

    `whitened` (n, m): each component, less what those before it in the same message tell, in units of its standard
    deviation, `deviation` (n, m) [units of the sensor]; both NaN where a component was absent. `used` (n,) is False
    where the gate refused the message.
    """

    whitened: Array
    deviation: Array
    used: NDArray[np.bool_]

    def log_density(self) -> Array:
        """Of each message given all before it, whether it was used or not, (n,)."""
        scale = np.nansum(np.log(self.deviation * np.sqrt(2 * np.pi)), axis=1)
        return -scale - 0.5 * np.nansum(self.whitened**2, axis=1)

    def credible(self) -> NDArray[np.bool_]:
        """Messages (n,) that are no outliers: what the gate let pass, and all if it refused more than `MOST_OUTLIERS`
        of them, since then it is the filter that is wrong."""
        return self.used | (np.mean(self.used) < 1 - MOST_OUTLIERS)
