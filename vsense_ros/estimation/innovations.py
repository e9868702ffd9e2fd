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
    """Innovations of one sensor on one recording, in order of measurement.

    `whitened` (n, m): each component, less what those before it in the same message explain, in units of its standard
    deviation, `deviation` (n, m) [units of the sensor]; both NaN where a component was absent. `used` (n,) is False
    where the gate refused the message. `stamp` (n,) is when it was measured [ns].
    """

    whitened: Array
    deviation: Array
    used: NDArray[np.bool_]
    stamp: NDArray[np.int64]

    @property
    def there(self) -> NDArray[np.bool_]:
        """Messages (n,) of which there is an innovation."""
        return np.asarray(~np.all(np.isnan(self.deviation), axis=1))

    def at(self, stamp: NDArray[np.int64]) -> Innovations:
        """The innovations of messages that were measured at these times, in order of time; none, and not used, where
        this filter did not judge a message: it may have been starting anew, or have left the sensor out."""
        if np.array_equal(stamp, self.stamp):
            return self
        if not len(self.stamp):
            none = np.full((len(stamp), self.whitened.shape[1]), np.nan)
            return Innovations(none, none, np.zeros(len(stamp), bool), stamp)
        place = np.minimum(np.searchsorted(self.stamp, stamp), len(self.stamp) - 1)
        known = self.stamp[place] == stamp
        whitened, deviation = (np.where(known[:, None], row[place], np.nan) for row in (self.whitened, self.deviation))
        return Innovations(whitened, deviation, self.used[place] & known, stamp)

    def log_density(self) -> Array:
        """The log density of each message given all before it, used or refused, (n,)."""
        scale = np.nansum(np.log(self.deviation * np.sqrt(2 * np.pi)), axis=1)
        return -scale - 0.5 * np.nansum(self.whitened**2, axis=1)

    def credible(self) -> NDArray[np.bool_]:
        """Messages (n,) that are no outliers: what the gate let pass, and all if it refused more than `MOST_OUTLIERS`
        of them, since then it is the filter that is wrong."""
        return self.used | (np.mean(self.used) < 1 - MOST_OUTLIERS)
