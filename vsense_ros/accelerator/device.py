"""The accelerator's side of the link: takes requests as bytes, gives answers and when they come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsense_ros.accelerator.faults import Chance, Faults
from vsense_ros.accelerator.frame import REQUESTS, RESPONSE, TABLE, Frame, FrameError, Status, parse
from vsense_ros.accelerator.kernels import KERNELS, Kernel
from vsense_ros.accelerator.link import Link
from vsense_ros.accelerator.rtl import Rtl
from vsense_ros.errors import InputError

BACKENDS = ("mock", "rtl", "off")
Words = np.ndarray[tuple[int, ...], np.dtype[np.uint32]]


@dataclass(frozen=True)
class Answer:
    """Bytes that leave, `after` seconds of modelled time."""

    after: float
    data: bytes


class Device:
    """Kernels behind a link. `backend` mock computes with NumPy, rtl with the verilated hardware (the same bits), off
    answers nothing. One request is worked on at a time: another that comes before the answer of the first has left is
    answered that the accelerator is busy. Raises `InputError` for a backend or kernel that there is not."""

    def __init__(
        self,
        backend: str = "mock",
        kernels: Sequence[str] = tuple(KERNELS),
        link: Link | None = None,
        faults: Faults | None = None,
        seed: int = 0,
    ) -> None:
        if backend not in BACKENDS:
            raise InputError(f"no backend {backend!r}; there are {', '.join(BACKENDS)}")
        if unknown := [name for name in kernels if name not in KERNELS]:
            raise InputError(f"no kernel {', '.join(unknown)}; there are {', '.join(KERNELS)}")
        self.backend, self.link = backend, link or Link()
        self.kernels = {KERNELS[name].number: KERNELS[name] for name in kernels}
        self.chance = Chance(faults or Faults(), seed)
        self._random = np.random.default_rng(seed + 1)
        self._rtl = {k.number: Rtl(k) for k in self.kernels.values()} if backend == "rtl" else {}
        self._tables: dict[int, Words] = {}
        self._busy_until = -np.inf
        self._before: dict[int, Words] = {}  # the result before, of each kernel
        self.counts: Counter[str] = Counter()
        self.cycles: Counter[str] = Counter()

    def handle(self, data: bytes, now: float) -> list[Answer]:
        """Answers to a request that comes at `now` [s], in the order in which they leave."""
        if self.backend == "off":
            self.counts["ignored"] += 1
            return []
        try:
            request = parse(data)
        except FrameError as error:
            self.counts[f"bad_{error.kind}"] += 1
            if error.kind == "magic" or len(data) < 52:
                return []  # not from an observer: no answer would be understood
            refused = Frame(error.kernel, error.sequence, np.zeros(0, np.uint32), RESPONSE, Status.BAD_FRAME)
            return self._leave(refused, now, self.link.seconds(0))
        if request.is_response:
            self.counts["response_as_request"] += 1
            return []
        if now < self._busy_until:
            self.counts["busy"] += 1
            return self._leave(self._refusal(request, Status.BUSY), now, self.link.seconds(0), busy=False)
        response, clocks = self._answer(request)
        return self._leave(response, now, self.link.seconds(clocks, self._random))

    @staticmethod
    def _refusal(request: Frame, status: Status) -> Frame:
        return replace(request, flags=RESPONSE, status=status, payload=np.zeros(0, np.uint32))

    def _answer(self, request: Frame) -> tuple[Frame, int]:
        """What the kernel gives, and how many clocks that takes with the link."""
        kernel = self.kernels.get(request.kernel)
        if kernel is None:
            self.counts["unknown_kernel"] += 1
            return self._refusal(request, Status.UNKNOWN_KERNEL), 0
        if request.flags & TABLE:
            return self._take_table(kernel, request)
        if request.payload.size != kernel.words_in or request.rows != kernel.size:
            self.counts["wrong_size"] += 1
            return self._refusal(request, Status.WRONG_SIZE), 0
        table = self._tables.get(kernel.number)
        if kernel.table_words and table is None:
            self.counts["no_table"] += 1
            return self._refusal(request, Status.FAULT), 0
        if kernel.number in self._rtl:
            result, refused, counted = self._rtl[kernel.number].run(request.payload)
            compute = int(counted)
        else:
            result, refused = kernel.run(request.payload, table)
            compute = kernel.cycles()
        link = self.link.cycles(kernel)
        self.counts[kernel.name] += 1
        self.cycles[kernel.name] = compute
        if refused:
            self.counts["pivot"] += 1
        status = Status.PIVOT if refused else Status.OK
        response = replace(
            request, flags=RESPONSE, status=status, payload=self._disturbed(kernel, result), compute_cycles=compute,
            link_cycles=link,
        )  # fmt: skip
        return response, compute + link

    def _take_table(self, kernel: Kernel, request: Frame) -> tuple[Frame, int]:
        if kernel.table_words != request.payload.size:
            self.counts["wrong_size"] += 1
            return self._refusal(request, Status.WRONG_SIZE), 0
        self._tables[kernel.number] = request.payload
        if kernel.number in self._rtl:
            self._rtl[kernel.number].set_table(request.payload)
        return self._refusal(request, Status.OK), kernel.table_words

    def _disturbed(self, kernel: Kernel, result: Words) -> Words:
        """The result with the faults that happen in the kernel."""
        before = self._before.get(kernel.number, result)
        self._before[kernel.number] = result
        given, chance = result.copy(), self.chance
        if chance.strikes("stuck"):
            given = before.copy()
        if chance.strikes("nan"):
            given[chance.random.integers(given.size)] = 0x7FC00000
        if chance.strikes("silent_error"):
            given[chance.random.integers(given.size)] ^= np.uint32(1 << int(chance.random.integers(20, 31)))
        return given

    def _leave(self, response: Frame, now: float, after: float, busy: bool = True) -> list[Answer]:
        """The answers as they leave, with the faults that happen on the way."""
        if busy:
            self._busy_until = now + after
        if 0 < response.deadline < round(1e9 * after):
            self.counts["deadline"] += 1
            response = self._refusal(response, Status.DEADLINE)
        chance = self.chance
        if chance.strikes("error_status"):
            response = self._refusal(response, Status.FAULT)
        if chance.strikes("wrong_sequence"):
            step = int(chance.random.integers(1, 100))
            response = replace(response, sequence=response.sender << 24 | (response.sequence - step) % REQUESTS)
        if chance.strikes("wrong_sender"):
            response = replace(response, sequence=(response.sequence + (1 << 24)) % (1 << 32))
        data = response.to_bytes()
        if chance.strikes("bit_flip"):
            bit = int(chance.random.integers(8 * len(data)))
            changed = bytearray(data)
            changed[bit // 8] ^= 1 << bit % 8
            data = bytes(changed)
        if chance.strikes("drop"):
            return []
        if chance.strikes("delay"):
            after += 1e-3 * chance.faults.delay_ms
        answers = [Answer(after, data)]
        if chance.strikes("repeat"):
            answers.append(Answer(after, data))
        return answers
