"""How long a request takes: set-up, words over a stream, and the clocks of the kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.accelerator.kernels.base import Kernel

WORD = 32  # bits


@dataclass(frozen=True)
class Link:
    """What lies between processor and kernel. The set-up is that of a DMA transfer with its driver call, estimated: AXI
    DMA takes 44 and 39 clocks before the first word either way (AMD PG021), the driver 5 to 20 µs on a Cortex-A9."""

    clock_mhz: float = 100.0
    stream_bits: int = 32
    setup_us: float = 10.0
    jitter_us: float = 0.0  # standard deviation of what is added, which is never negative

    def cycles(self, kernel: Kernel) -> int:
        """Clocks for loading and unloading one request."""
        per_clock = max(1, self.stream_bits // WORD)
        return -(-kernel.words_in // per_clock) + -(-kernel.words_out // per_clock)

    def seconds(self, clocks: int, random: np.random.Generator | None = None) -> float:
        """Time of a request of so many clocks in all [s]."""
        jitter = abs(random.normal(0.0, self.jitter_us)) if random is not None and self.jitter_us else 0.0
        return 1e-6 * (self.setup_us + clocks / self.clock_mhz + jitter)
