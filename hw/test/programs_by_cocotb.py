"""What cocotb runs within the simulator for the row combiner behind its registers: programs of any length."""

import cocotb
import numpy as np
from cocotb.triggers import with_timeout
from cocotbext.axi import AxiStreamFrame
from control_by_cocotb import START, gaps, started

from vsense_ros.accelerator.kernels.row_combiner import Program, RowCombiner
from vsense_ros.accelerator.registers import values


def programs(seed):
    """One that writes a matrix, and one that changes it; of each the words."""
    random = np.random.default_rng(seed)
    first, second = Program(18), Program(18)
    first.write(0, random.standard_normal((18, 18)))
    second.combine(64, random.standard_normal((2, 3)), random.integers(0, 18, 2))
    second.subtract_outer(64, 2)
    return [first.end(0, 1), second.end(0, 18)]


async def run(bench, words):
    await bench.write("CONTROL", START)
    await bench.source.send(AxiStreamFrame([int(word) for word in words]))
    frame = await with_timeout(bench.sink.recv(), 200, "us")
    return np.array(frame.tdata, np.uint32)


@cocotb.test()
async def answers_are_the_mocks_under_gaps_and_back_pressure(dut):
    bench, mock = await started(dut), RowCombiner()
    for name, value in values(RowCombiner).items():
        assert await bench.read(name) == value, name
    for words in programs(1):
        assert np.array_equal(await run(bench, words), mock.run(words))
    bench.source.set_pause_generator(gaps(1))
    bench.sink.set_pause_generator(gaps(2))
    for words in programs(2):  # the clocks, last, have gaps in them
        assert np.array_equal((await run(bench, words))[:-1], mock.run(words)[:-1])
    assert await bench.read("REQUESTS") == 4


@cocotb.test()
async def a_program_without_its_end_or_with_words_behind_it_gives_no_answer(dut):
    bench, mock = await started(dut), RowCombiner()
    for words in programs(3):
        mock.run(words)
        for wrong in (words[:-1], np.append(words, words[:3]), words[:1]):
            await bench.write("CONTROL", START)
            await bench.source.send(AxiStreamFrame([int(word) for word in wrong]))
            await bench.source.wait()
    assert await bench.read("MALFORMED") == 6
    for words in programs(4):
        assert np.array_equal(await run(bench, words), mock.run(words))
