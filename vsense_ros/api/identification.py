"""Parameters of a car from its recordings: what the command `vsense identify` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from vsense_ros.api.recording import Sources, read_all
from vsense_ros.api.vehicle import load_vehicle
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.identification import identification, identification_report
from vsense_ros.identification.identified import Identification
from vsense_ros.model.vehicle import Vehicle


def identify(
    recordings: Sources,
    vehicle: str | Path | Vehicle,
    *,
    model: Literal["best", "single_track"] = "best",
    free: Sequence[str] = (),
    hold_out: Sources = (),
    progress: Callable[[float], None] | None = None,
) -> Identification:
    """Identify the parameters of a car from recordings: distribution of mass, roll, tyres.

        identification = vs.identify(["drive_1", "drive_2"], "my_car.yaml", hold_out=["drive_3"])
        vs.estimate("drive_3", identification.vehicle)

    Args:
        recordings: a recording or path, as `read` takes it, or several.
        vehicle: the car as far as it is known; its values are taken to be known to about 30 %.
        model: `best` has 4 degrees of freedom and wheel speeds, for `single_track` a speed is enough.
        free: names of the parameters to be identified; by default all.
        hold_out: one or several, on which the result is proven.
        progress: is called with the share done, 0 to 1.

    `vehicle` of the answer has the identified values; those that the recordings cannot determine keep theirs and are
    listed. Raises `InputError` where the recordings cannot determine anything, or a free parameter is not one of the
    model.
    """
    car = load_vehicle(vehicle)
    drives, proof = read_all(recordings, hold_out)
    return identification.identify(drives, car, model, free=free, held_out=proof, progress=progress)


def write_identification(result: Identification, folder: Path) -> None:
    """Write vehicle.yaml, report.html and identification.json into a folder that exists."""
    save_vehicle(folder / "vehicle.yaml", result.vehicle)
    identification_report.write(result, folder)
