"""Instructions of the exported observer on an ARM Cortex-A9, counted under qemu: python tools/arm/count.py

Cross-compiles errorEKF and SPI of a vehicle, in double and single precision, runs so many steps with every sensor in
each under qemu-arm with a plugin that counts instructions, and prints what a step takes beside the thesis's times.
Needs arm-linux-gnueabihf-gcc and qemu-arm (make hw-tools). Writes out/arm.json.

The time is an estimate, no measurement: counted instructions by their issue cycles in ARM's technical reference manuals
of the Cortex-A9 and its NEON unit, once with loads and arithmetic side by side and once all in a row, with every
instruction and number in the first-level cache.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from studies.thesis import PARAMETERS
from vsense_ros.export import c
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle

HERE = Path(__file__).parent
COMPILER, EMULATOR = "arm-linux-gnueabihf-gcc", "qemu-arm"
# NEON has one rounding and no subnormal numbers, for which GCC asks to be told that this will do. Prefetches only cost:
# all that a step touches stays in the cache.
COMMON = ["-O3", "-std=c99", "-mcpu=cortex-a9", "-mfpu=neon", "-mfloat-abi=hard", "-funsafe-math-optimizations",
          "-fno-prefetch-loop-arrays"]  # fmt: skip
FEW, MANY = 20, 60  # steps: what a step takes is the difference
CLOCK = 667e6  # [Hz] of the thesis's Zynq-7020
HIS_MS = {"errorEKF": 3.07, "SPI": 8.45}
MAIN = """
#include <stdlib.h>
int main(int argc, char **argv) {
    (void)argc;
    vsense_init(&v, 20);
    vsense_linearize(&v);
    for (int i = 0; i < atoi(argv[1]); i++) step();
    printf("%.9g\\n", (double)v.state[VSENSE_VELOCITY_X]);
    return 0;
}
"""


def issue(mnemonic: str) -> tuple[float, str]:
    """Cycles that an instruction takes the unit that executes it, and which that is."""
    m = mnemonic
    for begin, cycles in (("vldr", 1.0), ("vstr", 1.0), ("vldm", 4.0), ("vstm", 4.0), ("vpush", 4.0), ("vpop", 4.0)):
        if m.startswith(begin):
            return cycles, "memory"
    if m.startswith(("vld1", "vst1")):
        return 2.0, "memory"
    if m.startswith(("ldm", "stm", "push", "pop")):
        return 2.5, "memory"
    if m.startswith(("ldr", "str", "pld")):
        return 1.0, "memory"
    for pattern, cycles in (
        (r"vdiv\.f64", 20.0), (r"vsqrt\.f64", 28.0), (r"vdiv\.f32", 10.0), (r"vsqrt\.f32", 13.0),
        (r"v(n?mul|n?mla|n?mls|f[nm]*[as]).*f64", 2.0), (r"v(mul|mla|mls|add|sub).*f32", 2.0),
    ):  # fmt: skip
        if re.match(pattern, m):
            return cycles, "arithmetic"
    return (1.0, "arithmetic") if m.startswith("v") else (0.6, "integer")


_FLOP = re.compile(r"v(n?mul|n?mla|n?mls|add|sub|div|sqrt|f[nm]+[as]).*f(64|32)")


def _flop(mnemonic: str) -> int:
    """Operations of an instruction; a multiplication with an addition is two."""
    if not _FLOP.match(mnemonic):
        return 0
    return 2 if re.match(r"v(n?mla|n?mls|f[nm]+[as])", mnemonic) else 1


def run(command: list[str], **more: object) -> str:
    done = subprocess.run(command, capture_output=True, text=True, **more)  # type: ignore[call-overload]
    if done.returncode:
        raise SystemExit(f"{' '.join(command[:3])} …: {done.stderr.strip()[-1500:]}")
    return str(done.stdout)


def plugin(folder: Path) -> Path:
    target = folder / "instructions.so"
    run(["cc", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", str(HERE / "instructions.c"), "-o", str(target)])
    return target


def counted(program: Path, steps: int, library: Path, folder: Path) -> dict[str, int]:
    told = folder / "told.txt"
    command = [EMULATOR, "-cpu", "cortex-a9", "-plugin", str(library), str(program), str(steps)]
    run(command, env={**os.environ, "INSTRUCTIONS": str(told)})
    lines = [line.split() for line in told.read_text().splitlines()]
    return {line[1]: int(line[0]) for line in lines if len(line) == 2}


def measure(vehicle: Vehicle, single: bool, folder: Path, library: Path) -> dict[str, float]:
    """Measures of a build: instructions and floating-point operations of a step, size of code, stack, the estimate."""
    sources = folder / "sources"
    c.write(vehicle, sources, single=single)
    example = (sources / "example.c").read_text()
    (sources / "count.c").write_text(example[: example.index("int main(")] + MAIN)
    flags = [*COMMON]
    object_file, program = folder / "vsense.o", folder / "count"
    run([COMPILER, *flags, "-fstack-usage", "-c", str(sources / "vsense.c"), "-o", str(object_file)], cwd=folder)
    run(
        [
            COMPILER,
            *flags,
            "-static",
            f"-I{sources}",
            str(sources / "count.c"),
            str(object_file),
            "-o",
            str(program),
            "-lm",
        ]
    )
    size = run(["arm-linux-gnueabihf-size", str(object_file)]).splitlines()[1].split()
    depths = [int(line.split("\t")[1]) for line in (folder / "vsense.su").read_text().splitlines()]
    few, many = (counted(program, steps, library, folder) for steps in (FEW, MANY))
    different = many.pop("DIFFERENT")
    few.pop("DIFFERENT")
    each = {name: (number - few.get(name, 0)) / (MANY - FEW) for name, number in many.items()}
    instructions = sum(each.values())
    spent = {"memory": 0.0, "arithmetic": 0.0, "integer": 0.0}
    for name, number in each.items():
        cycles, unit = issue(name)
        spent[unit] += cycles * number
    overlapped = max(spent["memory"], spent["arithmetic"], instructions / 2)
    serial = sum(spent.values())
    return {
        "instructions_per_step": round(instructions),
        "flop_per_step": round(sum(number * _flop(name) for name, number in each.items())),
        "different_instructions": different,
        "code_bytes": int(size[0]),
        "deepest_frame_bytes": max(depths),
        "ms_estimate_low": 1e3 * overlapped / CLOCK,
        "ms_estimate": 1e3 * serial / CLOCK,
    }


def builds(vehicle: Vehicle) -> dict[str, tuple[Vehicle, bool]]:
    """The vehicle as each observer has it, and whether in single precision."""
    plain = c.with_filter(vehicle, "error_ekf")
    settings = {"parameters": PARAMETERS, "parameter_filter": "ekf"}
    learning = vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update=settings)})
    return {
        "errorEKF_double": (plain, False), "errorEKF_float32": (plain, True), "SPI_double": (learning, False),
        "SPI_float32": (learning, True),
    }  # fmt: skip


def main() -> None:
    if lacking := [name for name in (COMPILER, EMULATOR, "cc") if shutil.which(name) is None]:
        raise SystemExit(f"{', '.join(lacking)} cannot be found; make hw-tools installs what is needed")
    vehicle = load_vehicle(vehicle_path(sys.argv[1] if len(sys.argv) > 1 else "prototype_model"))
    results = {}
    print(f"{'':18}{'instructions':>14}{'flop':>10}{'code':>10}{'stack':>9}   estimate at 667 MHz     thesis")
    for name, (one, single) in builds(vehicle).items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            found = results[name] = measure(one, single, folder, plugin(folder))
        print(
            f"{name:18}{found['instructions_per_step']:>14,}{found['flop_per_step']:>10,}"
            f"{found['code_bytes'] / 1024:>7.0f} kB{found['deepest_frame_bytes'] / 1024:>6.1f} kB   "
            f"{found['ms_estimate_low']:.2f} … {found['ms_estimate']:.2f} ms         "
            f"{HIS_MS[name.partition('_')[0]]:.2f} ms",
            flush=True,
        )
    print(
        "A step with every sensor in it. Estimated from counts and issue cycles, caches warm; not measured on silicon."
    )
    Path("out").mkdir(exist_ok=True)
    Path("out/arm.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
