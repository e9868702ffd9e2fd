"""Every filter that a runner takes, by name: those of the multibody car, then those of GNSS and inertial sensors."""

from __future__ import annotations

from vsense_ros.estimation.catalogue import Catalogue
from vsense_ros.navigation.catalogue import FILTERS as NAVIGATION
from vsense_ros.observer.catalogue import FILTERS as CARS

FILTERS = Catalogue([*CARS, *NAVIGATION])
