"""Look at what is on a CAN bus."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, NEW_FILE


@click.command()
@click.argument("log", type=EXISTING)
@click.option("--dbc", "databases", multiple=True, type=EXISTING, metavar="FILE", help="Database; repeatable.")
@click.option("--output", type=NEW_FILE, metavar="FILE", help="Write the proposed mapping to FILE.")
@click.option("--all", "every", is_flag=True, help="List the signals of all messages.")
def can(log: Path, databases: tuple[Path, ...], output: Path | None, every: bool) -> None:
    """Find the signals of a CAN log that describe the motion.

    \b
    Examples:
      vsense can drive.blf
      vsense can drive.blf --dbc car.dbc --output car.yaml
      vsense import drive.blf drive --dbc car.dbc --mapping car.yaml

    Lists identifiers and rates and, with a database, signals with their ranges. Signals that look like wheel speeds,
    steering angle, yaw rate, accelerations or speed are recognised by their names (English, German, French), units and
    values, and by the relations between them: wheels agree with each other and with the speed, the yaw rate follows
    from their differences, the lateral acceleration from speed and yaw rate, and the steering angle from yaw rate over
    speed. --output writes the proposal as a mapping for `vsense import`, with comments on what to check.
    """
    from vsense_ros.api.can import survey_can
    from vsense_ros.bag.can_table import show
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import console, say, waiting
    from vsense_ros.files.atomic import atomic_write

    if output is not None and not databases:
        raise InputError("--output needs a database (--dbc FILE): without it nothing says what the bytes mean")
    with waiting(f"reading {log.name}"):
        content = survey_can(log, databases)
    show(content.survey, content.roles, console(), every=every)
    if output is None:
        return
    text = content.mapping()
    with atomic_write(output) as file:
        file.write(text)
    say(f"Mapping written to {output}: look at its comments, then `vsense import` takes it with --mapping.")


COMMANDS = (can,)
