"""A kernel behind its registers, as a processor and its DMA see it."""

from __future__ import annotations

import ctypes
import os
import runpy
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from linear_systems import mass_matrices, tables
from marks import exam_except
from test_uio import PHYSICAL, Hardware
from vsense_ros.accelerator.frame import Status
from vsense_ros.accelerator.kernels import BODY_MASS, SOLVE_14, SUSPENSION_MOTION
from vsense_ros.accelerator.kernels.row_combiner import Program, RowCombiner
from vsense_ros.accelerator.registers import REGISTERS, Registered, registered, values
from vsense_ros.accelerator.rtl import missing, sources
from vsense_ros.accelerator.uio import Uio
from vsense_ros.cache import kept
from vsense_ros.messages import yaml_text

HW = Path(__file__).parents[2] / "hw"
AT = {register.name: register.offset for register in REGISTERS}
BIT = {f"{r.name}.{f.name}": 1 << f.lowest for r in REGISTERS for f in r.fields}
simulated = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(missing()), reason=f"needs {', '.join(missing())}: make hw-tools"),
]


def test_what_is_made_of_the_list_of_registers_is_up_to_date() -> None:
    for path, text in runpy.run_path(str(HW / "registers.py"))["written"]().items():
        assert path.read_text(encoding="utf-8") == text, f"{path}: run python hw/registers.py"


def test_the_block_for_fusesoc_has_every_file_and_every_kernel() -> None:
    core = yaml_text.load_file(HW / "vsense_ros.core")
    listed = core["filesets"]["rtl"]["files"]
    there = {f"{path.parent.name}/{path.name}" for path in (*HW.glob("rtl/*.sv"), *HW.glob("control/*.sv"))}
    assert set(listed) == there
    (description,) = (
        line for line in (HW / "vsense_ros.core").read_text().splitlines() if "NUMBER is the kernel" in line
    )
    assert all(f"{number} {kernel.name}" in description for number, kernel in registered().items())


def test_registers_are_words_that_do_not_overlap_and_begin_as_those_of_high_level_synthesis() -> None:
    offsets = [register.offset for register in REGISTERS]
    assert offsets == list(range(0, 4 * len(offsets), 4))
    names = ["CONTROL", "GLOBAL_INTERRUPT", "INTERRUPT_ENABLE", "INTERRUPT_STATUS"]  # UG1399: AP_CTRL, GIER, IER, ISR
    assert [r.name for r in REGISTERS[:4]] == names
    control = {f.name: f.lowest for f in REGISTERS[0].fields}
    assert control | {"start": 0, "done": 1, "idle": 2, "ready": 3, "auto_restart": 7} == control
    for register in REGISTERS:
        masks = [((1 << f.width) - 1) << f.lowest for f in register.fields]
        assert sum(masks) == np.bitwise_or.reduce(masks) if masks else True


class Controlled:
    """A kernel behind its registers in Verilator."""

    def __init__(self, library: Path, kernel: Registered) -> None:
        self.kernel = kernel
        self._of = ctypes.CDLL(str(library))
        self._of.kernel_new.restype = ctypes.c_void_p
        self._of.kernel_read.restype = ctypes.c_uint32
        self._it = ctypes.c_void_p(self._of.kernel_new())

    def write(self, name: str, value: int, order: int = 0) -> None:
        self._of.kernel_write(self._it, AT[name], value, order)

    def read(self, name: str) -> int:
        return int(self._of.kernel_read(self._it, AT[name]))

    def offer(self, words: np.ndarray, clocks: int = 100_000, every: int = 1, last: int | None = None) -> int:
        """How many words were taken. `last` is the one that is marked: -1 for none, the last one where it is None."""
        given = np.ascontiguousarray(words, np.uint32)
        pointer, last = ctypes.c_void_p(given.ctypes.data), given.size - 1 if last is None else last
        return int(self._of.kernel_offer(self._it, pointer, given.size, clocks, every, last))

    def wait(self, clocks: int) -> None:
        self._of.kernel_clocks(self._it, clocks)

    def reset(self, clocks: int) -> None:
        self._of.kernel_reset(self._it, clocks)

    def collect(self, every: int = 1, count: int = 0) -> tuple[np.ndarray, int]:
        found, last = np.zeros(count or self.kernel.words_out, np.uint32), ctypes.c_int()
        pointer = ctypes.c_void_p(found.ctypes.data)
        came = self._of.kernel_collect(self._it, pointer, found.size, 100_000, every, ctypes.byref(last))
        return found[:came], last.value

    @property
    def interrupts(self) -> bool:
        return bool(self._of.kernel_irq(self._it))

    def run(self, words: np.ndarray, count: int = 0) -> np.ndarray:
        self.write("CONTROL", BIT["CONTROL.start"])
        assert self.offer(words) == words.size
        found, last = self.collect(count=count)
        assert last == found.size - 1
        return found


