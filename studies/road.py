"""Roads that are not flat: do the estimated forces and attitudes hold on them?

The RAV4's drive has no measured tyre forces, so these are held against Newton's law and the inertial sensor
(`model.car.balance`), attitudes against the pose of the recording. On the hills and banks of the generated drives the
car with all its bodies and linkages is the plant; its forces and attitude are the truth.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.table import Table
from rich.text import Text
from scipy.spatial.transform import Rotation

from studies import genesis
from studies.coverage import Compared
from vsense_ros.bag import datasets
from vsense_ros.bag.importers import import_recording
from vsense_ros.evaluate.balance import Balance
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.progress import Progress, part
from vsense_ros.manoeuvre import MANOEUVRES, drive
from vsense_ros.manoeuvre.base import Manoeuvre
from vsense_ros.manoeuvre.hills import weaving
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car.balance import CarBalance
from vsense_ros.model.coordinates import (
    BANK,
    FORCE_X,
    FORCE_Y,
    FORCE_Z,
    GRADE,
    SPEED_X,
    YAW_RATE,
)
from vsense_ros.model.sensors import GnssPosition, GnssVelocity
from vsense_ros.model.sensors.gnss_height import GnssHeight
from vsense_ros.model.sensors.gnss_vertical_velocity import GnssVerticalVelocity
from vsense_ros.model.simulation.surface import Waves
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.estimate import Estimate, stacked
from vsense_ros.observer.state import DISTURB, U
from vsense_ros.runner import Runner
from vsense_ros.runner.run import as_recording

Array = NDArray[np.float64]

RATE = 100.0  # [Hz] of the estimates that are compared
SETTLED = 2.0  # [s] from the start of a recording on
LOOKED_AT = (20.0, 30.0)  # [s] of the RAV4's drive, where the road bends upwards
OUTAGE = (20.0, 40.0)  # [s] of the generated drives, without GNSS
DURATION = 50.0  # [s]


def _over(speed: float, *waves: tuple[float, float, float]) -> Manoeuvre:
    """Weaving at a speed [m/s] over waves of an amplitude [m], a direction [rad] and a length [m]; the car sets out
    along x."""
    source = "waves of the surface"
    driver, surface = partial(weaving, speed), partial(Waves, waves)
    return Manoeuvre("waves", "Weaving over waves", source, DURATION, speed, driver, surface=surface)


PLANTS: Mapping[str, Manoeuvre] = {
    "hills at 10 m/s": _over(10.0, (0.8, 0.0, 80.0)),
    "hills at 20 m/s": _over(20.0, (2.5, 0.0, 250.0)),
    "crests at 30 m/s": _over(30.0, (4.0, 0.0, 500.0), (0.4, 0.0, 160.0)),
    "banks at 20 m/s": _over(20.0, (0.6, 1.25, 60.0)),
    "banked oval, crowned": MANOEUVRES["banked_oval"],
    "hill of Leung 2010": MANOEUVRES["hill"],
}


FIGURES: Mapping[str, str] = {
    "sum_fz_percent": "sum of vertical forces against mass x specific force, of the weight [%]",
    "front_load_percent": "front axle load against the balance of moments, of itself [%]",
    "pitch_rmse_deg": "pitch against the recorded pose, without the constant [deg]",
    "roll_rmse_deg": "roll, likewise [deg]",
    "friction_20_30": "largest friction in use between 20 and 30 s [-]",
    "speed_rmse": "speed [m/s]",
    "yaw_rate_rmse_deg": "yaw rate [deg/s]",
    "fz_nrmsd_percent": "vertical force of the worst wheel, of its range [%]",
    "grade_deg": "grade [deg]",
    "bank_deg": "bank [deg]",
    "attitude_deg": "roll or pitch on the map, the worse [deg]",
    "side_slip_deg": "side slip, the reference where the two other laps put it [deg]",
    "side_slip_without_constant_deg": "side slip, the mounting of the reference fitted [deg]",
    "outage_deg": "side slip in 10 s without GNSS, the reference where the two other laps put it [deg]",
    "outage_without_constant_deg": "the same, the mounting of the reference fitted [deg]",
}


@dataclass(frozen=True)
class Estimates:
    """Estimates of one recording at `RATE`."""

    t: Array  # (n,) [s] after the first
    stamp: NDArray[np.int64]  # (n,) [ns]
    found: Estimate  # stacked
    output: Recording  # the same as the messages that are published

    @property
    def loads(self) -> Array:
        """Vertical forces of the tyres, (n, 4) [N]."""
        return self.found.wheels[:, FORCE_Z]


def estimate(recording: Recording, vehicle: Vehicle, progress: Progress | None = None) -> Estimates:
    """The observer's estimates of a recording."""
    observer = Runner(vehicle, recording.map_origin)
    topics = tuple(topic for topic in observer.topics if topic in recording)
    total, last = sum(len(recording[topic]) for topic in topics), 0
    estimates: list[Estimate] = []
    for i, sample in enumerate(recording.samples(topics)):
        observer.add(sample)
        if observer.started and observer.stamp >= last + int(0.999e9 / RATE):
            estimates.append(observer.snapshot())
            last = observer.stamp
        if progress is not None and i % 500 == 0:
            progress(i / total)
    stamp = np.array([one.stamp for one in estimates])
    output = as_recording(observer.adapter, estimates, recording)
    return Estimates((stamp - stamp[0]) * 1e-9, stamp, stacked(estimates), output)


