"""CAN driver: decodes frames of a CAN bus with a database (DBC), and publishes the topics of a mapping.

With the interface `topic`, the frames come from `can/frames` (can_msgs/Frame), published by another node that owns the
bus. With `publish_frames`, the node publishes the frames of its bus there.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
import traceback
from dataclasses import dataclass
from typing import Any, Literal

import can
from pydantic import Field

from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_bus import open_bus
from vsense_ros.driver.sensor_clock import SensorClock, SensorClockSettings
from vsense_ros.driver.slcan import TICK, WRAP
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr_messages
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.convert import message_type
from vsense_ros.node.parameters import NodeParameters, parameter, path_parameter
from vsense_ros.node.reader import Reader
from vsense_ros.node.time_base import Arrivals

FRAMES, FRAME_KIND = "can/frames", "can_msgs/msg/Frame"


@dataclass(frozen=True)
class CanDriverSettings:
    """How long the driver waits, and what it takes for a correction of a clock: decisions of this project."""

    patience: float = 0.1  # [s] for which a read waits
    correction: int = 50_000_000  # [ns]
    resolution: int = 1_000  # [ns] of a Unix time as a float
    first_wait: float = 0.1  # [s] between attempts to open
    longest_wait: float = 1.0  # [s] between attempts to open
    loss_hold: float = 2.0  # [s] for which a loss that is over colours the diagnostic


SETTINGS = CanDriverSettings()
# The clock of an adapter that dates its frames is tied to the times at which these are read. On a busy machine all of
# them may be read late for seconds, which is no reason to believe that our clock was set.
ADAPTER_CLOCK = SensorClockSettings(late_for=10_000_000_000)


class CanDriverParameters(NodeParameters):
    """Bus, database and mapping."""

    interface: Literal["socketcan", "udp_multicast", "slcan", "virtual", "topic"] = Field(
        "socketcan", description="python-can interface; topic: frames come from `can/frames`"
    )
    publish_frames: bool = Field(False, description="publish the frames of the bus on `can/frames`")
    channel: str = Field(
        "can0", description="channel of the interface: can0, a multicast group, a serial port", min_length=1
    )
    port: int = parameter(43113, "", "UDP port of udp_multicast", ge=1, le=65535)
    bitrate: int = parameter(0, "bit/s", "bit rate, for interfaces that can set it; 0: unchanged", ge=0, le=1_000_000)
    database: str = path_parameter("CAN database file (.dbc, .arxml, .kcd, .sym)")
    mapping: str = path_parameter("YAML file: which signals become which topics (config/can)")


def bus_options(interface: str, port: int) -> dict[str, Any]:
    """Options of python-can that an interface needs here: multicast never leaves the machine, ports open at once."""
    if interface == "udp_multicast":
        return {"port": port, "hop_limit": 0}
    return {"sleep_after_open": 0.0} if interface == "slcan" else {}


class CanDriver(SensingNode[CanDriverParameters]):
    """See the module."""

    _thread: threading.Thread | None = None
    _bus: can.BusABC | None = None
    _reader: Reader | None = None
    _arrivals: Arrivals[tuple[can.Message, int | None]]  # frames, with an adapter's own time [ticks]
    _last_stamp = 0  # of the newest frame [ns]

    def configure(self) -> None:
        p = self.parameters
        for name in ("database", "mapping"):
            if not getattr(p, name):
                raise InputError(f"parameter {name} is empty: {CanDriverParameters.model_fields[name].description}")
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._arrivals = Arrivals()
        self._adapter_clock = SensorClock(TICK, WRAP, self._on_clock_set, ADAPTER_CLOCK)
        self._clock_settings = 0
        self._losses = 0
        self._problem = "not opened yet"
        self._latest_loss = ("", -math.inf)  # why, and when [s] of the monotonic clock
        self._decoder = CanDecoder(p.database, p.mapping)
        for output in self._decoder.mapping.outputs:
            self.outputs.create(output.topic, output.message_kind)
        if p.interface == "topic" and p.publish_frames:
            raise InputError("parameter publish_frames: with interface topic the frames are on can/frames already")
        if p.publish_frames:
            self.outputs.create(FRAMES, FRAME_KIND)
        if p.interface == "topic":
            self._reader = Reader(self, message_type(FRAME_KIND), FRAMES, self._on_frame, raw=True)

    def _on_clock_set(self, sentence: str, _: int) -> None:
        self._clock_settings += 1
        self.get_logger().warning(f"adapter: {sentence}")

    def _open(self) -> can.BusABC:
        p = self.parameters
        bus = open_bus(p.interface, p.channel, p.bitrate or None, **bus_options(p.interface, p.port))
        self._problem = ""
        return bus

    def _on_frame(self, data: bytes) -> None:
        if self.state != "active":
            return
        wall = time.time_ns()
        try:
            frame = cdr_messages.decode_can_frame(data)
        except InputError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return
        self._problem = ""
        message = can.Message(
            timestamp=frame.stamp * 1e-9,
            arbitration_id=frame.identifier,
            is_extended_id=frame.is_extended,
            is_remote_frame=frame.is_remote,
            is_error_frame=frame.is_error,
            dlc=frame.length,
            data=None if frame.is_remote else frame.data,
        )
        self._arrivals.add((message, None), frame.stamp if self._is_near(frame.stamp, wall) else wall)
        self._take(wall)

    @staticmethod
    def _is_near(stamp: int, wall: int) -> bool:
        return abs(stamp - wall) < 1_000_000_000

    def start(self) -> None:
        if self._reader is not None:
            self._problem = f"no frame on {FRAMES} yet"
            return
        self._end.clear()
        self._thread = threading.Thread(target=self._run, name="read CAN", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        if self._thread is not None:
            self._end.set()
            self._thread.join()
            self._thread = None
            self._take(time.time_ns(), at_the_end=True)

    def release(self) -> None:
        self.stop()
        if self._reader is not None:
            self._reader.close()
            self._reader = None
        self._shut()

    def _shut(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def _run(self) -> None:
        wait = SETTINGS.first_wait
        while not self._end.is_set():
            try:
                self._take(time.time_ns())
                if self._bus is None:
                    self._bus = self._open()
                wait = SETTINGS.first_wait
                self._read(self._bus)
            except Exception as error:  # of whatever kind: without this thread nothing is received any more
                problem = str(error)
                if not isinstance(error, can.CanError | OSError | InputError):
                    problem = f"{type(error).__name__}: {error}"
                    self.get_logger().error(traceback.format_exc())
                if problem != self._problem:
                    self.get_logger().warning(f"trying again: {problem}")
                self._losses += not self._problem
                self._problem = problem
                self._latest_loss = (problem, time.monotonic())
                with contextlib.suppress(Exception):  # what is broken may not close in good order
                    self._shut()
                self._end.wait(wait)
                wait = min(2.0 * wait, SETTINGS.longest_wait)

    def _read(self, bus: can.BusABC) -> None:
        while not self._end.is_set():
            try:
                frame = bus.recv(SETTINGS.patience)
            except (ValueError, IndexError):  # slcan: a line with a wrong digit, or one that ends too early
                at = self.time_base.now()
                if at is not None:
                    with self._lock:
                        self._decoder.broken(at)
                continue
            wall = time.time_ns()
            if frame is not None:
                # Some interfaces count from the start of the adapter: then the time of arrival is better than theirs.
                stamped = round(frame.timestamp * 1e9)
                arrived = stamped if self._is_near(stamped, wall) else wall
                self._arrivals.add((frame, getattr(bus, "ticks", None)), arrived)
            self._take(wall)

    def _take(self, wall: int, *, at_the_end: bool = False) -> None:
        for (frame, ticks), received in self._arrivals.dated(wall, self.time_base, at_the_end=at_the_end):
            self._feed(frame, ticks, received)

    def _feed(self, frame: can.Message, ticks: int | None, received: int) -> None:
        """Decode a frame that was read at a time [ns], and dated by its adapter where that has a clock."""
        stamp = received
        if ticks is not None:
            stamp = min(self._adapter_clock.stamp(ticks, received) + TICK // 2, received)
        # Frames come in order, also where the mapping to a replay's time has just been corrected backwards.
        if 0 <= self._last_stamp - stamp < SETTINGS.correction:
            stamp = self._last_stamp + SETTINGS.resolution
        self._last_stamp = stamp
        frame.timestamp = stamp * 1e-9
        if self.parameters.publish_frames and not frame.is_fd:
            flags = (frame.is_remote_frame, frame.is_extended_id, frame.is_error_frame)
            sent = cdr_messages.CanFrame(stamp, frame.arbitration_id, bytes(frame.data), *flags, frame.dlc)
            self.outputs.publish_bytes(FRAMES, FRAME_KIND, cdr_messages.encode_can_frame(sent))
        with self._lock:
            samples = self._decoder.feed(frame, received)
        for sample in samples:
            self.outputs.publish(sample)

    def diagnostics(self) -> list[Diagnostic]:
        values = {
            "interface": self.parameters.interface,
            "channel": self.parameters.channel,
            "losses": str(self._losses),
            "frames before the first /clock message": str(self._arrivals.dropped),
            "adapter's clock set": str(self._clock_settings),
        }
        reason, at = self._latest_loss
        level, text = Level.OK, "open"
        if self._problem:
            level, text = Level.ERROR, f"trying again: {self._problem}"
        elif time.monotonic() - at <= SETTINGS.loss_hold:
            level, text = Level.WARN, f"open again after: {reason}"
        now = self.time_base.now()
        if now is None:
            return [Diagnostic("can: interface", level, text, values)]
        with self._lock:
            return [Diagnostic("can: interface", level, text, values), *self._decoder.diagnostics(now)]

    def summary(self) -> dict[str, Any]:
        return {**super().summary(), "frames_without_time": self._arrivals.dropped}


def main() -> int:
    """Entry point of `ros2 run vsense_ros can_driver`."""
    return run_node(CanDriver, CanDriverParameters)


if __name__ == "__main__":
    sys.exit(main())
