"""The arithmetic units in Icarus, by cocotb: latency, one result a clock, rounding, special numbers.

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


def main():
    from cocotb_tools.runner import get_runner

    from vsense_ros.accelerator.rtl import sources

    for unit in UNITS:
        runner = get_runner("icarus")
        place = Path("out/cocotb").resolve() / unit
        files = [sources() / f"{unit}.sv"]
        runner.build(sources=files, hdl_toplevel=unit, build_dir=place, timescale=("1ns", "1ps"), always=True)
        results = runner.test(
            hdl_toplevel=unit,
            test_module="units_by_cocotb",
            build_dir=place,
            test_dir=HERE,
            results_xml=str(place / "results.xml"),
        )
        from cocotb_tools.runner import get_results

        tests, failed = get_results(results)
        print(f"{unit}: {tests} tests, {failed} failed")
        if failed or not tests:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
