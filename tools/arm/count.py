"""Instructions of the exported observer on ARM's cores, counted under qemu: python tools/arm/count.py

Cross-compiles errorEKF and SPI of a vehicle for a Cortex-A9, A53 and R52, in double and single precision, and runs them
on a double lane change under qemu with a plugin that counts instructions: every sensor in every step, of 4 ms. Prints
the mean and the heaviest step, the size of code, the stack of the deepest call, and for the A9 what a step takes beside
the thesis's times. Needs the cross compilers and qemu-user (make hw-tools). Writes out/arm.json.

The time is an estimate, no measurement: counted instructions by their issue cycles in ARM's technical reference manuals
of the Cortex-A9 and its NEON unit, once with loads and arithmetic side by side and once all in a row, with every
instruction and number in the first-level cache. qemu has no R52 in user mode: its code, of Armv8-R, runs on `max`.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studies.thesis import PARAMETERS
from vsense_ros.export import c
from vsense_ros.export.measuring import size_of
from vsense_ros.export.same_calls import Moment, moments, start_of
from vsense_ros.export.sources import identifier, in_single_precision
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.model.vehicle import Vehicle

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Core:
    """A processor: names of its binutils begin with `tools`, qemu runs its code as `cpu`."""

    tools: str
    flags: tuple[str, ...]
    emulator: str
    cpu: str


# NEON has one rounding and no subnormal numbers, for which GCC asks to be told that this will do. Prefetches only cost:
# all that a step touches stays in the cache.
COMMON = ("-O3", "-std=c99", "-funsafe-math-optimizations", "-fno-prefetch-loop-arrays")
CORES = {
    "cortex-a9": Core(
        "arm-linux-gnueabihf-", ("-mcpu=cortex-a9", "-mfpu=neon", "-mfloat-abi=hard"), "qemu-arm", "cortex-a9"
    ),
    "cortex-a53": Core("aarch64-linux-gnu-", ("-mcpu=cortex-a53",), "qemu-aarch64", "cortex-a53"),
    "cortex-r52": Core(
        "arm-linux-gnueabihf-", ("-mcpu=cortex-r52", "-mfpu=neon-fp-armv8", "-mfloat-abi=hard"), "qemu-arm", "max"
    ),
}
TIMED = "cortex-a9"  # whose issue cycles are known here
STEP, STEPS, SKIPPED = 0.004, 250, 20  # [s] of a step; how many; of the first, as many are not counted
CLOCK = 667e6  # [Hz] of the thesis's Zynq-7020
HIS_MS = {"errorEKF": 3.07, "SPI": 8.45}
MAIN = """
__attribute__((noinline)) void step_ended(void);
void step_ended(void) { __asm__ volatile(""); }

