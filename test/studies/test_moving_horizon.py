"""The moving-horizon estimator beside Gauss-Newton over the same samples by another way."""

from __future__ import annotations

import numpy as np

from studies import best_twin, moving_horizon
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.iterated import IterationSettings, iterated
from vsense_ros.estimation.record import Record
from vsense_ros.model.handling.best_4dof import PAPER

SAMPLES = 6


def test_a_horizon_as_long_as_the_drive_gives_what_smoothing_all_of_it_gives() -> None:
    twin = best_twin.drive(best_twin.rich_driver(0), SAMPLES * moving_horizon.H)
    outputs = np.hstack([twin.clean, twin.states[:, 2:3]])
    outputs += np.random.default_rng(1).standard_normal(outputs.shape) * moving_horizon.OUTPUT_NOISE
    start = twin.states[0].copy()
    start[0] += 0.5
    prior = Gaussian(start, np.diag(np.square(moving_horizon.START)))
    system, parameters = moving_horizon._system(), moving_horizon._parameters(PAPER)
    horizon = moving_horizon.MovingHorizon(system, parameters, SAMPLES, iterations=8)
    found = [horizon.go_on(prior, u, z).copy() for u, z in zip(twin.inputs, outputs, strict=True)][-1]

    numbers = dict(zip(system.parameters, parameters.tolist(), strict=True))
    sensor = system.measurement(moving_horizon.OUTPUT_NOISE, moving_horizon.SENSOR)
    record = Record(Ekf(Dense(system, [sensor], numbers)))
    record.inputs[:] = twin.inputs[0]
    record.start(prior)
    for k, (u, z) in enumerate(zip(twin.inputs, outputs, strict=True)):
        if k:
            record.predict(moving_horizon.H)
        record.inputs[:] = u
        record.correct(moving_horizon.SENSOR, z, np.square(moving_horizon.OUTPUT_NOISE))
    belief = iterated(record, IterationSettings(most=20, change=1e-9)).beliefs[-1]
    assert np.max(np.abs(found - belief.mean) / np.sqrt(belief.covariance.diagonal())) < 1e-4


def test_costs_more_than_the_filter_and_is_hardly_more_accurate() -> None:
    rows = moving_horizon.compare(moving_horizon.Study(horizons=((5, 1),), seconds=1.0))
    filter, horizon = (next(r for r in rows if r.estimator.startswith(name)) for name in ("EKF", "moving"))
    assert horizon.microseconds > 3 * filter.microseconds
    assert 0.8 * filter.side_slip < horizon.side_slip < 1.2 * filter.side_slip
