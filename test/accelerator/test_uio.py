"""The driver of a kernel in a Zynq, with files and a thread that stand for the hardware."""

from __future__ import annotations

import mmap
import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from linear_systems import mass_matrices, prototype, tables
from vsense_ros.accelerator.client import Client
from vsense_ros.accelerator.covariance import AcceleratedCovariance
from vsense_ros.accelerator.frame import Status
from vsense_ros.accelerator.kernels import BODY_MASS, SOLVE_14, SUSPENSION_MOTION, Kernel
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner
from vsense_ros.accelerator.registers import REGISTERS, Registered, values
from vsense_ros.accelerator.uio import Places, Several, Uio
from vsense_ros.errors import InputError

AT = {register.name: register.offset // 4 for register in REGISTERS}
START, IDLE, SOFT_RESET, PHYSICAL = 1, 4, 0x20000, 0x1E900000


class Hardware:
    """The registers of a kernel and of its DMA, in files: what `hw/README.md` and PG021 say, with the mock's bits."""

    def __init__(self, folder: Path, kernel: Registered, *, size: int = 16384, answers: bool = True) -> None:
        self.kernel, self.answers, self.resets = kernel, answers, 0
        self.lost = 0  # bytes of a result that do not come
        self.table: np.ndarray | None = None
        (folder / "phys_addr").write_text(f"{PHYSICAL:#x}\n")
        (folder / "size").write_text(f"{size}\n")
        self.ours, theirs = os.openpty()
        tty.setraw(theirs)
        self.places = Places(folder / "uio0", folder / "uio1", folder / "udmabuf0", folder, Path(os.ttyname(theirs)))
        sizes = {self.places.registers: mmap.PAGESIZE, self.places.dma: mmap.PAGESIZE, self.places.buffer: size}
        self.registers, self.dma, self.memory = (self.file(path, length) for path, length in sizes.items())
        for name, value in values(kernel).items():
            self.registers[AT[name]] = value
        self.registers[AT["CONTROL"]] = IDLE
        self.ends, self.thread = threading.Event(), threading.Thread(target=self.work, daemon=True)

    @staticmethod
    def file(path: Path, length: int) -> memoryview:
        path.write_bytes(bytes(length))
        with path.open("r+b") as file:
            return memoryview(mmap.mmap(file.fileno(), length)).cast("I")

    def work(self) -> None:
        while not self.ends.wait(2e-5):
            control = self.registers[AT["CONTROL"]]
            if control & SOFT_RESET:
                self.resets += 1
                self.registers[AT["CONTROL"]], self.dma[0] = IDLE, 0
            elif control & START and self.dma[0x28 // 4] and self.answers:
                self.request()

    def request(self) -> None:
        of, dma, kernel = self.registers, self.dma, self.kernel
        assert isinstance(kernel, Kernel)
        first, count = (dma[0x18 // 4] - PHYSICAL) // 4, dma[0x28 // 4] // 4
        words = np.array(self.memory[first : first + count], np.uint32)
        dma[0x28 // 4] = 0
        if of[AT["MODE"]]:
            self.table = words
            of[AT["STATUS"]] = Status.OK
        else:
            result, refused = kernel.run(words, self.table)
            assert dma[0x58 // 4] == 4 * kernel.words_out
            dma[0x58 // 4] -= self.lost
            at = (dma[0x48 // 4] - PHYSICAL) // 4
            np.frombuffer(self.memory, np.uint32)[at : at + kernel.words_out] = result
            of[AT["STATUS"]] = Status.PIVOT if refused else Status.OK
            of[AT["REQUESTS"]] += 1
            of[AT["COMPUTE_CYCLES"]] = kernel.cycles()
        dma[0x34 // 4] |= 2
        of[AT["CONTROL"]] = IDLE
        of[AT["INTERRUPT_STATUS"]] = 1
        assert of[AT["GLOBAL_INTERRUPT"]] == 1
        assert of[AT["INTERRUPT_ENABLE"]] == 1
        os.write(self.ours, (1).to_bytes(4, "little"))


@contextmanager
def running(hardware: Hardware) -> Iterator[Uio]:
    driver = Uio(hardware.places)
    hardware.thread.start()
    try:
        yield driver
    finally:
        hardware.ends.set()
        hardware.thread.join()
        driver.close()


def soon() -> float:
    return time.monotonic() + 5.0


@pytest.mark.parametrize("kernel", [SOLVE_14, BODY_MASS], ids=lambda k: k.name)
def test_results_are_bit_for_bit_those_of_the_mock_and_are_counted(tmp_path: Path, kernel: Kernel) -> None:
    random = np.random.default_rng(1)
    with running(Hardware(tmp_path, kernel)) as driver:
        for _ in range(5):
            words = random.uniform(0.5, 2, kernel.words_in).astype(np.float32).view(np.uint32)
            assert np.array_equal(driver.run(words, soon()), kernel.run(words)[0])
        counted = driver.counters()
    assert (counted["REQUESTS"], counted["COMPUTE_CYCLES"]) == (5, kernel.cycles())


def test_coefficients_are_sent_once_by_the_client_and_used(tmp_path: Path) -> None:
    words = np.random.default_rng(3).uniform(-0.1, 0.1, 12).astype(np.float32).view(np.uint32)
    with running(Hardware(tmp_path, SUSPENSION_MOTION)) as driver:
        client = Client(driver, deadline=5.0)
        client.set_table("suspension_motion", tables())
        found = client.request(SUSPENSION_MOTION, words)
    assert found is not None
    assert np.array_equal(found.view(np.uint32), SUSPENSION_MOTION.run(words, tables())[0])


def test_a_client_solves_with_it_and_a_refused_pivot_is_the_processors(tmp_path: Path) -> None:
    matrix, right = mass_matrices(1, 5)[0], np.arange(14.0)
    with running(Hardware(tmp_path, SOLVE_14)) as driver:
        client = Client(driver, deadline=5.0)
        assert np.allclose(client.solve(matrix, right), np.linalg.solve(matrix, right), rtol=1e-3, atol=1e-3)
        client.request(SOLVE_14, np.zeros(SOLVE_14.words_in, np.uint32))
        client.request(BODY_MASS, np.zeros(BODY_MASS.words_in, np.uint32))
    counts = client.counts
    assert (counts["accelerated"], counts["pivot"], counts["status_unknown_kernel"]) == (1, 1, 1)


def test_hardware_that_never_answers_is_reset_at_the_deadline_and_works_afterwards(tmp_path: Path) -> None:
    hardware = Hardware(tmp_path, SOLVE_14, answers=False)
    words = np.eye(14, 15, dtype=np.float32).reshape(-1).view(np.uint32)
    with running(hardware) as driver:
        began = time.monotonic()
        with pytest.raises(TimeoutError, match="solve14 gave no interrupt"):
            driver.run(words, began + 0.05)
        assert time.monotonic() - began < 1.0
        client = Client(driver, deadline=0.05)
        assert np.allclose(client.solve(np.eye(14), np.ones(14)), np.ones(14))
        assert client.counts["missed"] == 1
        time.sleep(0.05)
        assert hardware.resets == 2
        hardware.answers = True
        assert np.array_equal(driver.run(words, soon()), SOLVE_14.run(words)[0])


def test_a_dma_that_stops_is_told_without_waiting(tmp_path: Path) -> None:
    hardware = Hardware(tmp_path, SOLVE_14)
    hardware.dma[0x04 // 4] = 0x41  # halted, no such address
    with running(hardware) as driver, pytest.raises(TimeoutError, match=r"DMA stopped.*0x40"):
        driver.run(np.zeros(SOLVE_14.words_in, np.uint32), soon())


def test_a_result_that_came_in_part_is_none(tmp_path: Path) -> None:
    """The DMA says how many bytes came: the others are those of an earlier result."""
    hardware = Hardware(tmp_path, SOLVE_14)
    hardware.lost = 4
    with running(hardware) as driver, pytest.raises(TimeoutError, match="of 56 bytes of a result 52 came"):
        driver.run(np.eye(14, 15, dtype=np.float32).reshape(-1).view(np.uint32), soon())


def missing(hardware: Hardware) -> Places:
    return replace(hardware.places, dma=Path("/dev/no_such_uio"))


def of_version_one(hardware: Hardware) -> Places:
    hardware.registers[AT["MAP_VERSION"]] = 1
    return hardware.places


def of_no_kernel(hardware: Hardware) -> Places:
    hardware.registers[AT["KERNEL"]] = 0xFFFFFFFF
    return hardware.places


def of_another_size(hardware: Hardware) -> Places:
    hardware.registers[AT["WORDS_IN"]] = 19
    return hardware.places


def small(hardware: Hardware) -> Places:
    (hardware.places.attributes / "size").write_text("512\n")
    return hardware.places


def beyond(hardware: Hardware) -> Places:
    (hardware.places.attributes / "phys_addr").write_text("0x100000000\n")
    return hardware.places


def without_attributes(hardware: Hardware) -> Places:
    return replace(hardware.places, attributes=Path("/sys/no_such_buffer"))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (missing, "no_such_uio.*cannot be opened: No such file"),
        (of_version_one, "MAP_VERSION 1, and this release knows 2"),
        (of_no_kernel, "kernel 4294967295"),
        (of_another_size, "WORDS_IN 19, and this release knows 210 of solve14"),
        (small, "needs a buffer of 952 bytes, and .* has 512"),
        (beyond, "begins at 0x100000000"),
        (without_attributes, "should tell the phys_addr"),
    ],
)
def test_what_is_not_this_hardware_is_refused_by_what_is_wrong(
    tmp_path: Path, wrong: Callable[[Hardware], Places], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        Uio(wrong(Hardware(tmp_path, SOLVE_14)))


def test_the_observer_takes_hardware_that_is_of_the_kernel_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
    from vsense_ros.node import observer_accelerator as node

    vehicle = prototype()
    places = [hardware_in(tmp_path / kernel.name, kernel).places for kernel in (SOLVE_14, BODY_MASS)]
    monkeypatch.setattr(node.Places, "numbered", lambda k: places[k])

    def made(*kernels: str) -> node.Accelerator:
        chosen = node.AcceleratorParameters(accelerator="uio", accelerator_kernels=kernels)
        parameters = SimpleNamespace(**chosen.model_dump(), filter="error_ekf")
        return node.Accelerator(cast(Any, None), parameters, vehicle)

    for kernels in (("solve14",), ("solve14", "body_mass"), ("body_mass", "solve14")):
        extension = made(*kernels)
        assert callable(extension.make_filter())
        extension.release()
    with pytest.raises(InputError, match=r"is body_mass, and the hardware has solve14"):
        made("body_mass")


def hardware_in(folder: Path, kernel: Kernel) -> Hardware:
    folder.mkdir()
    return Hardware(folder, kernel)


def test_several_kernels_each_answer_what_is_theirs(tmp_path: Path) -> None:
    both = [hardware_in(tmp_path / kernel.name, kernel) for kernel in (SOLVE_14, BODY_MASS)]
    link = Several([hardware.places for hardware in both])
    assert link.names == ("solve14", "body_mass")
    for hardware in both:
        hardware.thread.start()
    client, random = Client(link, deadline=5.0), np.random.default_rng(2)
    try:
        for kernel in (SOLVE_14, BODY_MASS, SOLVE_14):
            words = random.uniform(0.5, 2, kernel.words_in).astype(np.float32)
            if kernel is SOLVE_14:
                words = np.eye(14, 15, dtype=np.float32).reshape(-1)
            found = client.request(kernel, words.view(np.uint32))
            assert found is not None
            assert np.array_equal(found.view(np.uint32), kernel.run(words.view(np.uint32))[0])
    finally:
        for hardware in both:
            hardware.ends.set()
            hardware.thread.join()
        link.close()
    assert client.counts["accelerated"] == 3
    with pytest.raises(InputError, match="is solve14, as another accelerator is"):
        Several([both[0].places, both[0].places])


def test_a_covariance_is_kept_in_hardware_by_programs_of_any_length(tmp_path: Path) -> None:
    class Combiner(Hardware):
        mock = RowCombiner()

        def request(self) -> None:
            of, dma = self.registers, self.dma
            first, count = (dma[0x18 // 4] - PHYSICAL) // 4, dma[0x28 // 4] // 4
            answer = self.mock.run(np.array(self.memory[first : first + count], np.uint32))
            assert dma[0x58 // 4] == 4 * answer.size
            at = (dma[0x48 // 4] - PHYSICAL) // 4
            np.frombuffer(self.memory, np.uint32)[at : at + answer.size] = answer
            dma[0x28 // 4], dma[0x34 // 4] = 0, 2
            of[AT["CONTROL"]], of[AT["INTERRUPT_STATUS"]] = IDLE, 1
            os.write(self.ours, (1).to_bytes(4, "little"))

    n, random = 12, np.random.default_rng(4)
    covariance, rows = np.cov(random.standard_normal((n, 3 * n))), random.standard_normal((2, n))
    with running(Combiner(tmp_path, RowCombiner)) as driver:
        kept = AcceleratedCovariance(n, lambda words: driver.program(words, answered(words, n), soon()))
        kept.load(covariance)
        np.testing.assert_allclose(kept.project(rows), rows @ covariance, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(kept.read(), covariance, rtol=1e-6)
        with pytest.raises(InputError, match="has room for 2048 words"):
            driver.program(np.zeros(3000, np.uint32), 1, soon())


def answered(words: np.ndarray, columns: int) -> int:
    """Words of the answer to a program, by its last one."""
    return (int(words[-1]) >> 14 & 127) * columns + 1
