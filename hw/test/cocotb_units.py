"""Tests in Icarus by cocotb: the arithmetic units, and a kernel behind its registers with models of its buses.

python hw/test/cocotb_units.py
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
UNITS = {"fp32_mul": 5, "fp32_add": 6, "fp32_div": 16}
SPECIAL = [0, 0x80000000, 0x7F800000, 0xFF800000, 0x7FC00000, 0x3F800000, 0xBF800000, 0x00800000, 0x7F7FFFFF, 1]


def operands(count):
    """Pairs of words: every pair of special numbers, any bits, numbers of like size, numbers that nearly cancel."""
    random = np.random.default_rng(1)
    a, b = (x.ravel() for x in np.meshgrid(SPECIAL, SPECIAL))
    any_bits = random.integers(0, 2**32, (2, count), dtype=np.uint32)
    alike = random.integers(0x3C000000, 0x43000000, (2, count), dtype=np.uint32)
    near = random.integers(0x3F000000, 0x41000000, count, dtype=np.uint32)
    opposite = (near + random.integers(0, 9, count, dtype=np.uint32) - 4) ^ np.uint32(0x80000000)
    first = np.concatenate([a, any_bits[0], alike[0], near]).astype(np.uint32)
    second = np.concatenate([b, any_bits[1], alike[1], opposite]).astype(np.uint32)
    return first, second


def simulate(name, files, module, top, parameters):
    """Build a module and run the tests of a Python module on it; says how many there were, and whether all passed."""
    from cocotb_tools.runner import get_results, get_runner

    runner = get_runner("icarus")
    place = Path("out/cocotb").resolve() / name
    options = {"hdl_toplevel": top, "build_dir": place, "parameters": parameters}
    runner.build(sources=files, timescale=("1ns", "1ps"), always=True, **options)
    results = runner.test(test_module=module, test_dir=HERE, results_xml=str(place / "results.xml"), **options)
    tests, failed = get_results(results)
    print(f"{name}: {tests} tests, {failed} failed")
    return tests > 0 and failed == 0


def main():
    from vsense_ros.accelerator.rtl import sources

    passed = [simulate(unit, [sources() / f"{unit}.sv"], "units_by_cocotb", unit, {}) for unit in UNITS]
    control = [
        HERE.parent / "control" / f"{name}.sv" for name in ("register_map", "chosen_kernel", "controlled_kernel")
    ]
    files = [*control, *sorted(sources().glob("*.sv"))]
    for name, tests, number in (("body_mass", "control_by_cocotb", 3), ("row_combiner", "programs_by_cocotb", 5)):
        passed.append(simulate(f"{name}_controlled", files, tests, "controlled_kernel", {"NUMBER": number}))
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
