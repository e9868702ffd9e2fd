"""Exported C examined: python tools/exports.py

Sizes of errorEKF, SPI and GNSS/INS filters in double and single precision, for this machine and, where its compiler is
installed, a Cortex-A9; two exports in one program; and MISRA C:2012 by cppcheck's add-on, against the deviations that
docs/misra.md states. Writes out/exports.json, which `make accelerator` takes over, and the table of docs/misra.md.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from studies.thesis import PARAMETERS
from vsense_ros.export import c, filters
from vsense_ros.export.measuring import Size, size_of
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "misra.md"
SHOWN = ("dual_kkf", "integrated_kf_a", "heading_bank")  # a cascade, a filter in one piece, a bank
COMPILERS = {
    "x86-64, -O3": (["gcc", "-O3", "-std=c99"], "size"),
    "Cortex-A9, -O3": (
        ["arm-linux-gnueabihf-gcc", "-O3", "-std=c99", "-mcpu=cortex-a9", "-mfpu=neon"],
        "arm-linux-gnueabihf-size",
    ),
    "Cortex-A9, -Os -mthumb": (
        ["arm-linux-gnueabihf-gcc", "-Os", "-mthumb", "-std=c99", "-mcpu=cortex-a9", "-mfpu=neon"],
        "arm-linux-gnueabihf-size",
    ),
}
SMALLEST = "Cortex-A9, -Os -mthumb"
BEGIN, END = "<!-- sizes -->", "<!-- end of sizes -->"

TWO = """
#include <stdio.h>
#include "light.h"
#include "heavy.h"
static double acceleration[14], wheels[LIGHT_OUTPUTS * 4];
static void weigh(const double *forces) { printf("%.6f ", forces[0] + forces[1] + forces[2] + forces[3]); }
int main(void) {
    static light l;
    static heavy h;
    light_init(&l, 15); heavy_init(&h, 15);
    light_linearize(&l); heavy_linearize(&h);
    light_present(&l, acceleration, wheels); weigh(&wheels[4 * LIGHT_FORCE_Z]);
    heavy_present(&h, acceleration, wheels); weigh(&wheels[4 * HEAVY_FORCE_Z]);
    return 0;
}
"""


def learning(vehicle: Vehicle) -> Vehicle:
    """The vehicle with the two parameters that the thesis estimates."""
    settings = {"parameters": PARAMETERS, "parameter_filter": "ekf"}
    return vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update=settings)})


def written(vehicle: Vehicle, name: str, folder: Path, *, single: bool) -> list[Path]:
    """Write the export of this name, and return what is to be compiled."""
    if name in ("errorEKF", "SPI"):
        car = c.with_filter(vehicle, "error_ekf") if name == "errorEKF" else learning(vehicle)
        c.write(car, folder, single=single)
        return [folder / "vsense.c"]
    filters.write(vehicle, name, folder, single=single)
    return filters.sources(name, folder)


def sizes(vehicle: Vehicle) -> dict[str, dict[str, Size]]:
    """Size of each export in each precision, by the compilers that are installed."""
    found: dict[str, dict[str, Size]] = {}
    for name in ("errorEKF", "SPI", *SHOWN):
        for single in (False, True):
            with tempfile.TemporaryDirectory() as place:
                sources = written(vehicle, name, Path(place), single=single)
                found[f"{name}, {'single' if single else 'double'}"] = {
                    key: size_of(sources, command, size)
                    for key, (command, size) in COMPILERS.items()
                    if shutil.which(command[0])
                }
    return found


def two_in_one(vehicle: Vehicle) -> bool:
    """True if two exports in one program each carry the weight of their own car."""
    mass = vehicle.physics.chassis.mass
    cars = {"light": vehicle, "heavy": vehicle.with_parameters({"chassis.mass": 1.5 * mass})}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "two.c").write_text(TWO, encoding="utf-8")
        for name, car in cars.items():
            c.write(car, folder, prefix=name)
            # Both have parts of the same names: each in a folder of its own.
            own = folder / f"of_{name}"
            own.mkdir()
            for file in [*folder.glob("*.[ch]")]:
                if file.name != "two.c":
                    file.rename(own / file.name)
        parts = [str(folder / f"of_{name}" / f"{name}.c") for name in cars]
        command = ["gcc", "-O1", "-std=c99", *(f"-I{folder / f'of_{name}'}" for name in cars), *parts]
        done = subprocess.run([*command, str(folder / "two.c"), "-o", str(folder / "two"), "-lm"], capture_output=True)
        if done.returncode:
            return False
        light, heavy = subprocess.run([str(folder / "two")], capture_output=True, text=True).stdout.split()
    return all(
        abs(float(weight) / (9.80665 * factor * mass) - 1) < 0.01 for weight, factor in ((light, 1), (heavy, 1.5))
    )


_NAME = re.compile(r"\b(?!double|const|int|for|static|short|void|if|else|return)[a-zA-Z_]\w*\b(?!\()")
_NUMBER = re.compile(r"\b\d[\w.]*(?:[eE][+-]?\d+)?")


def shortened(model: str) -> str:
    """The car's functions with one statement of each form: cppcheck takes hours for the 12,000 of a Jacobian.

    A form is a statement without its names and numbers. Values whose statements are left out are declared at the top of
    their function.
    """
    head, *functions = re.split(r"(?m)^(?=static void )", model)
    return head + "".join(map(_shortened, functions))


def _shortened(function: str) -> str:
    signature, body = function.split(") {\n", 1)
    statements, seen, kept, left_out = [], set(), [], set()
    for line in body.rpartition("\n}")[0].split("\n"):
        if statements and not statements[-1].endswith((";", "{", "}", "*/")):
            statements[-1] += " " + line.strip()
        else:
            statements.append(line)
    for statement in statements:
        form = _NUMBER.sub("1", _NAME.sub("x", statement.strip()))
        if statement.endswith(("{", "}")) or form not in seen or re.search(r"(double|short) \w+\[", statement):
            kept.append(statement)
        elif declared := re.match(r"\s*const double (a\d+)(\[\])? =", statement):
            left_out.add((declared[1], declared[2] or ""))
        seen.add(form)
    used = set(re.findall(r"\ba\d+\b", "\n".join(kept)))
    values = (f"    const double {name}{'[4] = {0.5}' if array else ' = 0.5'};" for name, array in sorted(left_out)
              if name in used)  # fmt: skip
    return "\n".join([f"{signature}) {{", *values, *kept, "}\n"])


def findings(vehicle: Vehicle) -> Counter[str]:
    """Numbers of the rules that cppcheck finds broken, and how often, in an SPI and a cascade of filters."""
    found: Counter[str] = Counter()
    for name in ("SPI", SHOWN[0]):
        with tempfile.TemporaryDirectory() as place:
            sources = written(vehicle, name, Path(place), single=False)
            model = Path(place) / "model.c"
            if model.exists():
                model.write_text(shortened(model.read_text(encoding="utf-8")), encoding="utf-8")
                subprocess.run(["gcc", "-std=c99", "-fsyntax-only", *map(str, sources)], check=True)
            command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", *map(str, sources)]
            said = subprocess.run(command, capture_output=True, text=True, cwd=place).stderr
        places = re.findall(r"^(\S+?:\d+:\d+): .*\[misra-c2012-([\d.]+)\]$", said, re.MULTILINE)
        found.update(rule for _, rule in set(places))
    return found


def deviations() -> set[str]:
    """The rules from which the page states a deviation with its reason."""
    return set(re.findall(r"^\| (\d+\.\d+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE))


def table(found: dict[str, dict[str, Size]]) -> str:
    """Sizes as a table of the page."""
    compilers = list(next(iter(found.values())))
    lines = ["| export | " + " | ".join(f"{name}: code, stack" for name in compilers) + " |"]
    lines.append("| --- |" + " --- |" * len(compilers))
    for name, by_compiler in found.items():
        cells = (f"{one.code / 1024:.0f} kB, {(one.stack or 0) / 1024:.1f} kB" for one in by_compiler.values())
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    vehicle = load_vehicle(vehicle_path(sys.argv[1] if len(sys.argv) > 1 else "prototype_model"))
    found = sizes(vehicle)
    both = two_in_one(vehicle)
    print(table(found))
    print(f"two exports in one program: {'each has its own car' if both else 'wrong'}")
    content: dict[str, object] = {
        "two_in_one": both,
        "sizes": {name: {k: vars(one) for k, one in row.items()} for name, row in found.items()},
    }
    if SMALLEST in found["SPI, double"]:
        content["spi_kb"] = round(found["SPI, double"][SMALLEST].code / 1024)
    if shutil.which("cppcheck"):
        broken, allowed = findings(vehicle), deviations()
        still_open = {rule: count for rule, count in sorted(broken.items()) if rule not in allowed}
        count = sum(still_open.values())
        print(f"MISRA C:2012: {sum(broken.values())} findings, {count} without a deviation: {still_open}")
        if unused := sorted(allowed - set(broken)):
            print(f"deviations that nothing needs: {', '.join(unused)}")
        content |= {"misra_open": count, "misra_findings": dict(sorted(broken.items()))}
    page = PAGE.read_text(encoding="utf-8")
    before, after = page.split(BEGIN)[0], page.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n{table(found)}\n{END}{after}", encoding="utf-8")
    (ROOT / "out").mkdir(exist_ok=True)
    (ROOT / "out" / "exports.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
