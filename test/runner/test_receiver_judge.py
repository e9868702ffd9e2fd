"""A GNSS receiver that states a tenth of its noise: said, and estimates no more certain than they are."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.estimation.timeline import Event
from vsense_ros.evaluate.metrics import Aligned, align
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner, run
from vsense_ros.runner.receiver_judge import ReceiverJudge


def on_hills(end: float, sensor: str, noise: float, signal: str, settled: float) -> tuple[Aligned, str]:
    """Errors of a signal once it is settled, up to `end` [s], and what is said, where a sensor states a noise."""
    recording = import_recording(shared_folder("bags") / "hills").between(0.0, end)
    vehicle = load_vehicle(vehicle_path("prototype_model"))
    stated = vehicle.sensors[sensor].model_copy(update={"noise": noise, "noise_from_message": False})
    vehicle = vehicle.model_copy(update={"sensors": {**vehicle.sensors, sensor: stated}})
    done = run(recording, vehicle, rate=50.0)
    estimate, truth = (
        read_signals(one, what)[signal] for one, what in ((done.output, "vsense"), (recording, "reference"))
    )
    found = align(estimate, truth)
    after = found.stamp > recording.start + round(settled * 1e9)
    said = " ".join(line.message for line in done.diagnostics)
    return found.select(after), said


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_positions_are_within_three_deviations_whatever_the_receiver_states(share: float) -> None:
    found, said = on_hills(12.0, "position", 1.35 * share, "position", 2.0)
    assert np.mean(np.abs(found.error) < 3 * found.deviation[:, None]) > 0.97
    assert ("positions are noisier than stated" in said) == (share < 1)


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_speed_is_as_certain_as_published_whatever_the_receiver_states_of_its_velocities(share: float) -> None:
    found, said = on_hills(16.0, "velocity", 0.025 * share, "longitudinal_velocity", 8.0)
    assert np.mean((found.error / found.deviation[:, None]) ** 2) < 2
    assert ("noise of GNSS velocity to the north" in said) == (share < 1)


@pytest.mark.parametrize(
    ("period", "noise", "said"), [(0.1, 0.03, False), (0.1, 0.3, True), (0.2, 0.03, False), (1.0, 0.03, False)]
)
def test_a_car_in_a_slalom_is_not_taken_for_noise(vehicle: Vehicle, period: float, noise: float, said: bool) -> None:
    stated = 0.03
    judge = ReceiverJudge(Runner(vehicle).adapter)
    place = list(vehicle.sensors).index("velocity")
    times = period * np.arange(200)
    course = 0.06 * np.sin(2 * np.pi * 0.4 * times)  # at 20 m/s a lateral acceleration of 3 m/s²
    velocities = 20 * np.column_stack([np.cos(course), np.sin(course)])
    velocities += noise * np.random.default_rng(3).standard_normal(velocities.shape)
    for time, velocity in zip(times, velocities, strict=True):
        event = Event(place, round(time * 1e9), velocity, np.full(2, stated**2))
        judge.hear(event)
    assert bool(judge.doubt(place)) == said
    assert np.sqrt(event.variance) == pytest.approx(noise if said else stated, rel=0.3)
