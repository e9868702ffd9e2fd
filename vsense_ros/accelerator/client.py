"""The observer's side of the link: what to ask the accelerator, what to believe, and when to do the work itself.

Nothing wrong gets through: an answer is taken only if its checksum, sequence, kernel and size are right, it came before
the deadline, every word is finite, and the caller's check of the result agrees. Whatever else happens the processor
does the work in the same step. After three misses in a row the accelerator is left alone for a second, then asked once;
each such failure doubles the time, up to a minute.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.device import Answer, Device
from vsense_ros.accelerator.frame import REQUESTS, RESPONSE, TABLE, Frame, FrameError, Status, parse
from vsense_ros.accelerator.kernels import KERNELS, Kernel

MISSES = 3  # in a row, before the accelerator is left alone
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 60.0  # [s]
RESIDUAL = 1e-4  # of a solution, relative to the size of what it is made of

_SOLVERS = sorted((kernel for kernel in KERNELS.values() if kernel.size), key=lambda kernel: kernel.size)

Array = NDArray[np.float64]


def _solve(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right))


class Transport(Protocol):
    """Carries bytes to the accelerator and back."""

    def now(self) -> float:
        """Time [s], for deadlines and pauses."""

    def exchange(self, data: bytes, deadline: float, wanted: Callable[[bytes], bool]) -> list[bytes]:
        """Send a request, and return what comes until `wanted` says yes or until `deadline` [s of `now`]. What came
        since the last call comes first."""


class Direct:
    """A device in the same process, in modelled time: the same answers whenever and wherever it runs. `at(time)` tells
    the time of the drive [s]; within a step time goes on as modelled."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._now = 0.0
        self._under_way: list[tuple[float, bytes]] = []

    def at(self, time: float) -> None:
        self._now = max(self._now, time) if time > self._now - 1.0 else time  # a drive may begin anew

    def now(self) -> float:
        return self._now

    def exchange(self, data: bytes, deadline: float, wanted: Callable[[bytes], bool]) -> list[bytes]:
        answers: list[Answer] = self.device.handle(data, self._now)
        self._under_way += [(self._now + answer.after, answer.data) for answer in answers]
        self._under_way.sort(key=lambda item: item[0])
        came: list[bytes] = []
        while self._under_way and self._under_way[0][0] <= deadline:
            time, answer = self._under_way.pop(0)
            self._now = max(self._now, time)
            came.append(answer)
            if wanted(answer):
                return came
        self._now = deadline
        return came


@dataclass(frozen=True)
class Measuring:
    """How a deadline is found that fits a link and what runs beside it: the longest of some first requests, times
    `margin`, as a later one may take longer; within bounds of which the upper is a step at 250 Hz."""

    requests: int = 20
    margin: float = 2.0
    shortest: float = 5e-4  # [s]
    longest: float = 4e-3  # [s]; also where none was answered


MEASURED = Measuring()


