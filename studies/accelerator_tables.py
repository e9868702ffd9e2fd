"""What was measured of the accelerator, as tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from studies.implementation import HIS_SHARES, Implementation
from vsense_ros.evaluate.terminal import console, plain_table, say


def show(content: Mapping[str, Any], rows: Sequence[Implementation], short: bool, console: Console) -> None:
    """Print everything that `accelerator.results` gives."""
    _show_kernels(content["kernels"], console)
    for backend, times in content["node"].items():
        figures = f"p50 {times['p50_ms']:.2f}, p99 {times['p99_ms']:.2f} ms"
        say(f"One 14 × 14 system at 250 Hz through topics, {backend}: {figures}.")
    show_implementation(rows, content["shares"], short)
    say(
        f"Iterations with the solver on the accelerator over those in double precision: at most "
        f"{content['iterations_ratio']:.4f}. Forces and velocities differ from those of the processor alone by at most "
        f"{100 * content['largest_difference']:.2g} % of the largest."
    )
    _show_faults(content["faults"], console)
    for name, mhz in content["timing_ecp5_mhz"].items():
        say(f"{name}: {mhz:g} MHz on ECP5, speed grade 6, as last placed and routed.")
    for build, counted in content["arm"].items():
        figures = f"{counted['instructions_per_step']:,.0f} instructions a step, {counted['code_bytes'] / 1024:.0f} kB"
        time = f", about {counted['ms_estimate']:.2f} ms on a Cortex-A9" if "ms_estimate" in counted else ""
        say(f"{build}: {figures} of code{time}.")
    for unit, checked in content["fmu"].items():
        if not unit.startswith("fmi"):
            say(f"{unit}: {checked}")
            continue
        words = "valid" if checked["valid"] else "not valid"
        bits = "the bits" if checked["bitwise"] else "not the bits"
        say(f"{unit}: {words}, {bits} of the exported C in {checked['steps']} steps.")


def _show_kernels(kernels: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    table = plain_table("kernel", "cycles", "DSP", "LUT", "FF", "BRAM", "bit-exact", right=("cycles", "DSP", "LUT"))
    for name, one in kernels.items():
        exact = "–" if one["systems_bit_exact"] is None else f"{one['systems_bit_exact']} of {one['systems']}"
        table.add_row(name, *(str(one[key]) for key in ("cycles", "dsp", "lut", "ff", "bram")), exact)
    console.print(table)


def _show_faults(faults: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    headings = ("happened", "processor instead", "largest error", "longest wait")
    table = plain_table("fault in a fifth of the requests", *headings, right=headings)
    for kind, one in faults.items():
        wait = f"{100 * one['longest']:.0f} % of the deadline"
        table.add_row(kind, str(one["happened"]), str(one["fallbacks"]), f"{one['worst']:.1e}", wait)
    console.print(table)


def show_implementation(rows: Sequence[Implementation], shares: dict[str, dict[str, float]], short: bool) -> None:
    """Print the tables "Implementation" of Rodríguez 2020 beside ours."""
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
    for name, percent in shares.items():
        table.add_row(name, *(f"{percent[part]:.1f} %" for part in HIS_SHARES))
    console().print(table)
