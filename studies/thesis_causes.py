"""Why the errorEKF leaves its place in the tables of Rodríguez 2020: the same drives with one belief changed at a time.

No sensor measures a velocity across the car, so that its error adds up in the position. It comes from what the observer
believes of mass, friction, and of the errors of its forces. These act at the road and turn the body, too; what is not
so turned has the body's own errors alone (`ForceErrors.roll`, `pitch`), and roll then says the tyres' forces to within
0.15 m/s² while they are allowed to be wrong by 0.5 m/s².
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from studies.thesis import KINDS, STEPS, driven, observe, observing
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.state import FORCE, TURNED, Prior

_ERROR_EKF, _STEP = KINDS[0], STEPS[0]
_WIDTH = 128  # of the table
_TRUE: dict[str, tuple[str, ...]] = {
    "700 kg, friction 1.0": (),
    "true friction": ("road.friction",),
    "true mass": ("chassis.mass",),
    "true mass and friction": ("chassis.mass", "road.friction"),
}


class Drift(NamedTuple):
    """Errors of one drive: RMSE of position [m], roll [°] and lateral force of the rear right tyre [N], and at the end
    the error of the lateral velocity and its stated standard deviation [m/s]."""

    position: float
    lateral_velocity: float
    deviation: float
    roll: float
    force: float


Drifts = Mapping[tuple[str, bool], list[Drift]]  # by what the model has right, and if errors turn the body


def causes(plant: Vehicle, model: Vehicle) -> Drifts:
    """What the errorEKF drifts by in each manoeuvre, with the noise of the first seed."""
    drifts: dict[tuple[str, bool], list[Drift]] = {}
    for manoeuvre in MANOEUVRES:
        car, trajectory = driven(plant, manoeuvre)
        recording = record(trajectory, car, 0, name=manoeuvre.name, biased=False, every=_STEP)
        true = car.values()
        for title, names in _TRUE.items():
            known = model.with_parameters({name: true[name] for name in names})
            for turning in (True, False):
                drifts.setdefault((title, turning), []).append(_drift(recording, known, turning))
    return drifts


def _drift(recording: Recording, model: Vehicle, turning: bool) -> Drift:
    def make(vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        prior = (prior or Prior.of(vehicle, sensors)).placed()
        return FILTERS[_ERROR_EKF.filter].make(vehicle, sensors, prior if turning else _not_turning(prior, vehicle))

    observer, output, _ = observe(recording, observing(model, _ERROR_EKF, _STEP), _ERROR_EKF, _STEP, make)
    estimates, truths = read_signals(output, "vsense"), read_signals(recording, "reference")
    names = ("position", "lateral_velocity", "roll", "wheel_force_rr_y")
    errors = {name: align(estimates[name], truths[name]).error for name in names}
    rmse = {name: float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) for name, error in errors.items()}
    end = observer.snapshot()
    deviation = float(end.side_slip[1] * np.hypot(*end.velocity[:2]))
    across = float(errors["lateral_velocity"][-1, 0])
    return Drift(rmse["position"], across, deviation, float(np.degrees(rmse["roll"])), rmse["wheel_force_rr_y"])


def _not_turning(prior: Prior, vehicle: Vehicle) -> Prior:
    """Prior of an observer whose errors of forces along and across the car do not turn the body."""
    deviation, errors = prior.deviation.copy(), vehicle.observer.force_errors
    deviation[FORCE][TURNED] = errors.roll, errors.pitch
    return replace(prior, deviation=deviation, levers=np.zeros_like(prior.levers))


def show(drifts: Drifts, console: Console) -> None:
    """A row for each model, and whether errors of its forces turn the body; manoeuvres 1 and 2 side by side."""
    quantities = ("position [m]", "v_y, end [m/s]", "stated [m/s]", "roll [°]", "RR force Y [N]")
    table = Table("model", "errors turn the body", *quantities, box=None, pad_edge=False)
    for (title, turning), both in drifts.items():
        cells = (", ".join(f"{value:.2g}" for value in values) for values in zip(*both, strict=True))
        table.add_row(title, "yes" if turning else "no", *cells)
    console.width = max(console.width, _WIDTH)
    console.print(table)
