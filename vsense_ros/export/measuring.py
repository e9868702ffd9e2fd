"""How large and how fast exported sources are on this machine, for the README that is written with them."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from vsense_ros import codegen
from vsense_ros.export.check import FLAGS


@dataclass(frozen=True)
class Size:
    """Bytes that compiled sources need: code with tables of constants, variables, and stack of the deepest call, which
    only GCC tells."""

    code: int
    data: int
    stack: int | None


def size_of(sources: Sequence[Path], command: Sequence[str], size: str = "size", keep: Path | None = None) -> Size:
    """Size of sources as a compiler, `command` with its flags, makes them; `size` is binutils' program for its machine.

    Object files are moved to the folder `keep`. The stack is that of the deepest path in the graph of calls which GCC
    writes. Functions of libm are not in it.
    """
    with tempfile.TemporaryDirectory() as place:
        names = [str(source.resolve()) for source in sources]
        tells = "gcc version" in _run([command[0], "-v"], place)
        _run([*command, *(["-fcallgraph-info=su"] if tells else []), "-c", *names], place)
        objects = [str(Path(place) / f"{source.stem}.o") for source in sources]
        rows = [line.split() for line in _run([size, *objects], place).splitlines()[1:]]
        graphs = [file.read_text(encoding="utf-8") for file in Path(place).glob("*.ci")]
        if keep is not None:
            for name in objects:
                shutil.move(name, keep)
    code, data = (sum(int(row[column]) for row in rows) for column in (0, 1))
    return Size(code, data + sum(int(row[2]) for row in rows), _deepest("".join(graphs)) if tells else None)


def _deepest(graph: str) -> int:
    """Bytes of stack on the deepest path of a graph of calls, in the form of GCC's -fcallgraph-info=su."""
    own = {
        name: int(depth) for name, depth in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes', graph)
    }
    calls: dict[str, set[str]] = {name: set() for name in own}
    for caller, called in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', graph):
        calls[caller].add(called)

    @cache
    def depth(name: str) -> int:
        return own.get(name, 0) + max((depth(called) for called in calls.get(name, ())), default=0)

    return max(map(depth, own))


def _run(command: Sequence[str], folder: str) -> str:
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder)
    return done.stdout


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
    size = size_of([folder / "vsense.c"], [compiler, *FLAGS])
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    step = re.search(r"step +([\d.]+) us", printed)
    assert step is not None
    return {
        "compiler": version,
        "flags": " ".join(FLAGS),
        "machine": f"{platform.machine()}, {platform.system()}",
        "text_kb": f"{size.code / 1024:.0f}",
        "stack_kb": "?" if size.stack is None else f"{size.stack / 1024:.0f}",
        "step_us": step[1],
    }