class Examined(NamedTuple):
    """Figures of a drive by the keys of `FIGURES`, and its signals against the reference."""

    figures: Mapping[str, float]
    compared: Compared


def rav4(progress: Progress | None = None) -> Examined:
    """The RAV4's drive. Raises `InputError` where the recording is not here."""
    recording, vehicle = import_recording(datasets.fetch("comma2k19_rav4")), load_vehicle(vehicle_path("rav4"))
    made = estimate(recording, vehicle, progress)
    sums = Balance(made.stamp, CarBalance(vehicle.physics).shares(made.found.unbalanced)).percent
    reference = recording["reference/odometry"]
    compared = reference.stamp > made.stamp[0] + SETTLED * 1e9
    own = Rotation.from_quat(made.found.orientation).as_euler("ZYX")
    true = Rotation.from_quat(reference.columns["orientation"]).as_euler("ZYX")[compared]
    error = np.column_stack([np.interp(reference.stamp[compared], made.stamp, own[:, i]) - true[:, i] for i in (1, 2)])
    u = made.found.state[:, U]
    speed, yaw_rate = (
        np.interp(reference.stamp[compared], made.stamp, u[:, i]) - reference.columns[name][compared, axis]
        for i, name, axis in ((SPEED_X, "linear", 0), (YAW_RATE, "angular", 2))
    )
    force_x, force_y, load = (made.found.wheels[:, i] for i in (FORCE_X, FORCE_Y, FORCE_Z))
    used = np.hypot(force_x, force_y) / np.maximum(load, 50.0)
    within = (made.t > LOOKED_AT[0]) & (made.t < LOOKED_AT[1])
    figures = {
        "sum_fz_percent": sums["vertical force"],
        "front_load_percent": sums["front load"],
        "pitch_rmse_deg": float(np.degrees(error[:, 0].std())),
        "roll_rmse_deg": float(np.degrees(error[:, 1].std())),
        "friction_20_30": float(used[within].max()),
        "speed_rmse": float(np.sqrt(np.mean(speed**2))),
        "yaw_rate_rmse_deg": float(np.degrees(np.sqrt(np.mean(yaw_rate**2)))),
    }
    output = at_reference(made.output, vehicle)
    return Examined(figures, Compared.of(output, recording, (SETTLED, np.inf)))


def with_height(vehicle: Vehicle) -> Vehicle:
    """The vehicle with the height and the vertical velocity of its GNSS receiver; in a simulation all of the height's
    error is new each time."""
    position = next(sensor for sensor in vehicle.sensors.values() if isinstance(sensor, GnssPosition))
    velocity = next(sensor for sensor in vehicle.sensors.values() if isinstance(sensor, GnssVelocity))
    height = GnssHeight(position=position.position, noise=2 * position.noise, topic=position.topic)
    vertical = GnssVerticalVelocity(position=velocity.position, noise=2 * velocity.noise, topic=velocity.topic)
    return vehicle.model_copy(update={"sensors": {**vehicle.sensors, "height": height, "vertical_velocity": vertical}})


