"""What cocotb runs within the simulator, for one unit: the one that is on top."""

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge
from cocotb_units import UNITS, operands

from vsense_ros.accelerator import float32

OPERATIONS = {"fp32_mul": float32.multiply, "fp32_add": float32.add, "fp32_div": float32.divide}


@cocotb.test()
async def one_result_a_clock_each_as_the_mock_has_it(dut):
    name = dut._name
    a, b = operands(500)
    x, y = (float32.flushed(words.view(np.float32)) for words in (a, b))
    expected = float32.canonical(OPERATIONS[name](x, y))
    Clock(dut.clk, 10, unit="ns").start()
    latency, found = UNITS[name], []
    for i in range(len(a) + latency):
        await FallingEdge(dut.clk)
        if i >= latency:
            found.append(int(dut.y.value))
        if i < len(a):
            dut.a.value, dut.b.value = int(a[i]), int(b[i])
    wrong = np.flatnonzero(np.array(found, np.uint32) != expected)
    assert not wrong.size, f"{wrong.size} of {len(a)}: {a[wrong[0]]:08x}, {b[wrong[0]]:08x} gave {found[wrong[0]]:08x}"
