"""The errorEKF whose model is the car with all its bodies and linkages, as the one of Rodríguez 2020's full model.

What moves is the full car; how errors move, and what they do to the sensors, is told by the simplified car at the same
14 coordinates, whose Jacobians differ from those of the full one by what the suspension tables leave out. Between
corrections the full car keeps its own coordinates, multipliers and forces; a correction puts it to the nearest state
in which its linkages are closed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.simulation.full_car import FullCarPlant
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.kalman import FORCE, SURROUND, Q, U

Array = NDArray[np.float64]

LONGEST_STEP = 1e-3  # [s] of the full car: at rest its tyres are stiff, and Newton's method fails with a longer one


class FullCarEkf(ErrorEkf):
    """The filter of a vehicle with a `linkage` section.

    Raises `InputError` for a vehicle with errors of the tyre radius or physical effects, which the full car lacks.
    """

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], extra: int = 0) -> None:
        if vehicle.observer.surroundings.radius_error > 0:
            raise InputError(
                f"{vehicle.name}: the full car has no error of the tyre radius; set observer.surroundings.radius_error "
                "and radius_error_drift to 0"
            )
        if vehicle.physics.effects.present():
            raise InputError(f"{vehicle.name}: the full car has no physics.effects; leave them out")
        self.plant = FullCarPlant(vehicle, LONGEST_STEP)
        size, accelerations = self.plant.memory().size, len(self.plant.udot)
        super().__init__(vehicle, sensors, extra=extra + size + accelerations)
        self.extra, self._kept, self._kept_udot = np.split(self.extra, [extra, extra + size])

    def start(self, speed: float) -> None:
        super().start(speed)
        self.plant.force[:] = 0.0
        self.plant.disturbances[:] = 0.0
        self.plant.place(self.state[Q], self.state[U], self.inputs)
        self._keep()

    def linearize(self) -> None:
        super().linearize()
        self.udot[:, 0] = self._kept_udot

    def predict(self, h: float) -> None:
        process, kalman, plant, state = self._process(h), self._kalman, self.plant, self.state
        kalman.transition(h)
        self._kinematics.call()
        self._return()
        try:
            plant.advance(self.inputs, h)
        except InputError as error:
            raise FloatingPointError(str(error)) from None
        kalman.propagate(h, process.decay, process.noise)
        state[Q], state[U] = plant.q, plant.u
        self._relax(state[U.stop :], process)
        self._keep()

    def present(self) -> tuple[Array, Array]:
        try:
            self._return()
        except FloatingPointError:
            return super().present()
        return self.plant.udot.copy(), self.plant.wheels

    def _return(self) -> None:
        """Puts the car where the filter is."""
        plant, state = self.plant, self.state
        plant.force[:], plant.disturbances[:] = state[FORCE], state[SURROUND]
        try:
            plant.recall(self._kept, self.inputs)
            plant.correct(state[Q], state[U])
        except InputError as error:
            raise FloatingPointError(str(error)) from None

    def _keep(self) -> None:
        self._kept[:], self._kept_udot[:] = self.plant.memory(), self.plant.udot