def on_plant(name: str, driven: Vehicle, known: Vehicle, progress: Progress | None = None) -> Examined:
    """The observer with the vehicle `known` on a drive of the full car `driven`, with an outage of GNSS."""
    truth = drive(PLANTS[name], driven)
    recording = record(truth, driven, seed=1, name=name)
    silent = {}
    for topic, channel in recording.channels.items():
        there = (channel.seconds < OUTAGE[0]) | (channel.seconds > OUTAGE[1])
        silent[topic] = channel.select(there) if topic.startswith("gps/") else channel
    made = estimate(Recording(silent, name, metadata=recording.metadata), with_height(known), progress)
    settled = made.t > SETTLED
    rows = np.searchsorted(truth.t, made.t[settled] + (made.stamp[0] - recording.start) * 1e-9).clip(
        0, len(truth.t) - 1
    )
    forces = truth.wheels[rows, FORCE_Z]
    slopes = made.found.state[settled][:, DISTURB]
    assert truth.disturbances is not None
    road = truth.disturbances[rows]
    reference = recording["reference/odometry"]
    turned = Rotation.from_quat(made.found.orientation[settled]).as_euler("ZYX")
    true = Rotation.from_quat(reference.columns["orientation"]).as_euler("ZYX")
    off = [turned[:, i] - np.interp(made.stamp[settled], reference.stamp, true[:, i]) for i in (1, 2)]
    error = np.sqrt(np.mean((made.loads[settled] - forces) ** 2, axis=0)) / np.ptp(forces, axis=0)
    figures = {
        "fz_nrmsd_percent": float(100 * error.max()),
        "grade_deg": _rms_deg(slopes[:, GRADE] - road[:, GRADE]),
        "bank_deg": _rms_deg(slopes[:, BANK] - road[:, BANK]),
        "attitude_deg": max(map(_rms_deg, off)),
    }
    return Examined(figures, Compared.of(made.output, recording, (SETTLED, np.inf)))


def _rms_deg(error: Array) -> float:
    return float(np.degrees(np.sqrt(np.mean(error**2))))


def on_plants(progress: Progress | None = None) -> dict[str, Examined]:
    """Figures on all of the `PLANTS`, of an observer that has the numbers of the plant's vehicle file."""
    car = load_vehicle(vehicle_path("prototype_real"))
    return {name: on_plant(name, car, car, part(progress, i, len(PLANTS))) for i, name in enumerate(PLANTS)}


def on_genesis(extended: Path, progress: Progress | None = None) -> dict[str, dict[str, float]]:
    """Figures of the Genesis's third lap, with the car of typical values, and `extended` by what `vsense explain` found
    on the two other laps. Raises `InputError` where the recordings or the file are not here."""
    folder = datasets.fetch("genesis_oxts_can")
    folder = folder if folder.is_dir() else folder.parent
    stated = load_vehicle(vehicle_path("genesis_identified")).reference
    cars = {"typical": load_vehicle(vehicle_path("genesis_start")), "extended": load_vehicle(extended)}
    return {
        name: genesis.side_slip(folder, car, stated, part(progress, i, len(cars)))
        for i, (name, car) in enumerate(cars.items())
    }


@dataclass(frozen=True)
class Results:
    """What was examined; a recording that is not here is None."""

    plants: Mapping[str, Examined]
    rav4: Examined | None = None
    genesis: Mapping[str, Mapping[str, float]] | None = None

    def drives(self) -> dict[str, Examined]:
        """All drives but those of the Genesis, by their names for people."""
        recorded = {} if self.rav4 is None else {"RAV4": self.rav4}
        return {**recorded, **self.plants}

    def figures(self) -> dict[str, Any]:
        """The results as numbers, ready for JSON."""
        found: dict[str, Any] = {} if self.rav4 is None else {"rav4": dict(self.rav4.figures)}
        if self.genesis is not None:
            found["genesis"] = self.genesis
        found["plants"] = {name: dict(one.figures) for name, one in self.plants.items()}
        return found | {"coverage": {name: one.compared.figures() for name, one in self.drives().items()}}


def table(results: Results) -> Table:
    """Table of the figures for the terminal."""
    lines = Table(box=box.SIMPLE_HEAD)
    lines.add_column("drive")
    lines.add_column("figure")
    lines.add_column("value", justify="right")
    for title, one in results.drives().items():
        for i, (name, value) in enumerate(one.figures.items()):
            lines.add_row(title if i == 0 else "", Text(FIGURES[name]), f"{value:.3g}")
    return lines


def write(results: Results, path: Path) -> None:
    """Write the results as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results.figures(), indent=2) + "\n", encoding="utf-8")
