"""Show the project at work on recorded drives."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import NEW_FOLDER


@click.command()
@click.option("--out", type=NEW_FOLDER, default=Path("out/demo"), show_default=True, help="Folder.")
@click.option("--without-ros", is_flag=True, help="Run everything in this process.")
def demo(out: Path, without_ros: bool) -> None:
    """Three drives through the ROS processes: tables, pictures, a report.

    A Toyota RAV4 from its raw CAN, IMU and GNSS bytes, a lap of a Hyundai Genesis, a generated double lane change.
    Says what it leaves out where recordings, network or ROS are missing.

    \b
    Examples:
      vsense demo
      vsense demo --without-ros --out /tmp/demo
    """
    from vsense_ros.demo import run_demo
    from vsense_ros.evaluate.terminal import console

    run_demo(out, console(), through_ros=not without_ros)


COMMANDS = (demo,)
