"""Render BENCHMARKS.md from pytest-benchmark's JSON: `python tools/benchmarks.py out/bench.json BENCHMARKS.md`."""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

HEAD = """# Benchmarks

Made by `make bench`; the figures are those of the machine they were made on, single thread. Median and smallest of all
rounds: where the two are far apart, the machine was busy with something else.

"""


def duration(seconds: float) -> str:
    """In the unit that leaves one to three digits before the point."""
    for unit, scale in (("µs", 1e6), ("ms", 1e3)):
        if seconds * scale < 1000:
            return f"{seconds * scale:.3g} {unit}"
    return f"{seconds:.3g} s"


def extra(info: dict[str, Any]) -> str:
    """What a benchmark told beside its time, in words."""
    words = {
        "us_per_message": "{:.2f} µs per message",
        "realtime_factor": "{:.0f} × real time",
        "messages": "{:,} messages",
    }
    told = [text.format(info[key]) for key, text in words.items() if info.get(key, 1) != 1]
    rest = ((key, value) for key, value in info.items() if key not in words and isinstance(value, int | float))
    return ", ".join(told + [f"{key.replace('_', ' ')} {value:.3g}" for key, value in rest])


def machine(found: dict[str, Any]) -> str:
    cpu = found["cpu"]
    name = cpu.get("brand_raw", cpu.get("arch", "unknown processor"))
    return f"{name}, {cpu.get('count', '?')} cores, {found['system']}, Python {found['python_version']}"


def label(benchmark: dict[str, Any]) -> str:
    """`test_part[compiled-linearize]` as `part: compiled, linearize`."""
    name, _, parameters = benchmark["name"].removeprefix("test_").partition("[")
    name = name.replace("_", " ")
    return f"{name}: {parameters.rstrip(']').replace('-', ', ')}" if parameters else name


def render(results: dict[str, Any]) -> str:
    """The page for one run of pytest-benchmark."""
    lines = [HEAD + f"Machine: {machine(results['machine_info'])}.", ""]
    ordered = sorted(results["benchmarks"], key=lambda b: b["group"] or "")
    for group, benchmarks in groupby(ordered, key=lambda b: b["group"] or "other"):
        lines += [f"## {group[0].upper()}{group[1:]}", "", "| | median | smallest | |", "|---|---|---|---|"]
        for b in benchmarks:
            stats = b["stats"]
            times = f"{duration(stats['median'])} | {duration(stats['min'])}"
            lines.append(f"| {label(b)} | {times} | {extra(b['extra_info'])} |")
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    source, target = (Path(argument) for argument in sys.argv[1:3])
    target.write_text(render(json.loads(source.read_text(encoding="utf-8"))), encoding="utf-8")
    print(f"wrote {target}")
