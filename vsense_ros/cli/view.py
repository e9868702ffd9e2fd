"""Recordings and live topics in Foxglove."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, NEW_FILE, VEHICLE_HELP, load_car


@click.command()
@click.argument("bags", type=EXISTING, nargs=-1, metavar="[BAG]...")
@click.option(
    "--vehicle", metavar="FILE", help=f"For frames, the shape of the car and friction circles. {VEHICLE_HELP}"
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Address to serve at; beyond this machine: 0.0.0.0."
)
@click.option(
    "--port", default=8765, show_default=True, type=click.IntRange(0, 65535), help="TCP port; 0: any free port."
)
@click.option("--loop", is_flag=True, help="Repeat, for viewers without a time line.")
@click.option("--namespace", default="", metavar="NAME", help="Namespace of the live topics.")
@click.option("--layout", type=NEW_FILE, metavar="FILE", help="Write the layout to FILE, and exit.")
def view(
    bags: tuple[Path, ...],
    vehicle: str | None,
    host: str,
    port: int,
    loop: bool,
    namespace: str,
    layout: Path | None,
) -> None:
    """Show BAG, or the topics that are published now, in Foxglove.

    \b
    Examples:
      vsense view bags/double_lane_change out/run/double_lane_change/output --vehicle prototype_model
      vsense view --layout vsense_layout.json
      vsense view --vehicle rav4

    Without BAG, the topics of ROS are served, as by the node `viewer`. Several bags of one drive are shown together,
    such as a recording and the output of `vsense run`. Foxglove runs in a browser or as an application. Import the
    layout (path, side slip, tyres with their friction circles, diagnostics) there once.
    """
    import shutil
    import subprocess
    import sys
    import threading

    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import say, waiting
    from vsense_ros.files.installed import shared_folder

    shipped = shared_folder("config") / "foxglove" / "vsense.json"
    if layout is not None:
        if layout.exists():
            raise InputError(f"{layout}: exists already; choose another name, or remove it")
        shutil.copyfile(shipped, layout)
        say(f"Layout written to {layout}: in Foxglove, the menu of layouts, Import from file.")
        return
    if not bags:
        command = [sys.executable, "-m", "vsense_ros.node.viewer", "--ros-args"]
        command += ["-p", f"host:={host}", "-p", f"port:={port}"]
        command += ["-p", f"vehicle:={vehicle}"] if vehicle else []
        command += ["-r", f"__ns:=/{namespace.strip('/')}"] if namespace else []
        say(f"Layout: {shipped}")
        sys.exit(subprocess.call(command))

    from vsense_ros.node.foxglove_playback import Playback, Timeline

    car = load_car(vehicle) if vehicle else None
    with waiting(f"reading {', '.join(bag.name for bag in bags)}"):
        timeline = Timeline(bags, car)
    name = ", ".join(bag.resolve().name for bag in bags)
    playback = Playback(timeline, car, host=host, port=port, loop=loop, name=name)
    if playback.unknown:
        say(f"Left out, as their types are defined nowhere: {', '.join(playback.unknown)}.")
    server = playback.server
    say(f"{name}: {len(timeline)} messages at {server.url}. In Foxglove: Open connection, Foxglove WebSocket; or")
    say(f"  {server.app_url}")
    say(f"Layout to import: {shipped}. Ctrl-C ends it.")
    thread = threading.Thread(target=playback.run, name="play", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(0.5)
    except KeyboardInterrupt:
        pass
    finally:
        playback.stop()


COMMANDS = (view,)
