"""Predict the accuracy that sensors give, and choose sensors for a wanted accuracy."""

from __future__ import annotations

from pathlib import Path

import click

FILTERS = ("dual_kkf", "inertial", "integrated")
FILTERS_WITH_ANTENNAS = ("dual_kkf_heading", "inertial", "integrated")
_ABOVE_0 = click.FloatRange(0, min_open=True)


@click.command()
@click.argument("manoeuvre", default="lane_change_35")
@click.option("--filter", "filters", multiple=True, metavar="NAME", help=f"Default: {', '.join(FILTERS)}.")
@click.option(
    "--receiver",
    metavar="NAME",
    default="dg_100",
    show_default=True,
    help="survey, mapping, consumer, dg_100_antenna or dg_100.",
)
@click.option("--fix-rate", type=click.FloatRange(0.1, 100), default=1.0, show_default=True, metavar="HZ")
@click.option("--grade", default="cheap", show_default=True, metavar="NAME", help="cheap, industrial or tactical IMU.")
@click.option(
    "--gyro-noise", type=_ABOVE_0, metavar="DEG/S", help="Noise of a sample of 10 ms, in place of the grade's."
)
@click.option("--gyro-bias", type=click.FloatRange(0), metavar="DEG/S", help="Bias, in place of the grade's.")
@click.option("--force-noise", type=_ABOVE_0, metavar="M/S2", help="Noise of a sample of an accelerometer.")
@click.option("--force-bias", type=click.FloatRange(0), metavar="M/S2", help="Bias, in place of the grade's.")
@click.option(
    "--antennas", type=click.FloatRange(0.1, 20), metavar="M", help="Distance of two antennas that measure the heading."
)
@click.option("--latency", type=click.FloatRange(0, 5), default=0.0, metavar="S", help="Unreported latency of fixes.")
@click.option(
    "--outage", type=float, nargs=2, metavar="FROM TO", help="Interval without fixes [s], in which errors are computed."
)
@click.option(
    "--side-slip", "wanted", type=_ABOVE_0, metavar="DEG", help="Find sensors that reach this side-slip error."
)
@click.option(
    "--seeds", type=click.IntRange(1, 1000), default=5, show_default=True, help="Number of seeds of the noise."
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/design"), show_default=True,
    help="Path without extension, for a picture and JSON.",
)  # fmt: skip
def design(
    manoeuvre: str, filters: tuple[str, ...], receiver: str, fix_rate: float, grade: str, gyro_noise: float | None,
    gyro_bias: float | None, force_noise: float | None, force_bias: float | None, antennas: float | None,
    latency: float, outage: tuple[float, float] | None, wanted: float | None, seeds: int, out: Path,
) -> None:  # fmt: skip
    """Predict the accuracy of a GNSS receiver and an IMU.

    \b
    Examples:
      vsense design
      vsense design double_oval_45 --receiver survey --fix-rate 10 --grade industrial
      vsense design lane_change_45 --side-slip 0.1 --filter inertial
      vsense design double_oval_35 --outage 60 70

    Predicts, before sensors are bought, how accurately they will determine heading and side slip. A saloon with all its
    degrees of freedom drives MANOEUVRE, and filters follow it with these sensors at its centre of gravity. Their errors
    are printed beside the closed forms of Leung 2010, section 4.6.
    """
    from dataclasses import replace
    from math import radians

    from vsense_ros.assess import sensor_design as job
    from vsense_ros.assess import sensor_design_picture
    from vsense_ros.assess.drives import Error, Errors
    from vsense_ros.evaluate.terminal import console, progress, say

    errors = job.with_grade(job.with_receiver(Errors(), receiver, fix_rate), grade)
    gyro, force = errors.gyro, errors.force
    errors = replace(
        errors,
        gyro=Error(
            gyro.noise if gyro_noise is None else radians(gyro_noise),
            gyro.bias if gyro_bias is None else radians(gyro_bias),
        ),
        force=Error(
            force.noise if force_noise is None else force_noise, force.bias if force_bias is None else force_bias
        ),
    )
    if antennas is not None:
        errors = job.with_antennas(errors, antennas)
    names = filters or (FILTERS if antennas is None else FILTERS_WITH_ANTENNAS)
    plan = job.Plan(manoeuvre, errors, latency, outage)
    with progress("driving and estimating") as done:
        result = job.design(plan, names, out.parent / "leung", wanted=wanted, seeds=seeds, progress=done)
    job.show(result, console())
    job.write(result, out.with_suffix(".json"))
    picture = sensor_design_picture.draw(result, out.with_suffix(".png"))
    say(f"Written to {picture} and {out.with_suffix('.json').name}.")


COMMANDS = (design,)
