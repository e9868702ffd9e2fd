"""Show the project at work on recorded drives."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import NEW_FOLDER


@click.command()
@click.option("--out", type=NEW_FOLDER, default=Path("out/demo"), show_default=True, help="Folder to write to.")
@click.option("--without-ros", is_flag=True, help="Run everything in this process.")
def demo(out: Path, without_ros: bool) -> None:
    """Show the project at work on three drives.

    \b
    Examples:
      vsense demo
      vsense demo --without-ros --out /tmp/demo

    The drives are a Toyota RAV4 from its raw CAN, IMU and GNSS bytes, a lap of a Hyundai Genesis, and a generated
    double lane change, all through the ROS processes. Prints tables and writes pictures and a report. Drives that need
    missing recordings, a network or ROS are left out, and the output says so.
    """
    from vsense_ros.demo import run_demo
    from vsense_ros.evaluate.terminal import console

    run_demo(out, console(), through_ros=not without_ros)


COMMANDS = (demo,)
