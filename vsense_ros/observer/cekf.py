"""The continuous extended Kalman filter of the car, a reference (Rodríguez 2020, "Kalman filters based on MB
dynamics")."""

from __future__ import annotations

from vsense_ros.estimation.cekf import Cekf
from vsense_ros.observer.dekf import WholeCar
from vsense_ros.observer.error_ekf import CarFilter


class CarCekf(Cekf, CarFilter):
    """The continuous filter on the car without forces beyond the model's."""

    def __init__(self, car: WholeCar) -> None:
        super().__init__(car)
        self.car: WholeCar = car
