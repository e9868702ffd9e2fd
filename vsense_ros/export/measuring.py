"""How large and how fast exported sources are on this machine, for the README that is written with them."""

from __future__ import annotations

import platform
import re
import subprocess
import tempfile
from pathlib import Path

from vsense_ros import codegen
from vsense_ros.export.check import FLAGS


def _deepest(stack: dict[str, int]) -> int:
    """Bytes of the deepest call, from those of each function; what was inlined is in its caller's."""

    def size(*names: str) -> int:
        return sum(stack.get(name, 0) for name in names)

    products = size("combine_rows")
    moving = [size("transition", "invert"), size("propagate", "propagate_velocities", "propagate_coordinates")]
    moving = [depth + products for depth in moving] + [size("advance"), size("kinematics")]
    moving += [size("spread", "parameters_predict")]
    correcting = [size("correct", "update", "project") + products, size("learn", "parameters_learn")]
    correcting += [size("learn") + depth for name, depth in stack.items() if name.startswith("seen_")]
    calls = max(depth for name, depth in stack.items() if name.startswith("vsense_correct_"))
    return max(size("vsense_predict", "filter_predict") + max(moving), calls + size("filter_measure") + max(correcting))


def measure(folder: Path) -> dict[str, str]:
    """How large and how fast the sources in `folder` are here: for the README that is written with them."""
    compiler = codegen.compiler()
    assert compiler is not None
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "example"
        sources = [str(folder.resolve() / name) for name in ("example.c", "vsense.c")]
        command = [compiler, *FLAGS, *sources, "-o", str(target), "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        printed = subprocess.run([str(target), "--time"], check=True, capture_output=True, text=True).stdout
        subprocess.run(
            [compiler, *FLAGS, "-fstack-usage", "-c", sources[1], "-o", "vsense.o"],
            check=True,
            capture_output=True,
            cwd=place,
        )
        sizes = subprocess.run(["size", "vsense.o"], check=True, capture_output=True, text=True, cwd=place).stdout
        lines = (Path(place) / "vsense.su").read_text(encoding="utf-8").splitlines()
        stack: dict[str, int] = {}
        for where, depth, _ in (line.split("\t") for line in lines):
            name = where.rpartition(":")[2].partition(".")[0]  # without what the compiler says of a copy it made
            stack[name] = max(stack.get(name, 0), int(depth))
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    step = re.search(r"step +([\d.]+) us", printed)
    assert step is not None
    return {
        "compiler": version,
        "flags": " ".join(FLAGS),
        "machine": f"{platform.machine()}, {platform.system()}",
        "text_kb": f"{int(sizes.splitlines()[1].split()[0]) / 1024:.0f}",
        "stack_kb": f"{_deepest(stack) / 1024:.0f}",
        "step_us": step[1],
    }
