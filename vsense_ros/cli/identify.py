"""Identify the parameters of a car from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from vsense_ros.cli.common import EXISTING, NEW_FOLDER, HoldsOut, load_car, vehicle_option


def _names(_: click.Context, __: click.Parameter, values: tuple[str, ...]) -> tuple[str, ...]:
    """Names that are separated by commas, or given one by one."""
    return tuple(name for value in values for name in value.replace(",", " ").split())


@click.command(cls=HoldsOut)
@click.argument("recordings", nargs=-1, required=True, type=EXISTING)
@vehicle_option
@click.option(
    "--model", type=click.Choice(["best", "single_track"]), default="best", show_default=True,
    help="best: 4 degrees of freedom, with wheel speeds; single_track: with a speed.",
)  # fmt: skip
@click.option("--free", multiple=True, callback=_names, metavar="NAMES", help="Parameters to identify; default: all.")
@click.option(
    "--hold-out",
    "held_out",
    metavar="RECORDING…",
    multiple=True,
    type=EXISTING,
    help="Recordings for validation; not used for fitting.",
)
@click.option(
    "--report", type=NEW_FOLDER, default=Path("out/identify"), show_default=True, help="Folder for the results."
)
def identify(
    recordings: tuple[Path, ...],
    vehicle: str,
    model: Literal["best", "single_track"],
    free: tuple[str, ...],
    held_out: tuple[Path, ...],
    report: Path,
) -> None:
    """Identify mass distribution, roll and tyres of a car.

    \b
    Examples:
      vsense identify drive_1 drive_2 --hold-out drive_3 --vehicle my_car.yaml
      vsense identify lap.mat --vehicle genesis_start --model single_track --free front_peak,rear_peak

    The values of the vehicle file are taken to be known to about 30 %. Parameters that the drives cannot determine keep
    their values and are listed by name, with the driving that would determine them. If the observer predicts the course
    worse with the new values while it does not hear GNSS, the file keeps its own. Writes into --report: vehicle.yaml,
    which every other command takes as --vehicle, report.html and identification.json.
    """
    from vsense_ros.api.identification import identify as identified
    from vsense_ros.api.identification import write_identification
    from vsense_ros.api.recording import read_all
    from vsense_ros.evaluate.terminal import console, progress, say

    car = load_car(vehicle)
    drives, proof = read_all(recordings, held_out)
    report.mkdir(parents=True, exist_ok=True)
    with progress("identifying") as done:
        identification = identified(drives, car, model=model, free=free, hold_out=proof, progress=done)
    write_identification(identification, report)
    identification.show(console())
    say(f"Written to {report}: vehicle.yaml, report.html, identification.json.")


COMMANDS = (identify,)
