"""A kernel of `hw/control` in a Zynq, from user space: its registers and those of an AXI DMA by UIO, and memory that
the DMA reads and writes by u-dma-buf. `hw/README.md` says how they are bound.

Of the kernel of Linux this takes what its UIO how-to says: a file of UIO is mapped for the registers; a read of four
bytes waits for an interrupt; writing a 1 lets the next one come. The DMA is used as in "direct register mode" of AMD's
PG021.
"""

from __future__ import annotations

import mmap
import os
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.frame import RESPONSE, TABLE, Frame, FrameError, Status, parse
from vsense_ros.accelerator.registers import REGISTERS, Registered, registered, values
from vsense_ros.errors import InputError

Words = NDArray[np.uint32]
_AT = {register.name: register.offset for register in REGISTERS}
_BIT = {f"{r.name}.{f.name}": 1 << f.lowest for r in REGISTERS for f in r.fields}


@dataclass(frozen=True)
class Places:
    """The files of one accelerator. `attributes` is the folder of the buffer in sysfs, `interrupts` the file that tells
    of interrupts where that is not the one of the registers."""

    registers: Path = Path("/dev/uio0")
    dma: Path = Path("/dev/uio1")
    buffer: Path = Path("/dev/udmabuf0")
    attributes: Path = Path("/sys/class/u-dma-buf/udmabuf0")
    interrupts: Path | None = None

    @classmethod
    def numbered(cls, k: int) -> Places:
        """Those of accelerator k, from 0 on, where each is bound before the next: its registers, then its DMA."""
        names = Path(f"/dev/uio{2 * k}"), Path(f"/dev/uio{2 * k + 1}"), Path(f"/dev/udmabuf{k}")
        return cls(*names, Path(f"/sys/class/u-dma-buf/udmabuf{k}"))


@dataclass(frozen=True)
class _Dma:
    """Offsets [byte] and bits of an AXI DMA (PG021, "register space"): a channel's are the same from its base on."""

    to_kernel: int = 0x00
    from_kernel: int = 0x30
    control: int = 0x00
    status: int = 0x04
    address: int = 0x18
    length: int = 0x28  # writing it starts the transfer; from the kernel, what came stands there at the end
    run: int = 0x1
    reset: int = 0x4
    idle: int = 0x2
    errors: int = 0x70
    alignment: int = 64  # [byte] of what it reads and writes: more than it needs


_DMA = _Dma()


