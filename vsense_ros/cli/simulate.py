"""Drive manoeuvres with the 14-DOF car."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import load_car, vehicle_option, warn


class ListsManoeuvres(click.Command):
    """A command whose help lists manoeuvres and GNSS receivers."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        from vsense_ros.manoeuvre import MANOEUVRES
        from vsense_ros.manoeuvre.receivers import RECEIVERS

        for heading, names in (("Manoeuvres", MANOEUVRES), ("Receivers", RECEIVERS)):
            with formatter.section(heading):
                formatter.write_text(", ".join(names))


@click.command(cls=ListsManoeuvres)
@click.argument("manoeuvre")
@vehicle_option
@click.option("--out", required=True, type=click.Path(path_type=Path), metavar="BAG", help="Bag to write.")
@click.option(
    "--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Seed of the sensor noise."
)
@click.option("--receiver", metavar="NAME", help="Use this GNSS receiver instead of that of the vehicle file.")
@click.option("--gnss-rate", type=float, metavar="HZ", help="GNSS fixes per second, 0.1 to 100.")
@click.option("--overwrite", is_flag=True, help="Replace an existing bag at BAG.")
def simulate(
    manoeuvre: str, vehicle: str, out: Path, seed: int, receiver: str | None, gnss_rate: float | None, overwrite: bool
) -> None:
    """Simulate a MANOEUVRE, and record the sensors of the car.

    \b
    Examples:
      vsense simulate step_steer --vehicle prototype_real --out out/step_steer
      vsense run out/step_steer --vehicle prototype_model
      vsense simulate double_oval_25 --vehicle jaguar_saloon --receiver dg_100 --gnss-rate 1 --out out/oval

    The bag contains the sensors of the vehicle file, and the true motion as reference. The car has 14 degrees of
    freedom. On roads that are not flat (hills, banked_oval, hill) it is the car with all its bodies, if the vehicle
    file describes its linkages.
    """
    from vsense_ros.bag import write_bag
    from vsense_ros.checks.inspect import inspect
    from vsense_ros.evaluate.terminal import console, say, show_inspection, waiting
    from vsense_ros.manoeuvre import generate
    from vsense_ros.manoeuvre.receivers import with_receiver
    from vsense_ros.model.sensors import known_topics
    from vsense_ros.model.vehicle import left_out_of_simulation

    car = with_receiver(load_car(vehicle), receiver, gnss_rate)
    warn(left_out_of_simulation(car))
    with waiting(f"driving {manoeuvre}"):
        recording = generate(manoeuvre, car, seed)
        write_bag(out, recording, overwrite=overwrite)
    show_inspection(inspect(recording, known_topics()), console())
    say(f"Written to {out}.")


COMMANDS = (simulate,)
