"""The car with 14 degrees of freedom from recordings: the observer's own filter of parameters.

What the handling models do with an augmented state, the separate-bias filter does with the multibody car (observer/
spi.py): parameters are estimated beside the state. Each recording is gone over once and begins with what those before
it left: a second time over the same drive, what it does not determine would wander far away.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from html import escape
from pathlib import Path

import numpy as np
from rich.console import Console

from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.printable import Printable
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification.information import INFORMATION
from vsense_ros.identification.progress import Progress, part
from vsense_ros.messages.recording import Recording
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.runner import run

# Of its value, how far each may well be off where the vehicle file does not say; what `--free` names besides is taken
# to be known to PRIOR.
FREE = {
    "chassis.mass": 0.1, "chassis.yaw_inertia": 0.15, "front.cornering_scale": 0.25, "rear.cornering_scale": 0.25,
    "road.friction": 0.1,
}  # fmt: skip
PRIOR = 0.2


@dataclass(frozen=True, repr=False)
class CarIdentification(Printable):
    """Vehicles before and after; by parameter its value before and after, its standard deviation, and true if the
    drives determine it; RMSE of the side slip [rad] by recording, before and after, where there is a reference."""

    before: Vehicle
    vehicle: Vehicle
    parameters: Mapping[str, tuple[float, float, float, bool]]
    side_slip: Mapping[str, tuple[float, float]]

    @property
    def title(self) -> str:
        """Name of the vehicle, and how many parameters the drives determine."""
        determined = sum(row[-1] for row in self.parameters.values())
        return f"{self.vehicle.name}, {determined} of {len(self.parameters)} parameters determined"

    def show(self, out: Console) -> None:
        """Print the identified values with their standard deviations, and what could not be determined."""
        table = plain_table("parameter", "before", "estimate", "±", "", right=("before", "estimate", "±"))
        for name, (before, value, deviation, determined) in self.parameters.items():
            table.add_row(
                name, f"{before:.5g}", f"{value:.5g}", f"{deviation:.2g}", "determined" if determined else "refused"
            )
        out.print(table)
        for sentence in sentences(self):
            out.print(sentence)


def identify(
    recordings: Sequence[Recording],
    vehicle: Vehicle,
    *,
    free: Sequence[str] = (),
    held_out: Sequence[Recording] = (),
    progress: Progress | None = None,
) -> CarIdentification:
    """Identify parameters of the observer's own car, one pass of the SPI observer over each drive.

    Raises `InputError` for a name that is no number below physics, one that is zero, or drives that determine nothing.
    """
    free_names = tuple(free) or tuple(FREE)
    values = vehicle.values()
    for name in free_names:
        if name not in values:
            nearest_names = ", ".join(get_close_matches(name, values, 3, 0.0))
            raise InputError(f"--free: the car has no parameter {name!r}; nearest are {nearest_names}")
        if not values[name]:
            raise InputError(f"--free: {name} is zero in the vehicle file; give it a value to start from")
    file_deviations = vehicle.deviations()
    prior = {name: file_deviations.get(name, FREE.get(name, PRIOR) * abs(values[name])) for name in free_names}
    estimates = {name: values[name] for name in free_names}
    deviations = dict(prior)
    for i, recording in enumerate(recordings):
        estimates, deviations = _pass(recording, vehicle, estimates, deviations, part(progress, i, len(recordings) + 1))
    determined = [name for name in free_names if deviations[name] <= INFORMATION.determined_share * prior[name]]
    if not determined:
        raise InputError(
            "the drives determine none of the free parameters: "
            + "; ".join(
                f"of {name}, {100 * deviations[name] / prior[name]:.0f} % of what was uncertain are left"
                for name in free_names
            )
            + ". Brake and accelerate for the mass, drive bends up to the limit for the tyres"
        )
    changed = vehicle.with_parameters({name: estimates[name] for name in determined}).with_deviations(
        {name: deviations[name] for name in determined},
        "identified from " + ", ".join(recording.name for recording in recordings),
    )
    slips = {}
    for recording in (*recordings, *held_out):
        if "reference/odometry" in recording:
            slips[recording.name] = (_side_slip(recording, vehicle), _side_slip(recording, changed))
    if progress is not None:
        progress(1.0)
    rows = {name: (values[name], estimates[name], deviations[name], name in determined) for name in free_names}
    return CarIdentification(vehicle, changed, rows, slips)


def _pass(
    recording: Recording,
    vehicle: Vehicle,
    values: Mapping[str, float],
    deviations: Mapping[str, float],
    progress: Progress | None,
) -> tuple[dict[str, float], dict[str, float]]:
    """Values and deviations at the end of one recording."""
    car = vehicle.with_parameters(dict(values))
    settings = {name: EstimatedParameter(deviation=deviation) for name, deviation in deviations.items()}
    observer = car.observer.model_copy(update={"parameters": settings})
    estimates = run(
        recording, car.model_copy(update={"observer": observer}), rate=1.0, make=FILTERS["spi"].make, progress=progress
    ).parameters
    return {n: estimates[n][0] for n in values}, {n: min(estimates[n][1], deviations[n]) for n in values}


def _side_slip(recording: Recording, vehicle: Vehicle) -> float:
    """RMSE of the observer [rad], without its mean error."""
    output = read_signals(at_reference(run(recording, vehicle, rate=10.0).output, vehicle), "vsense")
    truth = read_signals(recording, "reference")
    if "side_slip" not in output or "side_slip" not in truth:
        return float("nan")
    error = align(output["side_slip"], truth["side_slip"]).error[:, 0]
    return float(np.std(error))


def sentences(result: CarIdentification) -> list[str]:
    """Which parameters the drives do not determine, and how good the observer is before and after."""
    lines = ["Not proven yet: on a generated double lane change it made the observer worse. Compare before you use it."]
    lines += [
        f"{name} is not determined by these drives and stays {before:.5g}."
        for name, (before, _, _, determined) in result.parameters.items() if not determined
    ]  # fmt: skip
    lines += [
        f"{name}: side slip of the observer, RMSE {np.degrees(before):.3f}° before, {np.degrees(after):.3f}° after."
        for name, (before, after) in result.side_slip.items()
    ]
    return lines


def write(result: CarIdentification, folder: Path) -> None:
    """Write identification.json and report.html into a folder."""
    parameters = {
        name: {"before": before, "value": value, "deviation": deviation, "determined": determined}
        for name, (before, value, deviation, determined) in result.parameters.items()
    }
    content = {"model": "car", "vehicle": result.before.name, "parameters": parameters,
            "side_slip_rmse_deg": {n: [float(np.degrees(v)) for v in pair] for n, pair in result.side_slip.items()},
            "sentences": sentences(result)}  # fmt: skip
    with atomic_write(folder / "identification.json") as file:
        file.write(json.dumps(content, indent=2) + "\n")
    cells = "".join(
        f"<tr><td>{escape(name)}</td><td>{before:.5g}</td><td>{value:.5g}</td><td>{deviation:.2g}</td>"
        f"<td>{'determined' if determined else 'refused'}</td></tr>"
        for name, (before, value, deviation, determined) in result.parameters.items()
    )
    text = "".join(f"<li>{escape(line)}</li>" for line in sentences(result))
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Parameters identified</title><style>'
        "body{font:15px/1.5 system-ui,sans-serif;margin:40px auto;max-width:900px}td,th{padding:4px 24px 4px 0;"
        "text-align:left;border-bottom:1px solid #e3e3e0}</style></head><body>"
        f"<h1>{escape(result.before.name)}: parameters identified</h1><table><tr><th>parameter</th><th>before</th>"
        f"<th>estimate</th><th>±</th><th></th></tr>{cells}</table><ul>{text}</ul></body></html>\n"
    )
    (folder / "report.html").write_text(page, encoding="utf-8")