int main(void) {
    vsense_init(&v, %(speed).17g);
    v.state[VSENSE_YAW] = %(yaw).17g;
    vsense_linearize(&v);
    for (int i = 0; i < %(steps)d; i++) {
        vsense_predict(&v, STEP);
        vsense_linearize(&v);
%(corrections)s
        step_ended();
    }
    printf("%%.9Lg %%.9Lg\\n", (long double)v.state[VSENSE_VELOCITY_X], (long double)v.state[VSENSE_VELOCITY_Y]);
    return 0;
}
"""


def program_of(example: str, vehicle: Vehicle, drive: list[Moment], single: bool) -> str:
    """The example with a drive in place of rolling straight on: the newest value of each sensor in every step."""
    sensors = re.findall(r"vsense_correct_(\w+)\(&v, measured_", example)
    newest: dict[str, np.ndarray] = {}
    rows: dict[str, list[str]] = {sensor: [] for sensor in sensors}
    place = 0
    for i in range(STEPS):
        while place < len(drive) and drive[place].time <= i * STEP:
            newest |= {identifier(name): value for name, value in drive[place].measured.items()}
            place += 1
        for sensor in sensors:
            value = newest.get(sensor)
            rows[sensor].append("{0}" if value is None else f"{{{', '.join(f'{v:.9e}' for v in value)}}}")
    text = example[: example.index("static void step(")]
    corrections = []
    for sensor in sensors:
        size = f"VSENSE_{sensor.upper()}_SIZE"
        text += f"static const double drive_{sensor}[{STEPS}][{size}] = {{\n{', '.join(rows[sensor])}\n}};\n"
        corrections.append(
            f"        vsense_correct_{sensor}(&v, drive_{sensor}[i], vsense_{sensor}_variance, "
            f"VSENSE_{sensor.upper()}_LIMIT, 1);"
        )
    speed, yaw = start_of(vehicle, drive)
    more = MAIN % {"speed": speed, "yaw": yaw, "steps": STEPS, "corrections": "\n".join(corrections)}
    more = text[example.index("static vsense v;") :] + more
    text = example[: example.index("static vsense v;")]
    return text + (in_single_precision(more) if single else more)


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


@dataclass(frozen=True)
class Counted:
    """Instructions by mnemonic, in the mean step and in the heaviest one; and how many different ones there were."""

    mean: dict[str, float]
    heaviest: dict[str, float]
    different: int


def counted(core: Core, program: Path, library: Path, folder: Path) -> Counted:
    """Run a program of this core and count."""
    names = run([f"{core.tools}nm", str(program)]).splitlines()
    (address,) = (line.split()[0] for line in names if line.endswith(" step_ended"))
    told = folder / "told.txt"
    told_to = {"INSTRUCTIONS": str(told), "STEP_ENDED": address, "SKIPPED": str(SKIPPED)}
    run([core.emulator, "-cpu", core.cpu, "-plugin", str(library), str(program)], env={**os.environ, **told_to})
    lines = [line.split() for line in told.read_text().splitlines()]
    rows = {line[2]: (int(line[0]), int(line[1])) for line in lines if len(line) == 3}
    steps, different = rows.pop("DIFFERENT")
    mean = {name: total / steps for name, (total, _) in rows.items()}
    return Counted(mean, {name: float(most) for name, (_, most) in rows.items()}, different)


def estimate(each: dict[str, float]) -> dict[str, float]:
    """Times [ms] of a step on the A9: loads and arithmetic side by side, and all in a row."""
    spent = {"memory": 0.0, "arithmetic": 0.0, "integer": 0.0}
    for name, number in each.items():
        cycles, unit = issue(name)
        spent[unit] += cycles * number
    overlapped = max(spent["memory"], spent["arithmetic"], sum(each.values()) / 2)
    return {"ms_estimate_low": 1e3 * overlapped / CLOCK, "ms_estimate": 1e3 * sum(spent.values()) / CLOCK}


def measure(core: Core, vehicle: Vehicle, drive: list[Moment], single: bool, folder: Path) -> dict[str, float]:
    """Measures of a build: instructions of the mean and the heaviest step, size of code, stack, and for the A9
    operations and estimates of time."""
    sources = folder / "sources"
    c.write(vehicle, sources, single=single)
    example = (sources / "example.c").read_text()
    (sources / "count.c").write_text(program_of(example, vehicle, drive, single))
    command, program = [f"{core.tools}gcc", *COMMON, *core.flags], folder / "count"
    size = size_of([sources / "vsense.c"], command, f"{core.tools}size", folder)
    parts = [str(folder / "count.o"), str(folder / "vsense.o")]
    run([*command, f"-I{sources}", "-c", str(sources / "count.c"), "-o", parts[0]])
    if core.tools.startswith("arm"):  # its libraries are of profile A, and would not be linked with code of profile R
        for part in parts:
            run([f"{core.tools}objcopy", "--remove-section", ".ARM.attributes", part])
    run([f"{core.tools}gcc", "-static", *parts, "-o", str(program), "-lm"])
    found = counted(core, program, plugin(folder), folder)
    figures = {
        "instructions_per_step": round(sum(found.mean.values())),
        "instructions_of_heaviest_step": round(sum(found.heaviest.values())),
        "different_instructions": found.different,
        "code_bytes": size.code,
        "stack_bytes": size.stack or 0,
    }
    if core is CORES[TIMED]:
        figures["flop_per_step"] = round(sum(number * _flop(name) for name, number in found.mean.items()))
        figures |= estimate(found.mean)
        figures["ms_estimate_of_heaviest_step"] = estimate(found.heaviest)["ms_estimate"]
    return figures


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
    vehicle = load_vehicle(vehicle_path(sys.argv[1] if len(sys.argv) > 1 else "prototype_model"))
    drive = moments(vehicle, generate("double_lane_change", vehicle))
    results: dict[str, dict[str, float]] = {}
    print(f"{'':30}{'mean step':>12}{'heaviest':>12}{'code':>10}{'stack':>10}   estimate at 667 MHz     thesis")
    for core_name, core in CORES.items():
        if lacking := [n for n in (f"{core.tools}gcc", core.emulator, "cc") if shutil.which(n) is None]:
            print(f"{core_name}: {', '.join(lacking)} cannot be found; make hw-tools installs what is needed")
            continue
        for name, (one, single) in builds(vehicle).items():
            with tempfile.TemporaryDirectory() as place:
                found = measure(core, one, drive, single, Path(place))
            results[name if core_name == TIMED else f"{name}_{core_name}"] = found
            line = (
                f"{core_name:12}{name:18}{found['instructions_per_step']:>12,}"
                f"{found['instructions_of_heaviest_step']:>12,}{found['code_bytes'] / 1024:>7.0f} kB"
                f"{found['stack_bytes'] / 1024:>7.1f} kB"
            )
            if core_name == TIMED:
                times = f"{found['ms_estimate_low']:.2f} … {found['ms_estimate']:.2f} ms"
                line += f"   {times:20} {HIS_MS[name.partition('_')[0]]:.2f} ms"
            print(line, flush=True)
    print("Every sensor in every step of a double lane change, counted under qemu. The time is estimated from")
    print("issue cycles, caches warm; it was not measured on silicon.")
    if not results:
        raise SystemExit(1)
    Path("out").mkdir(exist_ok=True)
    Path("out/arm.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
