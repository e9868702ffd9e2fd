"""Write an observer for machines that have no Python."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, Commands, load_car, warn


@click.group(cls=Commands)
def export() -> None:
    """Write an observer for machines that have no Python.

    \b
    Examples:
      vsense export c prototype_model --output out/c --check bags/double_lane_change
    """


@export.command("c")
@click.argument("vehicle")
@click.option(
    "--output", required=True, type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Folder."
)
@click.option(
    "--sensor", "sensors", multiple=True, metavar="NAME", help="Only these of the vehicle file; default: all."
)
@click.option(
    "--filter",
    "chosen",
    metavar="NAME",
    help="error_ekf, spi, or a GNSS/INS filter of one state space; default: as VEHICLE says.",
)
@click.option("--check", metavar="BAG", type=EXISTING, help="Compile, and compare with the Python observer on BAG.")
def export_c(vehicle: str, output: Path, sensors: tuple[str, ...], chosen: str | None, check: Path | None) -> None:
    """Write the observer of VEHICLE and its sensors as C99: no allocation, no library but libm, one struct.

    The errorEKF, or the SPI where VEHICLE lists parameters that are to be estimated.

    With --check both observers get the same calls on a recording; the largest difference is printed, and size and time
    of a step go into the README of the sources.

    \b
    Examples:
      vsense export c prototype_model --output out/c
      vsense export c rav4 --output out/rav4 --check segment/
      vsense export c rav4 --output out/small --sensor imu --sensor wheel_speeds --sensor steering
    """
    from vsense_ros.evaluate.terminal import console, progress, say, waiting
    from vsense_ros.export import c
    from vsense_ros.model.vehicle import left_out_of_observer
    from vsense_ros.navigation.catalogue import FILTERS as OF_NAVIGATION

    car = load_car(vehicle)
    if chosen in OF_NAVIGATION.names:
        if sensors or check is not None:
            raise click.UsageError(
                f"--filter {chosen}: its sources take measurements by name, so that there is no --sensor to leave out; "
                "--check is for error_ekf and spi"
            )
        from vsense_ros.export import state_space

        written = state_space.write(car, str(chosen), output)
        say(f"Written to {output}: {', '.join(file.name for file in written)}.")
        return
    if sensors:
        car = c.with_sensors(car, sensors)
    if chosen is not None:
        car = c.with_filter(car, chosen)
    warn(left_out_of_observer(car))
    with waiting("writing C"):
        files = c.write(car, output)
    say(f"Written to {output}: {', '.join(file.name for file in files)}.")
    if check is None:
        return
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.export import check as checking

    recording = import_recording(check)
    with waiting("compiling C"):
        library = checking.build(output)
    with progress("comparing") as done:
        difference = checking.compare(car, library, recording, done)
    for line in difference.in_words():
        console().print(line, soft_wrap=True)
    with waiting("measuring"):
        c.write(car, output, checking.measure(output))
    say(f"Size and time of a step: {output / 'README.md'}.")


COMMANDS = (export,)