@pytest.fixture(scope="module")
def built() -> Callable[[Registered], Controlled]:
    """Makes a kernel with its registers, which is compiled where no earlier run has kept it."""
    files = [HW / "control" / f"{name}.sv" for name in ("register_map", "chosen_kernel", "controlled_kernel")]
    files += sorted(sources().glob("*.sv"))
    wrapper = HW / "test" / "controlled_kernel.cpp"
    version = subprocess.run(["verilator", "--version"], capture_output=True, text=True, check=True).stdout
    root = subprocess.run(["verilator", "--getenv", "VERILATOR_ROOT"], check=True, capture_output=True, text=True)

    def build(kernel: Registered) -> Controlled:
        translate = [
            "verilator", "--cc", "-O3", "--noassert", "-Wno-fatal", "-Wno-WIDTH", "--top-module", "controlled_kernel",
            f"-GNUMBER={kernel.number}", *map(str, files),
        ]  # fmt: skip
        objects = ["Vcontrolled_kernel__ALL.a", "verilated.o", "verilated_threads.o"]
        options = ["OPT_FAST=-O1 -fPIC", "OPT_SLOW=-fPIC", "OPT_GLOBAL=-O1 -fPIC"]
        compile_parts = ["make", "-s", "-f", "Vcontrolled_kernel.mk", *options, *objects]
        include = root.stdout.strip() + "/include"
        link = ["g++", "-shared", "-fPIC", "-O1", "-std=c++17", "-Iobj_dir", f"-I{include}", f"-I{include}/vltstd"]
        link += [str(wrapper), *(f"obj_dir/{name}" for name in objects), "-o", "kernel.so", "-lpthread"]

        def make(place: Path) -> Path:
            for command, folder in ((translate, place), (compile_parts, place / "obj_dir"), (link, place)):
                subprocess.run(command, cwd=folder, check=True, capture_output=True)
            return place / "kernel.so"

        texts = [file.read_text(encoding="utf-8") for file in (*files, wrapper)]
        content = [version, str(kernel.number), *objects, *options, *texts]
        return Controlled(kept(f"registers-{kernel.name}", content, make), kernel)

    return build


class Registers:
    """The registers of a kernel in Verilator, as the driver of Linux maps them."""

    def __init__(self, here: Controlled) -> None:
        self.here = here

    def __getitem__(self, word: int) -> int:
        return self.here.read(REGISTERS[word].name)

    def __setitem__(self, word: int, value: int) -> None:
        self.here.write(REGISTERS[word].name, value)


