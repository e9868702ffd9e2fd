"""The filters of the multibody car by name: what they estimate, and when to take which."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from vsense_ros.errors import InputError
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.dekf import WholeCar
from vsense_ros.observer.error_ekf import CarFilter, ErrorEkf
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.full_car_spi import FULL_CAR_FILTERS, FullCarSpi
from vsense_ros.observer.spi import FILTERS as PARAMETER_FILTERS
from vsense_ros.observer.spi import Spi, numbers_kept
from vsense_ros.observer.state import Prior, layout
from vsense_ros.observer.ukf import Ukf


class MakeFilter(Protocol):
    """Makes a filter of a vehicle with sensors; by default `prior` is that of the vehicle file."""

    def __call__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter: ...


@dataclass(frozen=True)
class Family:
    """Filters of one kind, in words, and how one is made for a vehicle and its sensors."""

    title: str
    states: str
    when: str
    make: MakeFilter


def error_ekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The errorEKF with force estimation."""
    return ErrorEkf(CarBlocks(vehicle, sensors, prior=prior))


def dekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The textbook's EKF in discrete form."""
    return ErrorEkf(WholeCar(vehicle, sensors, prior=prior))


def ukf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The unscented Kalman filter."""
    return Ukf(WholeCar(vehicle, sensors, prior=prior))


def full_error_ekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The errorEKF whose model is the car with all its bodies."""
    return ErrorEkf(FullCarBlocks(vehicle, sensors, prior=prior))


def spi(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """State, parameter and input observer, its parameter filter as the vehicle file says."""
    room = _room(vehicle, sensors)
    car = CarBlocks(vehicle, sensors, extra=room, prior=prior)
    return Spi(car, PARAMETER_FILTERS[vehicle.observer.parameter_filter])


def full_spi(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The same on the car with all its bodies."""
    room = _room(vehicle, sensors)
    car = FullCarBlocks(vehicle, sensors, extra=room, prior=prior)
    return FullCarSpi(car, FULL_CAR_FILTERS[vehicle.observer.parameter_filter])


def _room(vehicle: Vehicle, sensors: dict[str, SensorBase]) -> int:
    """For an SPI. Raises `InputError` for a vehicle file that lists no parameters."""
    settings = vehicle.observer.parameters
    if not settings:
        raise InputError(
            f"{vehicle.name}: the SPI estimates parameters, and the vehicle file lists none; name some in "
            "observer.parameters, or take the filter error_ekf"
        )
    return numbers_kept(layout(sensors).size, len(settings))


_STATES = "coordinates, velocities, disturbances, biases"
FILTERS: Mapping[str, Family] = {
    "error_ekf": Family(
        "errorEKF",
        f"errors of {_STATES}, and forces beyond the model's",
        "the default: quick, and finds forces",
        error_ekf,
    ),
    "spi": Family(
        "SPI", "as errorEKF, and the parameters that the vehicle file lists", "mass or friction are not known", spi
    ),
    "dekf": Family("discrete EKF", _STATES, "a reference: no forces, full matrices", dekf),
    "ukf": Family("UKF", _STATES, "a reference: sigma points instead of derivatives, 20 × slower", ukf),
    "full_error_ekf": Family(
        "errorEKF on the full car", "as errorEKF", "the linkages matter; the vehicle file has them", full_error_ekf
    ),
    "full_spi": Family("SPI on the full car", "as SPI", "the linkages matter, and parameters are not known", full_spi),
}


def default_filter(vehicle: Vehicle) -> MakeFilter:
    """The SPI where the vehicle file lists parameters, else the errorEKF."""
    return FILTERS["spi" if vehicle.observer.parameters else "error_ekf"].make


def filter_named(name: str) -> MakeFilter:
    """Raises `InputError` for an unknown name."""
    if name not in FILTERS:
        raise InputError(f"there is no filter {name!r}; known are {', '.join(FILTERS)} (`vsense filters` tells more)")
    return FILTERS[name].make
