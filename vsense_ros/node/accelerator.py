"""Accelerator: computes kernels of the observer on request, as hardware would, on two topics.

A request on `accelerator/request` is answered on `accelerator/response`. Both have the type `std_msgs/UInt8MultiArray`
and contain the bytes of one frame; the label names the kernel. NumPy (`mock`) or the hardware sources themselves
(`rtl`, with Verilator) compute the kernels, with identical bits; `off` does not answer. Faults can be injected.

Two messages between processes take longer than the computation that they carry. The node demonstrates the division of
work and its fault tolerance; it does not make the observer faster.
"""

from __future__ import annotations

import sys
import time
from typing import Any, Literal

from pydantic import Field
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.faults import Faults
from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.accelerator.link import Link
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.node.accelerator_link import REQUEST, RESPONSE, as_bytes, as_message
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.parameters import NodeParameters, parameter
from vsense_ros.node.timers import steady_timer

_NEWEST = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=16)
_LINK = Link()


class AcceleratorParameters(NodeParameters):
    """Kernels, link and faults."""

    backend: Literal["mock", "rtl", "off"] = Field("mock", description="NumPy, simulated hardware, or silent")
    kernels: tuple[str, ...] = Field(tuple(KERNELS), description="kernels that it offers")
    clock_mhz: float = parameter(_LINK.clock_mhz, "MHz", "assumed clock of the hardware", gt=0, le=2000)
    stream_bits: int = parameter(_LINK.stream_bits, "bit", "width of the link", ge=32, le=1024)
    setup_us: float = parameter(_LINK.setup_us, "µs", "set-up of a transfer", ge=0, le=1e6)
    jitter_us: float = parameter(0.0, "µs", "standard deviation of a transfer's time", ge=0, le=1e6)
    faults: str = Field(
        "", description="probabilities of faults, such as 'drop: 0.01, delay: 0.1, delay_ms: 20'; empty: none"
    )
    seed: int = Field(0, description="seed of faults and jitter", ge=0)


class AcceleratorNode(SensingNode[AcceleratorParameters]):
    """See the module."""

    _device: Device | None = None
    _subscription: Any = None
    _answers: Any = None

    def configure(self) -> None:
        p = self.parameters
        link = Link(p.clock_mhz, p.stream_bits, p.setup_us, p.jitter_us)
        self._device = Device(p.backend, p.kernels, link, Faults.of(p.faults), p.seed)
        self.requests = 0
        self.times: list[float] = []
        self._since = (time.monotonic(), 0)
        self._answers = self.create_lifecycle_publisher(UInt8MultiArray, RESPONSE, _NEWEST)
        self._subscription = self.create_subscription(UInt8MultiArray, REQUEST, self._receive, _NEWEST)

    def release(self) -> None:
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
            self.destroy_lifecycle_publisher(self._answers)
            self._subscription = None
        self._device = None

    def _receive(self, message: UInt8MultiArray) -> None:
        device = self._device
        if device is None or self.state != "active":
            return
        began = time.perf_counter()
        self.requests += 1
        # The modelled time of the hardware is stated in the answer; only an answer that is late on purpose waits here.
        late = 1e-3 * device.chance.faults.delay_ms if device.chance.faults.delay else float("inf")
        for answer in device.handle(as_bytes(message), time.monotonic()):
            if answer.after >= late:
                self._send_later(answer.data, answer.after)
            else:
                self._answers.publish(as_message(answer.data))
                self.outputs.published[RESPONSE] += 1
        if len(self.times) < 1_000_000:
            self.times.append(time.perf_counter() - began)

    def _send_later(self, data: bytes, after: float) -> None:
        def send() -> None:
            timer.cancel()
            self.destroy_timer(timer)
            if self._subscription is not None:
                self._answers.publish(as_message(data))
                self.outputs.published[RESPONSE] += 1

        timer = steady_timer(self, after, send)

    def diagnostics(self) -> list[Diagnostic]:
        device = self._device
        if device is None:
            return []
        now = time.monotonic()
        (then, count), self._since = self._since, (now, self.requests)
        rate = (self.requests - count) / max(now - then, 1e-9)
        values = {"backend": device.backend, "requests": str(self.requests), "rate [1/s]": f"{rate:.1f}"}
        values |= {f"cycles of {name}": str(cycles) for name, cycles in device.cycles.items()}
        values |= {name: str(number) for name, number in device.counts.items()}
        values |= {f"fault {name}": str(number) for name, number in device.chance.happened.items()}
        refused = sum(n for name, n in device.counts.items() if name not in KERNELS and name != "pivot")
        if device.backend == "off":
            level, text = Level.WARN, "off: requests are not answered"
        elif device.chance.happened:
            level, text = Level.WARN, "faults are put in on purpose"
        elif refused:
            level, text = Level.WARN, f"{refused} requests were refused"
        else:
            level, text = Level.OK, f"{', '.join(k.name for k in device.kernels.values())} by {device.backend}"
        return [Diagnostic("accelerator", level, text, values)]

    def summary(self) -> dict[str, Any]:
        device = self._device
        if device is None:
            return super().summary()
        return {
            **super().summary(),
            "requests": self.requests,
            "counts": dict(device.counts),
            "faults": dict(device.chance.happened),
            "cycles": dict(device.cycles),
        }


def main() -> int:
    """Entry point of `ros2 run vsense_ros accelerator`."""
    return run_node(AcceleratorNode, AcceleratorParameters)


if __name__ == "__main__":
    sys.exit(main())
