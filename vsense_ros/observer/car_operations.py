"""What C does on the memory of `CarBlocks`, as `Ekf` calls it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Given, Measured, Step
from vsense_ros.observer.car_algebra import CarAlgebra, compiled_algebra
from vsense_ros.observer.compiled_step import CompiledStep, Process, Replayed

if TYPE_CHECKING:
    from vsense_ros.observer.car_blocks import CarBlocks

Array = NDArray[np.float64]

__all__ = ["CarOperations", "Process"]


class CarOperations:
    """`Operations` of a car whose functions are compiled."""

    def __init__(self, car: CarBlocks, algebra: CarAlgebra, compiled: CompiledStep) -> None:
        self._car, self.algebra, self.compiled = car, algebra, compiled
        self.whitened, self.factor = algebra.whitened, algebra.factor
        self._places = {name: sensed.index for name, sensed in car.sensed.items()}

    @classmethod
    def of(cls, car: CarBlocks) -> CarOperations | None:
        """None where there is no compiler."""
        algebra = compiled_algebra(_Bound(car))
        if algebra is None:
            return None
        coordinates, velocities = (r.reshape(-1, order="F") for r in car.advanced.results)
        remembered = np.zeros(0) if car.remembered is None else car.remembered.results[0].reshape(-1, order="F")
        sensed = {known.index: known for known in car.sensed.values()}
        compiled = CompiledStep.of(
            algebra,
            {
                "linearize": car.linearized,
                "kinematics": car.kinematics,
                "advance": car.advanced,
                "force": car.forces,
                "remember": car.remembered,
            },
            {
                "memory": car.memory,
                "state": car.mean,
                "inputs": car.inputs,
                "largest": car.largest,
                "effects": car.effects,
                "reversion_mean": car.reversion_mean,
                "length": car.h,
                "remembered": remembered,
                "coordinates": coordinates,
                "velocities": velocities,
                "added": car.forces.results[0].reshape(-1, order="F"),
            },
            [
                (sensed[i].kernel, sensed[i].uses_acceleration, sensed[i].biases)
                if i in sensed
                else (None, False, slice(0, 0))
                for i in range(len(car.sensors))
            ],
        )
        return None if compiled is None else cls(car, algebra, compiled)

    def predict(self, h: float) -> None:
        self.compiled.step(h, self._car.process(h))

    def correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        return self.compiled.correct(self._places[sensor], value, variance, limit, scale)

    def advance(self, step: Step) -> bool:
        return self.compiled.move(step.kept, step.steps, step.h, self._car.process(step.h))

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        plan, processes = [], []
        for step, event in events:
            way = (0, 0, 0.0) if step is None else (step.kept.address, step.steps, step.h)
            processes.append(None if step is None else self._car.process(step.h))
            if isinstance(event, Measured):
                plan.append(Replayed(self._places[event.sensor], None, event.value, event.variance, event.limit, *way))
            else:
                plan.append(Replayed(0, event.first, event.value, event.value, np.inf, *way))
        done, moved, nis = self.compiled.replay(plan, processes)
        return done, moved, nis.tolist()


class _Bound:
    """The arrays of a car that the algebra works on."""

    def __init__(self, car: CarBlocks) -> None:
        self.udot, self.by_q, self.by_u = car.udot, car.by_q, car.by_u
        self.by_disturbances, self.by_q_rates = car.by_disturbances, car.by_q_rates
        self.by_angles, self.by_velocity = car.kinematics.results
        self.covariance, self.inverse, self.gain, self.error = car.covariance, car.inverse, car.gain, car.error
