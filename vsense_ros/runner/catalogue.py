"""Every filter that a runner takes, by name: those of the multibody car, then those of GNSS and inertial sensors."""

from __future__ import annotations

from vsense_ros.estimation.catalogue import Catalogue
from vsense_ros.navigation.catalogue import FILTERS as NAVIGATION
from vsense_ros.observer.catalogue import FILTERS as CARS


def every_filter() -> Catalogue:
    """All filters that there are by now: others may have been added to the catalogues of both families."""
    return Catalogue([*CARS, *NAVIGATION])
