"""The filters of the multibody car by name: what they estimate, and when to take which."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from vsense_ros.estimation.catalogue import Catalogue, FilterFamily
from vsense_ros.estimation.cekf import numbers_held
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.cekf import CarCekf
from vsense_ros.observer.dekf import WholeCar
from vsense_ros.observer.error_ekf import CarFilter, ErrorEkf
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.full_car_spi import FULL_CAR_FILTERS, FullCarSpi
from vsense_ros.observer.spi import FILTERS as PARAMETER_FILTERS
from vsense_ros.observer.spi import Spi, numbers_kept
from vsense_ros.observer.state import Prior, layout
from vsense_ros.observer.ukf import Ukf


@dataclass(frozen=True)
class SpiDefaults:
    """How far numbers of a car may be from its file where the file does not say so: decisions of this project."""

    friction: float = 0.15  # [-] from dry to damp asphalt
    cornering_scale: float = 0.2  # [-] of an axle: from one tyre to another on the same rim
    least_share: float = 0.25  # [-] of the file's value, below which none of them can be


SPI_DEFAULTS = SpiDefaults()


class MakeFilter(Protocol):
    """Makes a filter of a vehicle with sensors; by default `prior` is that of the vehicle file."""

    def __call__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter: ...


def error_ekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The errorEKF with force estimation."""
    return ErrorEkf(CarBlocks(vehicle, sensors, prior=prior))


def dekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The textbook's EKF in discrete form."""
    return ErrorEkf(WholeCar(vehicle, sensors, prior=prior))


def cekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The EKF in continuous form."""
    held_numbers = numbers_held(len(sensor.deviations()) for sensor in sensors.values())
    return CarCekf(WholeCar(vehicle, sensors, extra=held_numbers, prior=prior))


def ukf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The unscented Kalman filter."""
    return Ukf(WholeCar(vehicle, sensors, prior=prior))


def full_error_ekf(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The errorEKF whose model is the car with all its bodies."""
    return ErrorEkf(FullCarBlocks(vehicle, sensors, prior=prior))


def spi(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """State, parameter and input observer, its parameter filter as the vehicle file says."""
    vehicle = with_parameters(vehicle)
    extra = extra_numbers(vehicle, sensors)
    car = CarBlocks(vehicle, sensors, extra=extra, prior=prior)
    return Spi(car, PARAMETER_FILTERS[vehicle.observer.parameter_filter])


def full_spi(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
    """The SPI whose model is the car with all its bodies."""
    vehicle = with_parameters(vehicle)
    extra = extra_numbers(vehicle, sensors)
    car = FullCarBlocks(vehicle, sensors, extra=extra, prior=prior)
    return FullCarSpi(car, FULL_CAR_FILTERS[vehicle.observer.parameter_filter])


def extra_numbers(vehicle: Vehicle, sensors: dict[str, SensorBase]) -> int:
    """How many numbers an SPI of these keeps in the memory of its car."""
    return numbers_kept(layout(sensors).size, len(with_parameters(vehicle).observer.parameters))


def with_parameters(vehicle: Vehicle) -> Vehicle:
    """The vehicle with parameters for an SPI to estimate: those of its file, or where it lists none mass, friction and
    the cornering stiffness of both axles, with the uncertainty that the file states of them, or that of any car."""
    if vehicle.observer.parameters:
        return vehicle
    deviations = {
        "chassis.mass": vehicle.observer.surroundings.load,
        "road.friction": SPI_DEFAULTS.friction,
        "front.cornering_scale": SPI_DEFAULTS.cornering_scale,
        "rear.cornering_scale": SPI_DEFAULTS.cornering_scale,
    }
    deviations |= {name: stated for name, stated in vehicle.deviations().items() if name in deviations}
    values, least_share = vehicle.values(), SPI_DEFAULTS.least_share
    parameters = {
        name: EstimatedParameter(
            deviation=deviation, lower=max(values[name] - 4 * deviation, least_share * values[name])
        )
        for name, deviation in deviations.items()
        if name in values and deviation > 0
    }
    observer = vehicle.observer.model_copy(update={"parameters": parameters})
    return vehicle.model_copy(update={"observer": observer})


_WHOLE = ("coordinates", "velocities", "disturbances", "biases of the sensors")
_WITH_FORCES = (*_WHOLE, "forces beyond the model's")
_INPUTS = ("road-wheel angle", "wheel torques where they are measured")
_SENSORS = ("those of the vehicle file",)

_PARAMETERS = "observer.parameters of the vehicle file; where it has none mass, friction and cornering stiffness"
_REFERENCES = ("dekf", "cekf", "ukf")  # to compare with

FILTERS = Catalogue(
    FilterFamily(name, title, states, _INPUTS, _SENSORS, when, make, name not in _REFERENCES)
    for name, title, states, when, make in (
        (
            "error_ekf",
            "errorEKF with force estimation",
            _WITH_FORCES,
            "nearly always: it is quick, and finds the forces that the model lacks",
            error_ekf,
        ),
        (
            "spi",
            "SPI: state, parameters and inputs",
            (*_WITH_FORCES, _PARAMETERS),
            "where mass, friction or another number of the car is not known well enough",
            spi,
        ),
        ("dekf", "discrete EKF", _WHOLE, "as a reference without forces, with full matrices", dekf),
        (
            "cekf",
            "continuous EKF",
            _WHOLE,
            "as a reference that shows why filters are discrete: it fails where sensors are slow",
            cekf,
        ),
        ("ukf", "UKF", _WHOLE, "as a reference with sigma points, at twenty times the cost", ukf),
        (
            "full_error_ekf",
            "errorEKF on the full car",
            _WITH_FORCES,
            "where the linkages matter, which the vehicle file then describes",
            full_error_ekf,
        ),
        (
            "full_spi",
            "SPI on the full car",
            (*_WITH_FORCES, _PARAMETERS),
            "where the linkages matter and a number of the car is not known well enough",
            full_spi,
        ),
    )
)


def default_filter(vehicle: Vehicle) -> MakeFilter:
    """The SPI where the vehicle file lists parameters, else the errorEKF."""
    return FILTERS["spi" if vehicle.observer.parameters else "error_ekf"].make
