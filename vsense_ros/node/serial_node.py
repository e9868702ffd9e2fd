"""What the nodes of serial sensors share: port → bytes → decoder → topics."""

from __future__ import annotations

import threading
import time
from typing import Any, Protocol, TypeVar

from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.node.base import SensingNode
from vsense_ros.node.parameters import NodeParameters, parameter, path_parameter
from vsense_ros.node.serial_link import SerialLink
from vsense_ros.node.time_base import Arrivals


class Decoder(Protocol):
    """What the decoders of `vsense_ros.driver` have in common."""

    def feed(self, data: bytes, received: int, /) -> list[Sample]:
        """Samples that these bytes complete."""

    def diagnostics(self, now: int, /) -> list[Diagnostic]:
        """Health at `now` [ns]."""


class SerialParameters(NodeParameters):
    """Where the bytes come from."""

    port: str = path_parameter("device (/dev/ttyUSB0, /dev/pts/3) or socket://host:port")
    baud_rate: int = parameter(115200, "bit/s", "baud rate of a serial port", ge=1200, le=4_000_000)


Params = TypeVar("Params", bound=SerialParameters)


class SerialSensorNode(SensingNode[Params]):
    """A serial sensor with its decoder."""

    sensor: str
    _decoder: Decoder
    _link: SerialLink | None = None
    _arrivals: Arrivals[bytes]

    def make_decoder(self) -> Decoder:
        """A decoder with the settings of `self.parameters`."""
        raise NotImplementedError

    def topics(self) -> dict[str, str]:
        """Topics that are published, with their types."""
        raise NotImplementedError

    def configure(self) -> None:
        self._lock = threading.Lock()
        self._arrivals = Arrivals(len)
        self._decoder = self.make_decoder()
        for topic, kind in self.topics().items():
            self.outputs.create(topic, kind)
        self._link = self.open_source()

    def open_source(self) -> SerialLink | None:
        """Where the bytes come from; None if they do not come over a line."""
        p, warn = self.parameters, self.get_logger().warning
        return SerialLink(self.sensor, p.port, p.baud_rate, self._on_bytes, warn, self._take)

    def start(self) -> None:
        if self._link is not None:
            self._link.start()

    def stop(self) -> None:
        if self._link is not None:
            self._link.stop()
            self._take(time.time_ns(), at_the_end=True)

    def release(self) -> None:
        self.stop()

    def _on_bytes(self, data: bytes, wall: int) -> None:
        self._arrivals.add(data, wall)
        self._take(wall)

    def _take(self, wall: int, *, at_the_end: bool = False) -> None:
        for chunk, received in self._arrivals.dated(wall, self.time_base, at_the_end=at_the_end):
            with self._lock:
                try:
                    samples = self._decoder.feed(chunk, received)
                except Exception:
                    self._decoder = self.make_decoder()  # the old one still holds what it stumbled over
                    raise
            for sample in samples:
                self.outputs.publish(sample)

    def diagnostics(self) -> list[Diagnostic]:
        diagnostics = [self._link.diagnostic()] if self._link is not None else []
        if self._arrivals.dropped:
            text = "bytes arrived before the first /clock message and were dropped"
            diagnostics.append(
                Diagnostic(f"{self.sensor}: clock", Level.WARN, text, {"bytes": str(self._arrivals.dropped)})
            )
        now = self.time_base.now()
        if now is not None:
            with self._lock:
                diagnostics += self._decoder.diagnostics(now)
        return diagnostics

    def summary(self) -> dict[str, Any]:
        return {**super().summary(), "bytes_without_time": self._arrivals.dropped}
