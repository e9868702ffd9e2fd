"""Report which states of a filter a drive has determined."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, load_car, vehicle_option


@click.command()
@click.argument("bag", type=EXISTING)
@vehicle_option
@click.option("--filter", "chosen", default="integrated", show_default=True, metavar="NAME", help="A GNSS/INS filter.")
@click.option(
    "--would/--no-would", "ask", default=True, help="Also simulate motions that may determine the other states."
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Path without extension; default: out/observability/<name>."
)
def observability(bag: Path, vehicle: str, chosen: str, ask: bool, out: Path | None) -> None:
    """Report which states of a filter BAG determines.

    \b
    Examples:
      vsense observability bags/double_lane_change --vehicle prototype_model
      vsense observability med_lap --vehicle genesis --filter inertial

    A state is determined once its standard deviation has fallen to half of its initial value. The report states when,
    and by which motion. For states that are not determined, the vehicle is simulated going straight, accelerating and
    braking, turning and weaving for half a minute each, to find the motion that would determine them.
    """
    from vsense_ros.assess import observability as job
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say, waiting

    car = load_car(vehicle)
    with waiting(f"reading {bag.name}"):
        recording = import_recording(bag)
    with progress("estimating") as done:
        result = job.report(recording, car, chosen, ask=ask, progress=done)
    job.show(result, console())
    out = out or Path("out/observability") / f"{recording.name or bag.stem}_{chosen}"
    job.write(result, out.with_suffix(".json"))
    picture = job.draw(result, out.with_suffix(".png"))
    say(f"Written to {picture} and {out.with_suffix('.json').name}.")


COMMANDS = (observability,)
