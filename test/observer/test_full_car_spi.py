"""State, parameters and input together on the car with all its bodies: what parameters do is asked of other full cars,
so the oracle is a full car that was made with them."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints
from numpy.typing import NDArray

from drives import feed, goes_on_as_it_did, messages
from test_full_car_ekf import on_known_tyres
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording
from vsense_ros.model.simulation.full_car import FullCarPlant
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.full_car import LONGEST_STEP
from vsense_ros.observer.full_car_spi import FullCarNumbers, FullCarSpi
from vsense_ros.observer.parameter_ukf import KAPPA
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.runner import Runner

pytestmark = pytest.mark.exam

Array = NDArray[np.float64]
MASS, FRICTION, BALANCE = "chassis.mass", "road.friction", "chassis.cog_to_front_axle"
BOTH: dict[str, dict[str, float]] = {MASS: {"deviation": 100.0}, FRICTION: {"deviation": 0.2, "lower": 0.1}}


def estimating(vehicle: Vehicle, parameters: dict[str, dict[str, float]], kind: str = "ekf") -> Vehicle:
    raw = on_known_tyres(vehicle).model_dump()
    raw["observer"] |= {"parameters": parameters, "parameter_filter": kind}
    return Vehicle.model_validate(raw)


def spi_of(vehicle: Vehicle, kind: str = "ekf", parameters: dict[str, dict[str, float]] = BOTH) -> FullCarSpi:
    declared = estimating(vehicle, parameters, kind)
    made = FILTERS["full_spi"].make(declared, sensors_of(declared))
    assert isinstance(made, FullCarSpi)
    return made


def cornering(spi: FullCarSpi) -> FullCarSpi:
    """A filter amid a turn, linearised there."""
    spi.start_rolling(15.0)
    for _ in range(100):
        spi.inputs[:] = 0.06, 0.0, 0.0, 150.0, 150.0, 0.0
        spi.predict(0.004)
    return spi


def accelerations(spi: FullCarSpi, changes: dict[str, float], state: Array) -> Array:
    """Accelerations of a full car that was made with other parameters, in a state of the filter."""
    plant = FullCarPlant(spi.car.vehicle.with_parameters(changes), LONGEST_STEP, spi.car.plant.car, spi.car.plant.rack)
    plant.force[:] = spi.car.mean[28:42]
    plant.place(state[:14], state[14:28], spi.inputs)
    return plant.udot.copy()


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_effect_of_parameters_is_the_difference_between_full_cars_made_with_them(
    vehicle: Vehicle, kind: str
) -> None:
    values = {name: vehicle.values()[name] for name in (MASS, FRICTION, BALANCE, "rear.suspension_stiffness")}
    spi = cornering(spi_of(vehicle, kind, {name: {"deviation": 1e-3 * value} for name, value in values.items()}))
    spi.sensitivity[:] = 0.0
    spi.linearize()
    for i, (name, value) in enumerate(values.items()):
        step = 1e-3 * value
        above, below = (accelerations(spi, {name: value + s * step}, spi.car.mean) for s in (1, -1))
        expected = (above - below) / (2 * step)
        found = spi._effect.results[0][:, i]
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize(("name", "step"), [(MASS, 1.0), (FRICTION, 1e-3)])
def test_the_sensitivity_of_the_state_is_what_another_parameter_makes_of_it(
    vehicle: Vehicle, name: str, step: float, kind: str
) -> None:
    """Two filters, one of which measures what it expects: so nothing but the parameter makes a difference. How errors
    move is told by the simplified car, so they differ by some percent."""
    value = vehicle.values()[name]
    parameters = {name: {"deviation": 1e-3 * value}}
    one, other = (spi_of(car, kind, parameters) for car in (vehicle, vehicle.with_parameters({name: value + step})))
    for spi in (one, other):
        spi.start_rolling(15.0)
        spi.linearize()
    for _ in range(40):
        for spi in (one, other):
            spi.inputs[:] = 0.06, 0.0, 0.0, 150.0, 150.0, 0.0
            spi.predict(0.004)
    difference = (other.car.mean - one.car.mean)[14:20] / step
    np.testing.assert_allclose(one.sensitivity[14:20, 0], difference, atol=0.1 * np.abs(difference).max())


def test_the_cars_of_the_ukf_are_at_the_sigma_points_of_julier(vehicle: Vehicle) -> None:
    spi = cornering(spi_of(vehicle, "ukf"))
    points = JulierSigmaPoints(2, kappa=KAPPA).sigma_points(spi.values, spi.parameter_covariance)
    moved = spi.car.mean + (points - spi.values) @ spi.sensitivity.T
    for theta, state in zip(points, moved, strict=True):
        expected = accelerations(spi, dict(zip(BOTH, theta, strict=True)), state)
        distances = np.abs(spi._others - expected[:, None]).max(axis=0)
        assert distances.min() < 0.01 * np.abs(expected).max()


def test_the_polynomial_of_a_cars_numbers_holds_beyond_the_cars_it_was_laid_through(vehicle: Vehicle) -> None:
    declared = estimating(vehicle, BOTH | {BALANCE: {"deviation": 0.05}})
    plant = FullCarPlant(declared, LONGEST_STEP)
    car, q, u = plant.car, np.zeros(14), np.zeros(14)
    q[2:5], q[6:10] = (0.42, 0.02, -0.01), (0.01, -0.01, 0.005, -0.005)
    u[:6], u[10:] = (15.0, -0.3, 0.0, 0.1, 0.0, 0.4), 56.0
    plant.place(q, u, np.array([0.06, 0.0, 0.0, 150.0, 150.0]))

    def accelerations_with(numbers: Array) -> Array:
        plant.integrator.parameters[:] = numbers
        plant.settle()
        return plant.udot.copy()

    numbers, start = FullCarNumbers(car, declared), accelerations_with(car.parameters(declared))
    for changes in ({MASS: 600.0, FRICTION: 0.8, BALANCE: 1.2}, {MASS: 560.0, FRICTION: 1.3, BALANCE: 1.24}):
        exact = accelerations_with(car.parameters(declared.with_parameters(changes)))
        found = accelerations_with(numbers.at(np.array(list(changes.values()))))
        assert np.abs(found - exact).max() < 0.01 * np.abs(start - exact).max()


def test_a_file_value_at_its_bound_leaves_no_car_beyond_it(vehicle: Vehicle) -> None:
    declared = estimating(vehicle, {FRICTION: {"deviation": 0.2, "lower": 0.5, "upper": 1.0}})
    car = FullCarPlant(declared, LONGEST_STEP).car
    exact = car.parameters(declared.with_parameters({FRICTION: 0.7}))
    np.testing.assert_allclose(FullCarNumbers(car, declared).at(np.array([0.7])), exact, rtol=1e-9, atol=1e-9)


def test_without_uncertain_parameters_it_is_the_errorekf(vehicle: Vehicle) -> None:
    spi = spi_of(vehicle, "ekf", {MASS: {"deviation": 1e-6}})
    alone = FILTERS["full_error_ekf"].make(spi.car.vehicle, sensors_of(spi.car.vehicle))
    for f in (spi, alone):
        f.start_rolling(10.0)
        f.linearize()
        for i in range(30):
            f.inputs[:] = 0.002 * i, 0.0, 0.0, 100.0, 100.0, 0.0
            f.predict(0.004)
            f.correct("imu", np.array([0.0, 0.0, 0.1, 0.3, 1.0, 9.8]), np.full(6, 1e-2), np.inf)
    np.testing.assert_allclose(spi.car.mean, alone.car.mean, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_filter_that_is_put_back_goes_on_as_it_did(vehicle: Vehicle, kind: str) -> None:
    goes_on_as_it_did(cornering(spi_of(vehicle, kind)), steps=5)


def test_it_follows_a_drive_with_measurements_that_come_late_and_learns(
    vehicle: Vehicle, plant: Vehicle, lane_change: Recording
) -> None:
    observer = Runner(estimating(vehicle, BOTH), lane_change.map_origin, FILTERS["full_spi"].make)
    feed(observer, messages(lane_change, until=5.0))
    value, deviation = observer.parameters()[FRICTION]
    assert deviation < 0.5 * BOTH[FRICTION]["deviation"]
    assert abs(value - plant.values()[FRICTION]) < 4 * deviation
    assert observer.diagnostics()[0].values["faults"] == "0"
    assert MASS in next(d for d in observer.diagnostics() if d.name == "parameters").values


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_parameter_without_effect_on_anything_that_is_measured_is_refused(vehicle: Vehicle, kind: str) -> None:
    with pytest.raises(InputError, match=r"steering\.ratio cannot be estimated: it changes nothing"):
        spi_of(vehicle, kind, {"steering.ratio": {"deviation": 1.0}})
