"""Tables of the monitor: the limits that were found, and what has left them on a recording."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.runner.calibration import Calibration, Watch


def show_limits(calibration: Calibration, console: Console) -> None:
    """Print the limits of each quantity, the margin it has and needs, and what there is to be careful about."""
    numbers = ("mean from", "to", "rms to", "margin", "needed")
    table = plain_table("quantity", "mean from", "to", "rms to", "unit", "margin", "needed", right=numbers)
    for name, limits in calibration.limits.quantities.items():
        rms = "–" if limits.rms is None else f"{limits.rms:.3g}"
        margins = (f"{limits.margin:.2f}", f"{calibration.needed[name]:.2f}")
        table.add_row(name, f"{limits.low:.3g}", f"{limits.high:.3g}", rms, limits.unit, *margins)
    console.print(table)
    console.print("Needed: for each of the recordings, left out, to stay within the limits of the others.")
    for text in _cautions(calibration):
        console.print(text, soft_wrap=True, style="yellow", markup=False)


def _cautions(calibration: Calibration) -> list[str]:
    cautions = [f"The same drive, which counts once: {', '.join(copies)}." for copies in calibration.repeated]
    for reason in dict.fromkeys(calibration.without.values()):
        quantities = ", ".join(name for name, why in calibration.without.items() if why == reason)
        cautions.append(f"No limits for {quantities}: {reason}.")
    if calibration.unsure:
        unsure = ", ".join(calibration.unsure)
        cautions.append(f"They differ too much for sure limits, more recordings are needed: {unsure}.")
    return cautions


def show_watched(drives: Sequence[Watch], console: Console) -> None:
    """Print for each recording what no longer fits, and since when."""
    table = plain_table("recording", "no longer fits", "since", right=("since",))
    for drive in drives:
        for name, since in drive.beyond.items():
            table.add_row(drive.name, name, f"{since:.1f} s")
        if not drive.beyond:
            table.add_row(drive.name, "nothing", "–")
    console.print(table)
