"""The car with all its bodies and linkages as the model of the errorEKF, as Rodríguez 2020's full model.

What moves is the full car; how errors move, and what they do to the sensors, follows from the simplified car at the
same 14 coordinates, whose Jacobians differ from those of the full one by what the suspension tables leave out. Between
corrections the full car keeps its own coordinates, multipliers and forces; a correction puts it to the nearest state
in which its linkages are closed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.model.multibody.outside import Outside
from vsense_ros.model.schema.observer_settings import Disturbances
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.wheel_speeds import WheelSpeeds
from vsense_ros.model.simulation.full_car import FullCarPlant
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.state import DISTURB, FORCE, Prior, Q, U

Array = NDArray[np.float64]

TOLERANCE = 1e-9  # of the change of the full car's coordinates in the last iteration [m, rad]
LONGEST_STEP = 1e-3  # [s] of the full car: at rest its tyres are stiff, and Newton's method fails with a longer one


class FullCarBlocks(CarBlocks):
    """A vehicle with a `linkage` section.

    `numbers()` gives the full car its numbers, where a filter of parameters changes them; its systems may be solved
    `outside`. The full car has no error of the tyre radius that all wheels have in common: it becomes part of that of
    each wheel, which its sensor has.
    Raises `InputError` for a vehicle without linkages, or with physical effects.
    """

    in_blocks = False

    def __init__(
        self,
        vehicle: Vehicle,
        sensors: dict[str, SensorBase],
        *,
        extra: int = 0,
        prior: Prior | None = None,
        tolerance: float = TOLERANCE,
        outside: Outside | None = None,
    ) -> None:
        if vehicle.linkage is None:
            raise InputError(
                f"{vehicle.name}: the full car is made of the section linkage of the vehicle file, which is missing; "
                "prototype_real has one to look at"
            )
        if vehicle.physics.acting():
            raise InputError(f"{vehicle.name}: the full car has no physics.effects and no trailer; leave them out")
        sensors = with_common_radius_error(sensors, vehicle.observer.surroundings)
        vehicle = without_common_radius_error(vehicle)
        self.plant = FullCarPlant(vehicle, LONGEST_STEP, tolerance=tolerance, outside=outside)
        self.numbers: Callable[[], Array] | None = None
        size, accelerations = self.plant.memory().size, len(self.plant.udot)
        super().__init__(vehicle, sensors, extra=extra + size + accelerations, prior=prior)
        self.extra, self._kept, self._kept_udot = np.split(self.extra, [extra, extra + size])

    def start(self, belief: Gaussian) -> None:
        super().start(belief)
        self.plant.force[:] = 0.0
        self.plant.disturbances[:] = 0.0
        self._take_numbers()
        self.plant.place(self.mean[Q], self.mean[U], self.inputs)
        self._keep()

    def linearize(self) -> None:
        super().linearize()
        self.udot[:, 0] = self._kept_udot

    def step(self, h: float) -> None:
        process, plant = self.process(h), self.plant
        self.respond(h)
        self.kinematics.call()
        self.put_back()
        try:
            plant.advance(self.inputs, h)
        except InputError as error:
            raise FloatingPointError(str(error)) from None
        noise = self.map_road(h, process)
        self.propagate(self.transition(h, process.decay), noise)
        self.share_torques(process.shared)
        self.move(plant.q, plant.u, h, process)
        self._keep()
        self.linearize()

    def present(self) -> tuple[Array, Array]:
        try:
            self.put_back()
        except FloatingPointError:
            return super().present()
        return self.plant.udot.copy(), self.plant.wheels

    def show(self, into: Array) -> None:
        super().show(into)
        udot, wheels = self.present()
        into[: udot.size], into[udot.size : udot.size + wheels.size] = udot, wheels.ravel(order="F")

    def put_back(self) -> None:
        """Puts the full car where the filter is."""
        plant = self.plant
        self._take_numbers()
        plant.force[:], plant.disturbances[:] = self.mean[FORCE], self.mean[DISTURB]
        try:
            plant.recall(self._kept, self.inputs)
            plant.correct(self.mean[Q], self.mean[U])
        except InputError as error:
            raise FloatingPointError(str(error)) from None

    def _take_numbers(self) -> None:
        if self.numbers is not None:
            self.plant.integrator.parameters[:] = self.numbers()

    def _keep(self) -> None:
        self._kept[:], self._kept_udot[:] = self.plant.memory(), self.plant.udot


def with_common_radius_error(sensors: dict[str, SensorBase], around: Disturbances) -> dict[str, SensorBase]:
    """The sensors with errors of each wheel's radius as large as they are together with that of all wheels."""
    widened = dict(sensors)
    for name, sensor in sensors.items():
        if isinstance(sensor, WheelSpeeds) and sensor.radius_error:
            error = float(np.hypot(sensor.radius_error, around.radius_error))
            drift = float(np.hypot(sensor.radius_error_drift or 0.0, around.radius_error_drift))
            widened[name] = sensor.model_copy(update={"radius_error": error, "radius_error_drift": drift})
    return widened


def without_common_radius_error(vehicle: Vehicle) -> Vehicle:
    """The vehicle whose wheels have no error of the radius in common."""
    around = vehicle.observer.surroundings.model_copy(update={"radius_error": 0.0, "radius_error_drift": 0.0})
    observer = vehicle.observer.model_copy(update={"surroundings": around})
    return vehicle.model_copy(update={"observer": observer})