class Client:
    """One observer's use of an accelerator. `sender` tells observers apart that share one; `deadline` [s] is how long a
    request may take, or None: what the first requests take decides. `counts` has every request by what became of it,
    and every answer that was dropped by the reason."""

    def __init__(self, transport: Transport, *, sender: int = 0, deadline: float | None = 2e-3) -> None:
        self.transport, self.sender = transport, sender % 256
        self.deadline, self._unmeasured = deadline or MEASURED.longest, deadline is None
        self.counts: Counter[str] = Counter()
        self.longest = 0.0  # [s] that a request took
        self.compute_cycles = self.link_cycles = 0
        self._sequence = 0
        self._misses = 0
        self._pause, self._resume = FIRST_PAUSE, -np.inf
        self._tables: dict[str, NDArray[np.uint32]] = {}
        self._has_table: set[str] = set()

    @property
    def is_off(self) -> bool:
        """True if the accelerator is left alone at present."""
        return self._misses >= MISSES and self.transport.now() < self._resume

    def set_table(self, kernel: str, table: NDArray[np.uint32]) -> None:
        """Coefficients that are sent before the next request of this kernel, and again after a failure."""
        self._tables[kernel] = table
        self._has_table.discard(kernel)

    def solve(self, matrix: Array, right: Array, on_processor: Callable[[Array, Array], Array] = _solve) -> Array:
        """x (n,) of matrix (n, n) x = right (n,): by the accelerator where it is asked and right, else by
        `on_processor`. A smaller matrix is filled up with the unit matrix."""
        n = len(right)
        kernel = next((kernel for kernel in _SOLVERS if n <= kernel.size), None)
        if kernel is None:
            self.counts["too_large"] += 1
            return on_processor(matrix, right)
        # Rows and columns by the size of the diagonal, so that the numbers are near one: binary32 has room for less.
        diagonal = np.abs(matrix.diagonal())
        if not (np.all(diagonal > 0) and np.all(np.isfinite(diagonal))):
            self.counts["not_scalable"] += 1
            return on_processor(matrix, right)
        scale = 1 / np.sqrt(diagonal)
        size = float(np.abs(scale * right).max()) or 1.0
        system = np.zeros((kernel.size, kernel.size + 1), np.float32)
        system[:n, :n] = scale[:, None] * matrix * scale
        system[range(n, kernel.size), range(n, kernel.size)] = 1.0
        system[:n, kernel.size] = scale * right / size
        scaled, wanted = system[:n, :n].astype(float), system[:n, kernel.size].astype(float)

        def check(result: NDArray[np.float32]) -> bool:
            y = result[:n].astype(float)
            missing = np.abs(scaled @ y - wanted).max()
            return bool(missing <= RESIDUAL * (np.abs(scaled).sum(axis=1).max() * np.abs(y).max() + 1.0))

        solution = self.request(kernel, system.reshape(-1).view(np.uint32), check)
        if solution is None:
            return on_processor(matrix, right)
        return size * scale * solution[:n].astype(float)

    def request(
        self, kernel: Kernel, words: NDArray[np.uint32], check: Callable[[NDArray[np.float32]], bool] = lambda _: True
    ) -> NDArray[np.float32] | None:
        """The result of a kernel (words_out,), or None where the processor has to do it."""
        self.counts["requests"] += 1
        if self.is_off:
            self.counts["left_alone"] += 1
            return None
        if kernel.table_words and kernel.name not in self._has_table and not self._send_table(kernel):
            return None
        if self._unmeasured and not self._measure(kernel, words):
            return None
        answer = self._asked(kernel, words, 0, kernel.words_out)
        if answer is None:
            return None
        result = answer.payload.view(np.float32)
        if not np.all(np.isfinite(result)):
            self._missed("not_finite")
            return None
        if not check(result):
            self._missed("implausible")
            return None
        self._succeeded()
        self.compute_cycles, self.link_cycles = answer.compute_cycles, answer.link_cycles
        self.counts["accelerated"] += 1
        return result

    def _measure(self, kernel: Kernel, words: NDArray[np.uint32]) -> bool:
        """Choose the deadline by what requests of these words take; False where one of them has no answer."""
        longest = 0.0
        for _ in range(MEASURED.requests):
            began = self.transport.now()
            if self._asked(kernel, words, 0, kernel.words_out) is None:
                return False
            longest = max(longest, self.transport.now() - began)
        self.deadline = min(max(MEASURED.margin * longest, MEASURED.shortest), MEASURED.longest)
        self._unmeasured = False
        return True

    def _send_table(self, kernel: Kernel) -> bool:
        table = self._tables.get(kernel.name)
        if table is None:
            raise ValueError(f"{kernel.name} needs coefficients: call set_table first")
        if self._asked(kernel, table, TABLE, 0) is None:
            return False
        self._has_table.add(kernel.name)
        return True

    def _asked(self, kernel: Kernel, words: NDArray[np.uint32], flags: int, words_out: int) -> Frame | None:
        """The answer to one request, if there is a good one."""
        self._sequence = (self._sequence + 1) % REQUESTS
        sequence = self.sender << 24 | self._sequence
        began = self.transport.now()
        # Its deadline is given in time since the stamp, so that clocks need not agree.
        frame = Frame(
            kernel.number, sequence, words, flags, deadline=round(1e9 * self.deadline), rows=kernel.size,
            right_sides=1 if kernel.size else 0,
        )  # fmt: skip
        good: list[Frame] = []

        def wanted(data: bytes) -> bool:
            answer = self._judged(data, kernel, sequence)
            if answer is not None:
                good.append(answer)
            return answer is not None

        self.transport.exchange(frame.to_bytes(), began + self.deadline, wanted)
        self.longest = max(self.longest, self.transport.now() - began)
        if not good:
            self._missed("missed")
            return None
        answer = good[0]
        if answer.status != Status.OK:
            if answer.status == Status.FAULT:
                self._has_table.discard(kernel.name)  # it may have been started anew
            if answer.status == Status.PIVOT:
                # The accelerator is well: this system is not one for it.
                self._succeeded()
                self.counts["pivot"] += 1
                return None
            known = answer.status in Status._value2member_map_
            self._missed(f"status_{Status(answer.status).name.lower()}" if known else "status_unknown")
            return None
        if answer.payload.size != words_out:
            self._missed("wrong_size")
            return None
        return answer

    def _judged(self, data: bytes, kernel: Kernel, sequence: int) -> Frame | None:
        """The frame, if it is the answer to this request; else why it is dropped is counted."""
        try:
            answer = parse(data)
        except FrameError as error:
            self.counts[f"dropped_{error.kind}"] += 1
            return None
        if not answer.flags & RESPONSE:
            self.counts["dropped_request"] += 1
        elif answer.sender != self.sender:
            self.counts["dropped_sender"] += 1
        elif answer.sequence != sequence:
            self.counts["dropped_sequence"] += 1
        elif answer.kernel != kernel.number:
            self.counts["dropped_kernel"] += 1
        else:
            return answer
        return None

    def _missed(self, why: str) -> None:
        self.counts[why] += 1
        self._misses += 1
        if self._misses >= MISSES:
            if self._misses == MISSES:
                self._pause = FIRST_PAUSE
            else:
                self._pause = min(2 * self._pause, LONGEST_PAUSE)
            self._resume = self.transport.now() + self._pause
            self.counts["pauses"] += 1
            self._has_table.clear()

    def _succeeded(self) -> None:
        self._misses = 0

    @property
    def fallbacks(self) -> int:
        """How often the processor did the work."""
        return self.counts["requests"] - self.counts["accelerated"]