class Uio:
    """A `Transport` of `accelerator.client` to one kernel in hardware. Raises `InputError` where a file is missing, the
    registers are of another version or kernel, or the buffer is too small. Not for several threads at once."""

    def __init__(self, places: Places | None = None) -> None:
        self.places = places or Places()
        self._files: list[int] = []
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        p = self.places
        self._registers = self._words(p.registers, mmap.PAGESIZE)
        self._dma = self._words(p.dma, mmap.PAGESIZE)
        self._interrupts = self._file(p.interrupts) if p.interrupts else self._files[0]
        self.kernel = self._kernel_in_registers()
        start, size = self._attribute("phys_addr"), self._attribute("size")
        # A program and its answer have half of the buffer each.
        asked = 4 * max(self.kernel.words_in, self.kernel.table_words) or size // 2
        self._result_at = -(-asked // _DMA.alignment) * _DMA.alignment
        needed = self._result_at + 4 * max(self.kernel.words_out, 1)
        if size < needed:
            raise InputError(
                f"{self.kernel.name} needs a buffer of {needed} bytes, and {p.buffer} has {size}: give it a larger "
                "size in the device tree"
            )
        if start + size > 1 << 32 or start % _DMA.alignment:
            raise InputError(f"{p.buffer} begins at {start:#x}: the DMA's addresses have 32 bits and are aligned")
        self._start = start
        self._buffer = np.frombuffer(self._words(p.buffer, size), np.uint32)

    def _file(self, path: Path) -> int:
        try:
            # O_SYNC: without the processor's cache, which the DMA does not see.
            self._files.append(os.open(path, os.O_RDWR | os.O_SYNC | os.O_NOCTTY))
        except OSError as error:
            raise InputError(
                f"{path}, a file of the accelerator, cannot be opened: {error.strerror}; see hw/README.md for how the "
                "device tree binds it, and who may open it"
            ) from None
        return self._files[-1]

    def _words(self, path: Path, size: int) -> memoryview:
        """`size` bytes of a device, as words of 32 bits: each is read and written at once."""
        file = self._file(path)
        try:
            return memoryview(mmap.mmap(file, size - size % 4)).cast("I")
        except (OSError, ValueError) as error:
            raise InputError(f"{size} bytes of {path} cannot be mapped: {error}") from None

    def _attribute(self, name: str) -> int:
        path = self.places.attributes / name
        try:
            return int(path.read_text(encoding="ascii"), 0)
        except (OSError, ValueError) as error:
            raise InputError(f"{path} should tell the {name} of {self.places.buffer}: {error}") from None

    def _kernel_in_registers(self) -> Registered:
        number, known = self.read("KERNEL"), registered()
        if number not in known:
            raise InputError(f"{self.places.registers} says that it is kernel {number}: not one of {sorted(known)}")
        kernel = known[number]
        for name, expected in values(kernel).items():
            if (found := self.read(name)) != expected:
                raise InputError(
                    f"{self.places.registers} says {name} {found}, and this release knows {expected} of {kernel.name}: "
                    "synthesise hw/ of this release"
                )
        return kernel

    def read(self, name: str) -> int:
        """A register of `accelerator.registers`."""
        return self._registers[_AT[name] // 4]

    def _write(self, name: str, value: int) -> None:
        self._registers[_AT[name] // 4] = value

    def counters(self) -> dict[str, int]:
        """What the hardware counted since its reset, and clocks of its last request."""
        names = ("REQUESTS", "ABORTED", "MALFORMED", "COMPUTE_CYCLES", "LINK_CYCLES", "STATUS")
        return {name: self.read(name) for name in names}

    def soft_reset(self) -> None:
        """Forget what is under way, in the kernel and in both channels of the DMA. Coefficients are kept."""
        self._dma[(_DMA.to_kernel + _DMA.control) // 4] = _DMA.reset  # either channel's resets both
        self._write("CONTROL", _BIT["CONTROL.soft_reset"])

    def run(self, words: Words, deadline: float, *, is_table: bool = False) -> Words:
        """The result (words_out,) of a request (words_in,), or nothing (0,) of coefficients (table_words,). Raises
        `TimeoutError`, after a soft reset, where it has not come by `deadline` [s of `now`] or the DMA stopped."""
        return self._run(words, 0 if is_table else self.kernel.words_out, deadline, is_table)

    def program(self, words: Words, words_out: int, deadline: float) -> Words:
        """The answer (words_out,) to a program (k,) of the row combiner. Raises as `run`; what the kernel keeps is not
        known after a `TimeoutError`, and has to be written anew."""
        if 4 * words.size > self._result_at or self._result_at + 4 * words_out > 4 * self._buffer.size:
            raise InputError(
                f"{self.places.buffer} has room for {self._result_at // 4} words of a program, and as many of its "
                f"answer; found {words.size} and {words_out}: give it a larger size in the device tree"
            )
        answer = self._run(words, words_out, deadline, False)
        if status := self.read("STATUS"):
            raise InputError(f"{self.places.registers} refused a program with status {status}")
        return answer

    def _run(self, words: Words, count: int, deadline: float, is_table: bool) -> Words:
        self._buffer[: words.size] = words
        try:
            self._wait_until(lambda: not self._of_dma(_DMA.to_kernel, _DMA.control) & _DMA.reset, deadline)
            self._enable_interrupt()
            self._write("MODE", _BIT["MODE.table"] if is_table else 0)
            self._write("CONTROL", _BIT["CONTROL.start"])
            if count:
                self._transfer(_DMA.from_kernel, self._result_at, count)
            self._transfer(_DMA.to_kernel, 0, words.size)
            self._wait_for_interrupt(deadline)
            if count:  # the last word has left the kernel: it may still be on its way to memory
                self._wait_until(lambda: bool(self._of_dma(_DMA.from_kernel, _DMA.status) & _DMA.idle), deadline)
                if (came := self._of_dma(_DMA.from_kernel, _DMA.length)) != 4 * count:
                    raise TimeoutError(f"{self.places.dma}: of {4 * count} bytes of a result {came} came")
        except TimeoutError:
            self.soft_reset()
            raise
        return self._buffer[self._result_at // 4 :][:count].copy()

    def _transfer(self, channel: int, offset: int, words: int) -> None:
        self._dma[(channel + _DMA.control) // 4] = _DMA.run
        self._dma[(channel + _DMA.address) // 4] = self._start + offset
        self._dma[(channel + _DMA.length) // 4] = 4 * words

    def _of_dma(self, channel: int, register: int) -> int:
        if errors := self._dma[(channel + _DMA.status) // 4] & _DMA.errors:
            raise TimeoutError(f"{self.places.dma}: the DMA stopped, and no result will come (errors {errors:#x})")
        return self._dma[(channel + register) // 4]

    def _enable_interrupt(self) -> None:
        """Let the interrupt of `done` come, and no earlier one."""
        self._write("GLOBAL_INTERRUPT", _BIT["GLOBAL_INTERRUPT.enable"])
        self._write("INTERRUPT_ENABLE", _BIT["INTERRUPT_ENABLE.done"])
        self._write("INTERRUPT_STATUS", self.read("INTERRUPT_STATUS"))  # ones that are written toggle
        if select.select([self._interrupts], [], [], 0)[0]:
            os.read(self._interrupts, 4)
        os.write(self._interrupts, np.uint32(1).tobytes())

    def _wait_for_interrupt(self, deadline: float) -> None:
        while select.select([self._interrupts], [], [], max(deadline - self.now(), 0.0))[0]:
            os.read(self._interrupts, 4)
            if self.read("INTERRUPT_STATUS") & _BIT["INTERRUPT_STATUS.done"]:
                return
            os.write(self._interrupts, np.uint32(1).tobytes())
        raise TimeoutError(f"{self.places.registers}: {self.kernel.name} gave no interrupt before the deadline")

    def _wait_until(self, is_so: Callable[[], bool], deadline: float) -> None:
        while not is_so():
            if self.now() > deadline:
                raise TimeoutError(f"{self.places.dma}: the DMA had not ended by the deadline")

    def now(self) -> float:
        """Time [s] of the processor's clock."""
        return time.monotonic()

    def exchange(self, data: bytes, deadline: float, wanted: Callable[[bytes], bool]) -> list[bytes]:
        """The answer as a frame, or none where there was none by `deadline`, or the files are closed."""
        if not self._files:
            return []
        try:
            answer = self._answer(parse(data), deadline).to_bytes()
        except (FrameError, TimeoutError):
            return []
        wanted(answer)
        return [answer]

    def _answer(self, request: Frame, deadline: float) -> Frame:
        is_table, kernel = bool(request.flags & TABLE), self.kernel
        answer = replace(request, flags=RESPONSE, payload=np.zeros(0, np.uint32))
        if request.kernel != kernel.number:
            return replace(answer, status=Status.UNKNOWN_KERNEL)
        if request.payload.size != (kernel.table_words if is_table else kernel.words_in):
            return replace(answer, status=Status.WRONG_SIZE)
        result = self.run(request.payload, deadline, is_table=is_table)
        compute, link = self.read("COMPUTE_CYCLES"), self.read("LINK_CYCLES")
        return replace(answer, status=self.read("STATUS"), payload=result, compute_cycles=compute, link_cycles=link)

    def close(self) -> None:
        """Close the files."""
        while self._files:
            os.close(self._files.pop())


class Several:
    """A `Transport` of `accelerator.client` to several kernels, each in hardware of its own. Raises as `Uio`, and
    `InputError` where two are the same kernel."""

    def __init__(self, places: Sequence[Places]) -> None:
        self._of: dict[int, Uio] = {}
        try:
            for one in places:
                link = Uio(one)
                if link.kernel.number in self._of:
                    link.close()
                    raise InputError(f"{one.registers} is {link.kernel.name}, as another accelerator is")
                self._of[link.kernel.number] = link
        except BaseException:
            self.close()
            raise

    @property
    def names(self) -> tuple[str, ...]:
        """The kernels, in the order of their places."""
        return tuple(link.kernel.name for link in self._of.values())

    def now(self) -> float:
        """Time [s] of the processor's clock."""
        return time.monotonic()

    def exchange(self, data: bytes, deadline: float, wanted: Callable[[bytes], bool]) -> list[bytes]:
        """As `Uio.exchange`, by the kernel that a request names; any says of one that there is not that it is none."""
        try:
            number = parse(data).kernel
        except FrameError:
            return []
        link = self._of.get(number) or next(iter(self._of.values()), None)
        return [] if link is None else link.exchange(data, deadline, wanted)

    def close(self) -> None:
        """Close the files of all."""
        for link in self._of.values():
            link.close()
        self._of.clear()