class Dma:
    """The registers of its DMA, which is as fast as the kernel; one that `loses` words sends the first 20."""

    def __init__(self, here: Controlled, files: Hardware) -> None:
        self.here, self.files, self.written, self.loses = here, files, dict[int, int](), False

    def __getitem__(self, word: int) -> int:
        return {0x34 // 4: 2, 0x58 // 4: self.written.get(word, 0)}.get(word, 0)  # the result is in memory

    def __setitem__(self, word: int, value: int) -> None:
        self.written[word] = value
        if word != 0x28 // 4:
            return
        memory = np.frombuffer(self.files.memory, np.uint32)
        first, at = ((self.written[address // 4] - PHYSICAL) // 4 for address in (0x18, 0x48))
        words = memory[first : first + value // 4]
        if self.loses:
            self.here.offer(words[:20], last=-1)
        else:
            self.here.offer(words)
            memory[at : at + self.here.kernel.words_out] = self.here.collect()[0]
        if self.here.interrupts:
            os.write(self.files.ours, (1).to_bytes(4, "little"))


def system(seed: int = 1) -> np.ndarray:
    matrix = mass_matrices(1, seed)[0]
    right = np.random.default_rng(seed).normal(0, 1000, 14)
    return np.hstack([matrix, right[:, None]]).astype(np.float32).reshape(-1).view(np.uint32)


class TestSimulated:
    pytestmark = simulated

    @pytest.mark.parametrize(
        "kernel", exam_except([SOLVE_14, BODY_MASS, SUSPENSION_MOTION], SOLVE_14), ids=lambda k: k.name
    )
    def test_a_kernel_tells_what_it_is(self, built, kernel: Registered) -> None:
        here = built(kernel)
        assert {name: here.read(name) for name in values(kernel)} == values(kernel)
        assert here.read("CONTROL") == BIT["CONTROL.idle"]

    def test_the_driver_of_linux_has_the_bits_of_the_mock_also_after_a_request_that_was_cut_off(
        self, built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        files, here, given = Hardware(tmp_path, SOLVE_14), built(SOLVE_14), [system(k) for k in range(4)]
        driver, dma = Uio(files.places), Dma(here, files)
        monkeypatch.setattr(driver, "_registers", Registers(here))
        monkeypatch.setattr(driver, "_dma", dma)
        for k in (0, 1):
            assert np.array_equal(driver.run(given[k], driver.now() + 5), SOLVE_14.run(given[k])[0])
        assert driver.counters()["REQUESTS"] == 2
        dma.loses = True
        with pytest.raises(TimeoutError, match="no interrupt"):
            driver.run(given[2], driver.now() + 0.05)
        dma.loses = False
        assert np.array_equal(driver.run(given[3], driver.now() + 5), SOLVE_14.run(given[3])[0])
        assert driver.counters()["REQUESTS"] == 1  # since the reset
        driver.close()

    def test_a_request_gives_the_bits_of_the_mock_and_is_counted(self, built) -> None:
        here = built(SOLVE_14)
        for k in range(3):
            words = system(k)
            expected, _ = SOLVE_14.run(words)
            assert np.array_equal(here.run(words), expected)
            assert here.read("STATUS") == Status.OK
            assert here.read("COMPUTE_CYCLES") == SOLVE_14.cycles()
            assert here.read("REQUESTS") == k + 1
            # Nothing made the stream wait but the handshakes between request, kernel and result.
            assert 0 <= here.read("LINK_CYCLES") - SOLVE_14.words_in - SOLVE_14.words_out < 8

    def test_no_word_is_taken_without_a_start_and_none_too_many_with_one(self, built) -> None:
        here, words = built(BODY_MASS), np.arange(60, dtype=np.uint32)
        assert here.offer(words, clocks=100) == 0
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(words, clocks=1000, last=BODY_MASS.words_in - 1) == BODY_MASS.words_in
        assert here.offer(words, clocks=1000) == 0

    def test_done_and_ready_are_cleared_by_reading(self, built) -> None:
        here = built(BODY_MASS)
        here.write("CONTROL", BIT["CONTROL.start"])
        assert not here.read("CONTROL") & BIT["CONTROL.idle"]
        here.offer(np.ones(19, np.float32).view(np.uint32))
        assert here.read("CONTROL") == BIT["CONTROL.ready"]
        here.collect()
        assert here.read("CONTROL") == BIT["CONTROL.done"] | BIT["CONTROL.idle"]
        assert here.read("CONTROL") == BIT["CONTROL.idle"]

    def test_a_pivot_that_is_refused_is_told_and_forgotten_with_the_next_system(self, built) -> None:
        here = built(SOLVE_14)
        here.run(np.zeros(210, np.uint32))
        assert here.read("STATUS") == Status.PIVOT
        here.run(system())
        assert here.read("STATUS") == Status.OK

    def test_an_interrupt_comes_where_it_is_enabled_and_goes_when_it_is_written_back(self, built) -> None:
        here = built(BODY_MASS)
        words = np.ones(19, np.float32).view(np.uint32)
        here.run(words)
        assert not here.interrupts
        assert here.read("INTERRUPT_STATUS") == BIT["INTERRUPT_STATUS.done"] | BIT["INTERRUPT_STATUS.ready"]
        here.write("INTERRUPT_STATUS", 3)
        here.write("INTERRUPT_ENABLE", BIT["INTERRUPT_ENABLE.done"])
        here.write("GLOBAL_INTERRUPT", 1)
        assert not here.interrupts
        here.run(words)
        assert here.interrupts
        here.write("INTERRUPT_STATUS", BIT["INTERRUPT_STATUS.done"])
        assert not here.interrupts

    @pytest.mark.exam
    def test_coefficients_are_taken_in_their_mode_and_kept(self, built) -> None:
        here, table = built(SUSPENSION_MOTION), tables()
        here.write("MODE", BIT["MODE.table"])
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(table) == table.size
        assert here.read("CONTROL") & BIT["CONTROL.done"]
        here.write("MODE", 0)
        words = np.random.default_rng(3).uniform(-1, 1, 12).astype(np.float32).view(np.uint32)
        expected, _ = SUSPENSION_MOTION.run(words, table)
        for _ in range(2):
            assert np.array_equal(here.run(words), expected)

    @pytest.mark.parametrize("order", [0, 1, 2])
    def test_address_and_data_of_a_write_may_come_in_any_order(self, built, order: int) -> None:
        here = built(BODY_MASS)
        here.write("INTERRUPT_ENABLE", 2, order)
        assert here.read("INTERRUPT_ENABLE") == 2

    def test_a_stream_that_stops_and_goes_changes_no_bit(self, built) -> None:
        here, words = built(SOLVE_14), system(4)
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(words, every=3) == words.size
        found, _ = here.collect(every=4)
        assert np.array_equal(found, SOLVE_14.run(words)[0])

    def test_what_repeats_itself_takes_the_next_request_at_once(self, built) -> None:
        here = built(BODY_MASS)
        here.write("CONTROL", BIT["CONTROL.start"] | BIT["CONTROL.auto_restart"])
        words = np.ones(19, np.float32).view(np.uint32)
        for _ in range(3):
            assert here.offer(words) == 19
            assert here.collect()[0].size == 9
        here.write("CONTROL", 0)
        assert here.read("REQUESTS") == 3

    @pytest.mark.parametrize("length", [1, 5, 18, 20, 40])
    def test_a_packet_of_a_wrong_length_gives_no_result_and_spoils_no_other(self, built, length: int) -> None:
        here, random = built(BODY_MASS), np.random.default_rng(length)
        given = random.normal(0, 1, 19).astype(np.float32).view(np.uint32)
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(random.integers(0, 2**32, length, dtype=np.uint32)) == length
        assert here.read("CONTROL") & BIT["CONTROL.done"]
        assert (here.read("STATUS"), here.read("MALFORMED"), here.read("REQUESTS")) == (Status.WRONG_SIZE, 1, 0)
        assert np.array_equal(here.run(given), BODY_MASS.run(given)[0])
        assert (here.read("STATUS"), here.read("REQUESTS")) == (Status.OK, 1)

    @pytest.mark.parametrize("taken", [0, 1, 100, 209])
    def test_a_request_that_is_given_up_is_not_mixed_with_the_next(self, built, taken: int) -> None:
        here, given, next_ = built(SOLVE_14), system(5), system(6)
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(given[:taken], last=-1) == taken
        here.write("CONTROL", BIT["CONTROL.abort"])
        here.write("CONTROL", BIT["CONTROL.start"])  # waits until the rest of the packet has been dropped
        if taken:
            assert here.offer(given[taken:]) == 210 - taken
        assert here.read("ABORTED") == 1
        assert here.read("STATUS") == Status.FAULT
        assert here.offer(next_) == 210
        assert np.array_equal(here.collect()[0], SOLVE_14.run(next_)[0])
        assert (here.read("STATUS"), here.read("REQUESTS"), here.read("MALFORMED")) == (Status.OK, 1, 0)

    def test_a_computation_is_given_up_and_a_result_that_leaves_is_not(self, built) -> None:
        here, given = built(SOLVE_14), system(7)
        here.write("CONTROL", BIT["CONTROL.start"])
        here.offer(given)
        here.wait(100)
        here.write("CONTROL", BIT["CONTROL.abort"])
        here.wait(4)
        assert here.read("CONTROL") == BIT["CONTROL.done"] | BIT["CONTROL.idle"] | BIT["CONTROL.ready"]
        assert here.read("ABORTED") == 1
        here.write("CONTROL", BIT["CONTROL.start"])
        here.offer(given)
        here.wait(600)  # the result waits for its reader
        here.write("CONTROL", BIT["CONTROL.abort"])
        assert np.array_equal(here.collect()[0], SOLVE_14.run(given)[0])
        assert (here.read("ABORTED"), here.read("REQUESTS")) == (1, 1)

    def test_a_soft_reset_at_any_time_leaves_registers_as_after_a_reset_and_the_next_result_right(self, built) -> None:
        here, given, next_ = built(SOLVE_14), system(8), system(9)
        for clocks in (0, 1, 50, 209, 215, 300, 500, 560):
            here.write("INTERRUPT_ENABLE", 3)
            here.write("CONTROL", BIT["CONTROL.start"] | BIT["CONTROL.auto_restart"])
            here.offer(given, clocks=clocks)
            here.wait(max(clocks - 210, 0))
            here.write("CONTROL", BIT["CONTROL.soft_reset"])
            here.wait(1)
            changing = [r.name for r in REGISTERS if r.name not in values(SOLVE_14)]
            assert {name: here.read(name) for name in changing} == {
                name: BIT["CONTROL.idle"] if name == "CONTROL" else 0 for name in changing
            }
            assert np.array_equal(here.run(next_), SOLVE_14.run(next_)[0])

    @pytest.mark.parametrize("length", [1, 2, 3, 5, 8, 12])
    def test_a_reset_of_any_length_at_any_clock_leaves_the_next_result_right(self, built, length: int) -> None:
        here, random = built(SOLVE_14), np.random.default_rng(length)
        for k in range(25):
            given = system(k)
            here.write("CONTROL", BIT["CONTROL.start"])
            here.offer(given)
            here.wait(int(random.integers(0, 345)))
            here.reset(length)
            again = system(100 + k)
            assert np.array_equal(here.run(again), SOLVE_14.run(again)[0])
            assert here.read("STATUS") == Status.OK

    @pytest.mark.exam
    @pytest.mark.parametrize("way", ["reset", "abort"])
    def test_coefficients_that_came_in_part_are_not_used(self, built, way: str) -> None:
        here, table = built(SUSPENSION_MOTION), tables()
        words = np.random.default_rng(3).uniform(-1, 1, 12).astype(np.float32).view(np.uint32)
        assert np.all(here.run(words) == 0x7FC00000)  # none came yet
        assert here.read("STATUS") == Status.FAULT
        here.write("MODE", BIT["MODE.table"])
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(table[:564], last=-1) == 564
        if way == "reset":
            here.reset(1)
        else:
            here.write("CONTROL", BIT["CONTROL.abort"])
            here.write("MODE", 0)
            here.write("CONTROL", BIT["CONTROL.start"])
            results = here.read("REQUESTS")
            assert here.offer(table[564:]) == 12  # as many words as a request has
            here.wait(400)
            assert here.read("REQUESTS") == results
            here.write("CONTROL", BIT["CONTROL.abort"])
        here.write("MODE", 0)
        assert np.all(here.run(words) == 0x7FC00000)
        assert here.read("STATUS") == Status.FAULT
        here.write("MODE", BIT["MODE.table"])
        here.write("CONTROL", BIT["CONTROL.start"])
        assert here.offer(table) == table.size
        here.write("MODE", 0)
        assert np.array_equal(here.run(words), SUSPENSION_MOTION.run(words, table)[0])
        assert here.read("STATUS") == Status.OK


def programs(random: np.random.Generator) -> tuple[Program, Program]:
    """One that writes a matrix, and one that changes it and asks for some of its rows."""
    first, second = Program(20), Program(20)
    first.write(0, random.standard_normal((20, 20)))
    second.combine(64, random.standard_normal((3, 5)), random.integers(0, 20, 3))
    second.subtract_outer(64, 4)
    return first, second


@pytest.mark.exam
class TestPrograms:
    pytestmark = simulated

    def test_programs_of_any_length_have_the_mocks_bits_and_clocks_and_find_what_the_last_one_left(self, built) -> None:
        here, mock, random = built(RowCombiner), RowCombiner(), np.random.default_rng(1)
        assert {name: here.read(name) for name in values(RowCombiner)} == values(RowCombiner)
        for count in (0, 1, 20):
            for program in programs(random):
                words = program.end(0, count)
                expected = mock.run(words)
                assert np.array_equal(here.run(words, program.words_out), expected)
                assert here.read("COMPUTE_CYCLES") == expected[-1]
        assert (here.read("REQUESTS"), here.read("STATUS")) == (6, Status.OK)

    @pytest.mark.parametrize("way", ["cut", "unmarked", "aborted"])
    def test_a_program_that_is_cut_or_given_up_gives_no_result_and_the_next_is_right(self, built, way: str) -> None:
        here, mock, random = built(RowCombiner), RowCombiner(), np.random.default_rng(2)
        wrong = programs(random)[1].end(0, 3)
        before = here.read("REQUESTS")
        here.write("CONTROL", BIT["CONTROL.start"])
        if way == "cut":  # its end is missing
            assert here.offer(wrong[:-3]) == wrong.size - 3
        elif way == "unmarked":  # words follow its end
            assert here.offer(np.append(wrong, wrong[:5])) == wrong.size + 5
        else:
            assert here.offer(wrong[:10], last=-1) == 10  # amid the terms
            here.write("CONTROL", BIT["CONTROL.abort"])
            assert here.offer(wrong[10:]) == wrong.size - 10
        assert here.read("STATUS") == (Status.FAULT if way == "aborted" else Status.WRONG_SIZE)
        for program in programs(random):
            words = program.end(0, 20)
            assert np.array_equal(here.run(words, program.words_out), mock.run(words))
        assert here.read("REQUESTS") == before + 2

    def test_a_number_that_is_infinite_is_said(self, built) -> None:
        here, program = built(RowCombiner), Program(3)
        program.write(0, [[1.0, 2.0, np.inf]])
        here.run(program.end(), 1)
        assert here.read("STATUS") == Status.PIVOT

    def test_numbers_beyond_the_columns_of_a_program_are_none_of_its(self, built) -> None:
        """Rows are kept in slots of 16 columns: a program of 20 has some of those that one of 40 has left infinite."""
        here, random, wide, narrow = built(RowCombiner), np.random.default_rng(4), Program(40), Program(20)
        wide.write(0, np.full((RowCombiner.ROWS, 40), np.inf))
        here.run(wide.end(), 1)
        assert here.read("STATUS") == Status.PIVOT
        narrow.write(0, random.standard_normal((RowCombiner.ROWS, 20)))
        narrow.combine(64, random.standard_normal((3, 5)), random.integers(0, 20, 3))
        narrow.subtract_outer(64, 4)
        narrow.move(66, 3, 1)
        narrow.move(67, 7, 1, column=True)
        narrow.add([1, 19], [2, 19], [0.5, 0.25])
        found = here.run(narrow.end(0, 20), narrow.words_out)
        assert np.all(np.isfinite(found[:-1].view(np.float32)))
        assert here.read("STATUS") == Status.OK
