"""The accelerator: what it reaches, and which kernels are worth a device."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsense_ros.cli.common import NEW_FILE, load_car

if TYPE_CHECKING:
    from vsense_ros.experiments.implementation import Implementation


@click.command()
@click.option("--systems", default=10_000, show_default=True, type=click.IntRange(1), help="Of each kernel, for bits.")
@click.option("--requests", default=100_000, show_default=True, type=click.IntRange(1), help="Under each fault.")
@click.option("--short", is_flag=True, help="Of the implementation table the lines of 4 ms and 1e-5, drives of 1.2 s.")
@click.option("--table", "only_table", is_flag=True, help="The implementation table alone.")
@click.option("--out", type=NEW_FILE, default=Path("out/accelerator.json"), show_default=True, help="File.")
@click.option("--vehicle", default="prototype_model", show_default=True, help="Vehicle file with suspension tables.")
def accelerator(systems: int, requests: int, short: bool, only_table: bool, out: Path, vehicle: str) -> None:
    """Kernels of the accelerator: bits, clocks, resources, latency through ROS, iterations beside the thesis's.

    Simulates the hardware with Verilator, if it is there. Resources are those of the last `make hw`, clocks on ECP5
    those of the last `make hw-timing`; instructions on ARM those of the last `make arm`, if there was one.

    \b
    Examples:
      vsense accelerator
      vsense accelerator --systems 500 --requests 1000 --short
      vsense accelerator --table --short
    """
    from vsense_ros.accelerator.rtl import missing
    from vsense_ros.evaluate.terminal import console, plain_table, progress, say
    from vsense_ros.experiments import accelerator as job

    if only_table:
        content, rows = job.implementation_table(load_car(vehicle), short, progress)
        _show_implementation(rows, content["shares"], short)
        _write(content, out)
        return
    if lacking := missing():
        say(f"Left out for want of {', '.join(lacking)} (make hw-tools): bits of the hardware, the node with rtl.")
    content, rows = job.results(load_car(vehicle), systems, requests, short, progress)
    table = plain_table("kernel", "cycles", "DSP", "LUT", "FF", "BRAM", "bit-exact", right=("cycles", "DSP", "LUT"))
    for name, found in content["kernels"].items():
        exact = "–" if found["systems_bit_exact"] is None else f"{found['systems_bit_exact']} of {found['systems']}"
        table.add_row(name, *(str(found[key]) for key in ("cycles", "dsp", "lut", "ff", "bram")), exact)
    console().print(table)
    for backend, times in content["node"].items():
        figures = f"p50 {times['p50_ms']:.2f}, p99 {times['p99_ms']:.2f} ms"
        say(f"One 14 × 14 system at 250 Hz through topics, {backend}: {figures}.")
    _show_implementation(rows, content["shares"], short)
    say(
        f"Iterations with the solver on the accelerator over those in double precision: at most "
        f"{content['iterations_ratio']:.4f}. Forces and velocities differ from those of the processor alone by at most "
        f"{100 * content['largest_difference']:.2g} % of the largest."
    )
    headings = ("happened", "processor instead", "largest error", "longest wait")
    table = plain_table("fault in a fifth of the requests", *headings, right=headings)
    for kind, one in content["faults"].items():
        wait = f"{100 * one['longest']:.0f} % of the deadline"
        table.add_row(kind, str(one["happened"]), str(one["fallbacks"]), f"{one['worst']:.1e}", wait)
    console().print(table)
    for name, mhz in content["timing_ecp5_mhz"].items():
        say(f"{name}: {mhz:g} MHz on ECP5, speed grade 6, as last placed and routed.")
    for build, counted in content["arm"].items():
        figures = f"{counted['instructions_per_step']:,.0f} instructions a step, {counted['code_bytes'] / 1024:.0f} kB"
        say(f"Cortex-A9, {build}: {figures} of code, about {counted['ms_estimate']:.2f} ms.")
    for unit, checked in content["fmu"].items():
        words = "valid" if checked["valid"] else "not valid"
        bits = "the bits" if checked["bitwise"] else "not the bits"
        say(f"{unit}: {words}, {bits} of the exported C in {checked['steps']} steps.")
    _write(content, out)


def _write(content: dict[str, Any], out: Path) -> None:
    import json

    from vsense_ros.evaluate.terminal import say

    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    say(f"Written to {out}.")


def _show_implementation(rows: Sequence[Implementation], shares: dict[str, dict[str, float]], short: bool) -> None:
    """His tables "Implementation" and ours."""
    from vsense_ros.evaluate.terminal import console, plain_table, say
    from vsense_ros.experiments.implementation import HIS_SHARES

    headings = (
        "iterations",
        "clocks",
        "link and kernels",
        "processor",
        "10 s",
        "difference",
        "thesis: 10 s, iterations",
    )
    table = plain_table("car", "observer", "accelerated", "step", "tolerance", *headings, right=headings)
    for row in rows:
        his = f"{row.his[0]:.2f} s, {row.his[1]:.3f}" if row.his else "–"
        table.add_row(
            row.car, row.observer, row.kernels, f"{row.step} ms", f"{row.tolerance:g}", f"{row.iterations:.3f}",
            f"{row.clocks:,.0f}", f"{row.accelerator_us:,.1f} µs", f"{row.processor_us:,.0f} µs",
            f"{row.seconds:.2f} s", f"{row.difference:.1e}", his,
        )  # fmt: skip
    wide = console()
    wide.width = max(wide.width, 170)
    wide.print(table)
    say(
        "Iterations, clocks, link and processor are those of a step; times are modelled: counted operations on the "
        "Cortex-A9, the link of config/devices/xc7z020.yaml. The full car has no suspension tables for that kernel; it "
        f"drives 1.2 s, the simplified one {'the same' if short else 'the second manoeuvre of the thesis'}."
    )
    table = plain_table("share of a step's operations", *HIS_SHARES, right=tuple(HIS_SHARES))
    table.add_row("thesis, of computing time", *(f"{value:.1f} %" for value in HIS_SHARES.values()))
    for name, found in shares.items():
        table.add_row(name, *(f"{found[part]:.1f} %" for part in HIS_SHARES))
    console().print(table)


@click.command()
@click.argument("vehicle")
@click.option("--device", required=True, metavar="FILE", help="File of a device, or the name of one in config/devices.")
@click.option("--full", is_flag=True, help="The observer with all bodies and linkages, in steps of 4 ms.")
@click.option("--iterations", type=click.FloatRange(1, 100), help="In a step. By default measured on a short drive.")
def partition(vehicle: str, device: str, full: bool, iterations: float | None) -> None:
    """Which kernels of the observer of VEHICLE are worth a device, and what the whole gains.

    From the operations of the observer by the implicit rule, its iterations and what single precision does to them,
    clocks and resources of the kernels, and the cost of the link; nothing is recommended where nothing is gained.

    \b
    Examples:
      vsense partition prototype_model --device xc7z020
      vsense partition prototype_model --device xc7z020 --full
      vsense partition prototype_model --device my_board.yaml --iterations 5
    """
    from vsense_ros.evaluate.terminal import console, plain_table, say
    from vsense_ros.experiments import partition as job

    car, board = load_car(vehicle), job.load_device(device)
    more = 1.0
    if iterations is None:
        from vsense_ros.experiments.implementation import measured

        iterations, more = measured(car, full)
        changed = f"single precision makes them {more:.3f} times as many"
        words = "single precision leaves them" if abs(more - 1) < 5e-4 else changed
        say(f"A step takes {iterations:.2f} iterations; {words}.")
    profile = job.profile(car, full, iterations, more)
    step_us = board.processor_us(profile.flop)
    found = job.partition(board, step_us, profile.uses(), more)
    say(f"A step takes about {step_us:.0f} µs on the processor of {board.name}, by counted operations.")
    table = plain_table("kernel", "calls", "processor saves", "accelerator", "variant", "gain a step", right=("calls",))
    for name, choice in found.best.items():
        use = choice.use
        each = 1e6 * board.link.seconds(choice.cycles + board.link.cycles(use.kernel))
        table.add_row(
            name, f"{use.calls:g}", f"{board.processor_us(use.flop):.2f} µs", f"{each:.2f} µs", choice.variant,
            f"{choice.gain_us:+.1f} µs",
        )  # fmt: skip
    console().print(table)
    if not found.chosen:
        say("Nothing is recommended: no kernel that fits gains more than its link costs.")
        return
    names = ", ".join(f"{choice.use.kernel.name} ({choice.variant})" for choice in found.chosen)
    needed = ", ".join(
        f"{sum(c.resources[r] for c in found.chosen)} of {getattr(board, r)} {r.upper()}" for r in job.RESOURCES
    )
    say(f"Recommended: {names}. The whole gains {found.gain_us:.0f} µs a step: {found.speed_up:.3f} times as fast.")
    say(f"Needed: {needed}.")


COMMANDS = (accelerator, partition)
