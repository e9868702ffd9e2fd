"""The page of what an accelerator would gain and cost: python tools/accelerator_page.py out/accelerator.json docs

Writes accelerator.md and accelerator/times.png below docs from what `python -m studies accelerator` wrote.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from studies.implementation import HIS, HIS_SHARES
from studies.thesis import PARAMETERS
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner
from vsense_ros.assess.covariance_kernel import accelerated
from vsense_ros.assess.partition import Choice, Device, Partition, load_device, partition, profile, recorded_resources
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle

Row = dict[str, Any]
DEVICES = ("none", "xc7z020", "xc7z045", "xczu7ev")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in lines) + "\n"


def his_gains() -> list[list[str]]:
    """How many times as fast each of his observers was with a kernel as without."""
    return [
        [f"{car} car, {observer}, {step} ms, {tolerance:g}, {kernels}",
         f"{HIS[car, observer, 'none', step, tolerance][0] / seconds:.2f}"]
        for (car, observer, kernels, step, tolerance), (seconds, _) in HIS.items() if kernels != "none"
    ]  # fmt: skip


def plain(rows: Sequence[Row], row: Row) -> Row:
    """The observer without kernels."""
    same = ("car", "observer", "step", "tolerance")
    return next(r for r in rows if r["kernels"] == "none" and all(r[k] == row[k] for k in same))


def chosen(content: dict[str, Any], device: Device, full: bool) -> tuple[Partition, float]:
    """What is recommended for a device, and the iterations that it is recommended for."""
    vehicle = load_vehicle(vehicle_path("prototype_model"))
    car = "full" if full else "simplified"
    rows = [
        r for r in content["implementation"]
        if (r["car"], r["observer"], r["step"], r["tolerance"]) == (car, "errorEKF", 4, 1e-5)
    ]  # fmt: skip
    counted = {row["kernels"]: row["iterations"] for row in rows}
    more = counted["solver"] / counted["none"]
    step = profile(vehicle, full, counted["none"], more)
    return partition(device, device.processor_us(step.flop), step.uses(), more), counted["none"]


def requests(device: Device, choices: Sequence[Choice]) -> Iterator[list[str]]:
    """What a request costs with each kernel, and what would be gained if computing took no time."""
    for choice in choices:
        kernel, link = choice.use.kernel, device.link
        words = link.cycles(kernel) / device.clock_mhz
        saved = device.processor_us(choice.use.flop)
        bound = choice.use.calls * (saved - device.setup_us - words)
        yield [
            kernel.name, f"{choice.use.calls:.1f}", f"{saved:.2f} µs", f"{choice.cycles / device.clock_mhz:.2f} µs",
            f"{words:.2f} µs", f"{device.setup_us:g} µs", f"{choice.gain_us:+.1f} µs", f"{bound:+.1f} µs",
        ]  # fmt: skip


def page(content: dict[str, Any]) -> str:
    rows: list[Row] = content["implementation"]
    board = load_device("xc7z020")
    parts = [
        "# What an accelerator would gain",
        "",
        "Made by `make accelerator` (tools/accelerator_page.py). Iterations are counted; times are modelled: "
        f"operations of the processor at {board.cycles_per_flop:g} cycles each, {board.processor_mhz:g} MHz, kernels, "
        f"a {board.stream_bits}-bit link at {board.clock_mhz:g} MHz, {board.setup_us:g} µs to set up a transfer "
        "(config/devices/xc7z020.yaml). Nothing was measured on silicon.",
        "",
        "## What is where",
        "",
        "    sensors ─▶ observer (processor)                            accelerator",
        "               corrections, covariance, linearisation",
        "               equations of motion ── places of the wheels ──▶ suspension_motion",
        "                                   ── axes of the bodies ────▶ body_mass",
        "               Newton's iteration ─── system ────────────────▶ solve14; full car: solve56",
        "               checks of every result ◀── results ────────────",
        "",
        "## What a request costs",
        "",
        "Of a step of 4 ms of the errorEKF. The last column is the bound by the link: the gain if computing took no "
        "time at all.",
        "",
    ]
    head = ("kernel", "requests", "processor saves", "computing", "words", "set-up", "gain", "bound by the link")
    for full, title in ((False, "Simplified car"), (True, "Full car")):
        found, iterations = chosen(content, board, full)
        parts += [f"{title}, {iterations:.2f} iterations, {found.step_us:,.0f} µs on the processor alone:", ""]
        parts += [table(head, list(requests(board, list(found.best.values()))))]
    parts += ["## What is recommended", "", "By `vsense partition`:", ""]
    recommended = []
    for full in (False, True):
        for name in DEVICES:
            device = load_device(name)
            for setup in (device.setup_us, 0.0):
                found, _ = chosen(content, device.model_copy(update={"setup_us": setup}), full)
                names = ", ".join(f"{c.use.kernel.name} ({c.variant})" for c in found.chosen) or "nothing"
                car = "full" if full else "simplified"
                recommended.append([car, name, f"{setup:g} µs", names, f"{found.speed_up:.3f}"])
    parts += [table(("car", "device", "set-up", "recommended", "times as fast"), recommended)]
    parts += [covariance(content["covariance"]), "## The thesis's tables and ours", "", drives(content), ""]
    parts += ["![Modelled time of a step](accelerator/times.png)", ""]
    lines = []
    for row in rows:
        alone = plain(rows, row)
        his = "–" if row["his"] is None else f"{row['his'][0]:.2f} s, {row['his'][1]:.3f}"
        lines.append([
            row["car"], row["observer"], row["kernels"], f"{row['step']} ms", f"{row['tolerance']:g}",
            f"{row['iterations']:.3f}", f"{row['clocks']:,.0f}", f"{row['seconds']:.2f} s",
            f"{alone['seconds'] / row['seconds']:.3f}", f"{row['difference']:.0e}", his,
        ])  # fmt: skip
    head = (
        "car", "observer", "accelerated", "step", "tolerance", "iterations", "clocks", "10 s", "gain", "difference",
        "thesis: 10 s, iterations",
    )  # fmt: skip
    parts += [table(head, lines)]
    parts += [
        "Iterations and clocks are those of a step; the difference is that of forces and velocities from those of the "
        "processor alone, of the largest. The full car has no suspension tables for the kernel of suspension motion: "
        "his moved the bodies of the linkages. He gained, with the same kernels:",
        "",
        table(("his observer and kernel", "times as fast"), his_gains()),
        "## Where the time goes",
        "",
        table(
            ("share of a step", *HIS_SHARES),
            [["thesis, of computing time", *(f"{v:.1f} %" for v in HIS_SHARES.values())]]
            + [[k, *(f"{v[p]:.1f} %" for p in HIS_SHARES)] for k, v in content["shares"].items()],
        ),
        "Ours are shares of counted operations. Covariance, linearisation and corrections of 52 states, which he did "
        "not list, take most of the rest: that is what an accelerator of this observer has to compute first.",
        "",
    ]
    return "\n".join(parts)


def covariance(compared: dict[str, float]) -> str:
    """What the kernel of the covariance gains."""
    car = load_vehicle(vehicle_path("prototype_model"))
    settings = {"parameters": PARAMETERS, "parameter_filter": "ekf"}
    learning = car.model_copy(update={"observer": car.observer.model_copy(update=settings)})
    rows, iterations = [], 3.0  # of a step, as the table of the implementation counts them
    for name, vehicle in (("errorEKF", car), ("SPI", learning)):
        for device in DEVICES[1:]:
            one = accelerated(vehicle, load_device(device), iterations)
            rows.append([
                name, device, f"{one.alone_us:,.0f} µs", f"{one.covariance_us:,.0f} µs", f"{one.clocks:,}",
                f"{one.words:,}", str(one.requests), f"{one.accelerator_us:.0f} µs", f"{one.step_us:.0f} µs",
            ])  # fmt: skip
    head = ("observer", "device", "alone", "its covariance", "clocks", "words", "requests", "kernel", "with it")
    used = recorded_resources()[f"{RowCombiner.name}/16 lanes"]
    cells = ", ".join(f"{used[kind]:,} {kind.upper()}" for kind in ("dsp", "lut", "ff", "bram"))
    return "\n".join([
        "## The kernel that pays: the covariance",
        "",
        "`hw/rtl/row_combiner.sv` keeps the covariance and adds rows of it by programs "
        "(`vsense_ros/accelerator/covariance.py`): 16 lanes, each with one product and one sum of binary32 in a clock. "
        "A request has the step or what a correction subtracts, and ends with H P of the next sensor; at the end all "
        "of the covariance is read. Clocks are those of the programs of a step with every sensor, words among them, as "
        "the mock and the simulated hardware count them. "
        f"Simplified car, {iterations:g} iterations.",
        "",
        table(head, rows),
        f"It takes {cells} of a Xilinx 7-series. With the covariance in it, and the rest in double precision, states "
        f"of the errorEKF differ by {compared['state']:.1e} standard deviations at most on a double lane change, and "
        f"standard deviations by {100 * compared['deviation']:.2f} % (`studies/accelerated_covariance.py`).",
        "",
        "An SPI at 1 kHz needs a step within 1,000 µs. By these clocks an XC7Z020 has that with the kernel alone, and "
        "an XCZU7EV has it without. What is left out: misses of the instruction cache, for code of 226 kB beside "
        "a cache of 32 kB, are estimated at 550 µs a step and more on the Cortex-A9, which is more than is left of the "
        "millisecond. So this is no promise for an XC7Z020. Missing for one: the clock by place and route, "
        "and a measurement on silicon.",
        "",
    ])  # fmt: skip


def drives(content: dict[str, Any]) -> str:
    short = "from 10 m/s, 1.2 s with his throttle, and his steering at 0.2 s"
    if content["drives"] == "short":
        return f"Friction 0.6, {short}; steps of 4 ms, his finest tolerance (`python -m studies accelerator --short`)."
    return f"The simplified car drives his second manoeuvre; the full one, friction 0.6, {short}."


def picture(rows: Sequence[Row], path: Path) -> None:
    """Time of a step of 4 ms at his finest tolerance, by what it is spent on."""
    from matplotlib.figure import Figure

    shown = [r for r in rows if (r["step"], r["tolerance"]) == (4, 1e-5)]
    labels = [f"{r['car']} {r['observer']}, {r['kernels']}" for r in shown]
    figure = Figure(figsize=(9, 0.34 * len(shown) + 1.2), layout="constrained")
    axes = figure.subplots()
    clock = load_device("xc7z020").clock_mhz
    clocks = [r["clocks"] / clock for r in shown]
    setups = [r["accelerator_us"] - c for r, c in zip(shown, clocks, strict=True)]
    left = [0.0] * len(shown)
    for values, label, colour in (
        ([r["processor_us"] for r in shown], "processor", "#4878a8"), (clocks, "kernels and words", "#e49444"),
        (setups, "set-up of transfers", "#d1615d"),
    ):  # fmt: skip
        axes.barh(labels, values, left=left, label=label, color=colour)
        left = [a + b for a, b in zip(left, values, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("modelled time of a step of 4 ms [µs]")
    axes.legend(loc="upper right")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    content = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    folder = Path(sys.argv[2])
    (folder / "accelerator.md").write_text(page(content), encoding="utf-8")
    picture(content["implementation"], folder / "accelerator" / "times.png")


if __name__ == "__main__":
    main()
