"""A vehicle file from catalogue values, checked and calibrated: `vsense new-vehicle`, `check` and `calibrate`."""

from __future__ import annotations

from pathlib import Path

from vsense_ros.api.recording import Sources, read_all
from vsense_ros.api.vehicle import load_vehicle
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import save_changes, save_vehicle
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare import calibration, vehicle_check
from vsense_ros.prepare import new_vehicle as catalogue_car
from vsense_ros.prepare.calibration import Calibration
from vsense_ros.prepare.catalogue import Driven, catalogue_values
from vsense_ros.prepare.new_vehicle import NewVehicle
from vsense_ros.prepare.rules import CarKind
from vsense_ros.prepare.vehicle_check import VehicleCheck


def new_vehicle(
    mass: float | None,
    wheelbase: float | None,
    track: float | None,
    tyre: str | None,
    *,
    name: str = "My car",
    track_rear: float | None = None,
    tyre_rear: str | None = None,
    axle_load_front: float | None = None,
    driven: Driven = "front",
    steering_ratio: float | None = None,
    height: float | None = None,
    like: CarKind | None = None,
    recordings: Sources = (),
) -> NewVehicle:
    """Make a vehicle from values of a catalogue; rules with a source fill the rest, each with its uncertainty.

        new = vs.new_vehicle(1395, 2.63, 1.54, "205/55R16 91V", axle_load_front=820)
        new.write("my_car.yaml")
        vs.estimate("drive", new.vehicle)

    Args:
        mass: of the car as it is driven, with occupants and fuel [kg].
        wheelbase: distance between the axles [m].
        track: distance between the front wheels [m].
        tyre: size, with or without its load index, as on the side of the tyre.
        name: of the car.
        track_rear: distance between the rear wheels [m]; by default `track`.
        tyre_rear: size of the rear tyres; by default `tyre`.
        axle_load_front: part of the mass on the front wheels [kg].
        driven: the driven wheels, `front`, `rear` or `all`.
        steering_ratio: angle of the steering wheel over that of the road wheels [-].
        height: of the car [m].
        like: `compact`, `saloon`, `suv`, `van` or `formula-student`; by default what the size makes likely.
        recordings: of the car; one with a velocity in the axes of the car adds the sensor for it.

    Raises `InputError` for values that are missing (None) or that no car has.
    """
    values = catalogue_values(
        name=name, mass=mass, wheelbase=wheelbase, track=track, tyre=tyre, track_rear=track_rear, tyre_rear=tyre_rear,
        axle_load_front=axle_load_front, driven=driven, steering_ratio=steering_ratio, height=height, like=like,
    )  # fmt: skip
    (of_car,) = read_all(recordings)
    return catalogue_car.new_vehicle(values, {topic for one in of_car for topic in one.channels})


def check(vehicle: str | Path | Vehicle, recordings: Sources = ()) -> VehicleCheck:
    """Check whether a vehicle is a plausible car, and whether it fits recordings of the car.

        result = vs.check("my_car.yaml", ["drive_1"])
        result.is_good or print(*result.sentences(), sep="\\n")

    Args:
        vehicle: a vehicle, its file, or the name of one that comes with the project.
        recordings: a recording or path, as `read` takes it, or several.

    Raises `InputError` for a file that is missing or no YAML, and as `read` does; a file that describes no car is the
    result `refused`.
    """
    (drives,) = read_all(recordings)
    if isinstance(vehicle, Vehicle):
        return vehicle_check.check_loaded(vehicle, drives)
    return vehicle_check.check_vehicle(vehicle_path(str(vehicle)), drives)


def calibrate(recordings: Sources, vehicle: str | Path | Vehicle) -> Calibration:
    """Calibrate the sensors of a car by ordinary drives with GNSS; references in the recordings are not used.

        calibration = vs.calibrate(["drive_1", "drive_2"], "my_car.yaml")
        [(q.name, q.after, q.deviation) for q in calibration.quantities if q.determined]
        vs.identify(["drive_1", "drive_2"], calibration.vehicle, model="single_track")

    Args:
        recordings: a recording or path, as `read` takes it, or several.
        vehicle: the car as far as it is known; the standard deviations in its file are the priors.

    `vehicle` of the result has what the drives determine; the rest keeps its values, and `advice` says what to drive
    for it. The observer predicts the course in stretches whose GNSS it does not hear, with the file before and after:
    what makes that worse is `refused`, and not in the vehicle.

    Raises `InputError` for drives without a GNSS velocity or a yaw rate, or that are too short.
    """
    (drives,) = read_all(recordings)
    return calibration.calibrate_and_judge(drives, load_vehicle(vehicle))


def write_calibration(result: Calibration, target: str | Path, source: str | Path | None = None) -> None:
    """Write the calibrated vehicle; with the file that it was made from, `source`, all else stays as written there."""
    if source is None:
        save_vehicle(target, result.vehicle)
    else:
        save_changes(source, target, result.vehicle, result.paths)
