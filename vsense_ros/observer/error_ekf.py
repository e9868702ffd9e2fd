"""errorEKF with force estimation (Sanjurjo, Dopico, Luaces & Naya 2018; Rodríguez 2020)."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Filter
from vsense_ros.observer.car_blocks import CarBlocks


class CarFilter(Filter):
    """A filter of the multibody car: all that the observer, its estimates and its monitor need of one."""

    car: CarBlocks
    in_car: ClassVar[bool] = False  # True: mean and covariance in the memory of the car are all that it believes

    def start_rolling(self, speed: float) -> None:
        """Begin as a car that rolls straight ahead at `speed` [m/s], known as little as before any measurement."""
        self.car.forget()
        self.start(self.car.rolling(speed))

    @abstractmethod
    def set_element(self, index: int, value: float, deviation: float) -> None:
        """Set one element of the mean, whose error then has this standard deviation and no correlation."""

    def linearize(self) -> None:
        """At the present state, once somebody has changed it."""
        self.car.linearize()


class ErrorEkf(Ekf, CarFilter):
    """The extended Kalman filter on the blocks of the car."""

    in_car = True

    def __init__(self, car: CarBlocks) -> None:
        super().__init__(car)
        self.car = car
