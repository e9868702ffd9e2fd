"""What cocotb runs within the simulator for body_mass behind its registers, with bus models of cocotbext-axi."""

import random

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiStreamBus, AxiStreamFrame, AxiStreamSink, AxiStreamSource

from vsense_ros.accelerator.kernels import BODY_MASS
from vsense_ros.accelerator.registers import REGISTERS, values

AT = {register.name: register.offset for register in REGISTERS}
START, ABORT = 1, 1 << 16


async def started(dut):
    """Bus models around hardware that was reset for one clock: before it, nothing has a value."""
    Clock(dut.clk, 10, unit="ns").start()
    dut.rst_n.value = 0
    await ClockCycles(dut.clk, 2)
    bench = Bench(dut)
    await bench.reset(1)
    return bench


class Bench:
    def __init__(self, dut):
        reset = {"reset": dut.rst_n, "reset_active_level": False}
        self.dut = dut
        self.bus = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi"), dut.clk, **reset)
        self.source = AxiStreamSource(AxiStreamBus.from_prefix(dut, "s"), dut.clk, byte_lanes=1, **reset)
        self.sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, "m"), dut.clk, byte_lanes=1, **reset)

    async def reset(self, clocks):
        self.dut.rst_n.value = 0
        await ClockCycles(self.dut.clk, clocks)
        self.source.clear()  # the DMA is reset, too
        self.sink.clear()
        self.dut.rst_n.value = 1
        await ClockCycles(self.dut.clk, 2)

    async def read(self, name):
        return await self.bus.read_dword(AT[name])

    async def write(self, name, value):
        await self.bus.write_dword(AT[name], value)

    async def run(self, words):
        await self.write("CONTROL", START)
        await self.source.send(AxiStreamFrame([int(word) for word in words]))
        frame = await with_timeout(self.sink.recv(), 100, "us")
        return np.array(frame.tdata, np.uint32)


def request(seed):
    return np.random.default_rng(seed).normal(0, 1, 19).astype(np.float32).view(np.uint32)


def gaps(seed):
    choose = random.Random(seed)
    while True:
        yield choose.random() < 0.5


@cocotb.test()
async def constants_are_those_of_the_kernel(dut):
    bench = await started(dut)
    for name, value in values(BODY_MASS).items():
        assert await bench.read(name) == value, name


@cocotb.test()
async def results_are_the_mocks_under_gaps_and_back_pressure(dut):
    bench = await started(dut)
    bench.source.set_pause_generator(gaps(1))
    bench.sink.set_pause_generator(gaps(2))
    for seed in range(20):
        assert np.array_equal(await bench.run(request(seed)), BODY_MASS.run(request(seed))[0])
    assert await bench.read("REQUESTS") == 20


@cocotb.test()
async def wrong_and_aborted_packets_are_not_mixed_with_good_ones(dut):
    bench = await started(dut)
    for k, length in enumerate((1, 18, 20, 33)):
        await bench.write("CONTROL", START)
        await bench.source.send(AxiStreamFrame(list(range(length))))
        await bench.source.wait()
        assert np.array_equal(await bench.run(request(k)), BODY_MASS.run(request(k))[0])
    assert await bench.read("MALFORMED") == 4
    await bench.write("CONTROL", START)
    bench.source.set_pause_generator(i > 9 and i < 60 for i in range(10**6))
    await bench.source.send(AxiStreamFrame([int(word) for word in request(9)]))
    await ClockCycles(dut.clk, 12)
    await bench.write("CONTROL", ABORT)
    assert np.array_equal(await bench.run(request(10)), BODY_MASS.run(request(10))[0])
    assert await bench.read("ABORTED") == 1
    assert await bench.read("REQUESTS") == 5


@cocotb.test()
async def a_reset_of_any_length_at_any_clock_leaves_the_next_result_right(dut):
    bench = await started(dut)
    choose = random.Random(3)
    for k in range(20):
        await bench.write("CONTROL", START)
        await bench.source.send(AxiStreamFrame([int(word) for word in request(k)]))
        await ClockCycles(dut.clk, choose.randrange(60))
        await bench.reset(choose.choice([1, 2, 3, 8, 12]))
        assert np.array_equal(await bench.run(request(100 + k)), BODY_MASS.run(request(100 + k))[0])
