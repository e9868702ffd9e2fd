"""Replay: publishes a bag and `/clock`, and sends a CAN log to a bus and sensor bytes to ports, in one time base.

It starts once all consumers (observer, recorder) are ready. It asks each of them on a topic of its own below
`vsense/do_you_listen`, and receives the answers on `vsense/listening`.

With rate 0 it sends as fast as the consumers can process, and nothing is dropped: each of them reports on
`vsense/progress` up to which `/clock` message it has processed everything, and the replay stays at most `window` ahead
of the slowest. If fewer than the announced consumers appear within `wait`, it ends with an error.

Topics of any type are published, with the reliability and durability with which they were recorded.

Its services are those of rosbag2's player: `~/pause`, `~/resume`, `~/toggle_paused`, `~/is_paused`, `~/get_rate`,
`~/set_rate`, `~/seek`, `~/play_next`, `~/burst`, `~/stop`; and `~/restart` (std_srvs/Trigger). The parameters `rate`,
`loop` and `position` (which seeks) may be set during the replay.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from pydantic import Field
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.node import rosbag2
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.consumers import Consumers
from vsense_ros.node.parameters import parameter
from vsense_ros.node.reader import LOSSLESS
from vsense_ros.node.replay_sources import NANO, ReplaySources, SourceParameters, check_overlap


@dataclass(frozen=True)
class ReplaySettings:
    """How often a replay gives the time, and looks after its consumers: decisions of this project."""

    tick: int = 10_000_000  # [ns] between clock messages: of wall time, or of recorded time where that runs slower
    look_every: float = 0.05  # [s] between two looks at the consumers that a replay waits for
    send_again: float = 0.2  # [s] after which the time is sent again to consumers that are behind
    fast_tick: int = 20_000_000  # [ns] of recorded time with rate 0


SETTINGS = ReplaySettings()


class ReplayParameters(SourceParameters):
    """What, whereto, how fast."""

    rate: float = parameter(
        1.0, "", "speed as a multiple of real time; 0: as fast as the consumers can process", live=True, ge=0, le=1000
    )
    loop: bool = parameter(False, "", "start again at the end", live=True)
    start_offset: float = parameter(0.0, "s", "start of the replay, after the first message", ge=0)
    duration: float = parameter(0.0, "s", "duration of the replay; 0: to the end", ge=0)
    position: float = parameter(-1.0, "s", "position to seek to, after the first message; -1: none", live=True, ge=-1)
    paused: bool = Field(False, description="start paused, and wait for ~/resume")
    clock: bool = Field(True, description="publish /clock")
    lead: float = parameter(
        0.5, "s", "wall time for which the clock runs before the first message, so that drivers know the time", ge=0
    )
    wait: float = parameter(10.0, "s", "longest wait for subscribers, consumers and readers of ports", ge=0, le=600)
    consumers: int = parameter(
        0, "", "that must report progress within `wait`, else it ends with an error; rate 0 needs one", ge=0, le=10
    )
    window: float = parameter(0.2, "s", "recorded time by which consumers may lag with rate 0", gt=0, le=10)
    exit_at_end: bool = Field(True, description="end the process once everything is sent and processed")


class Replay(SensingNode[ReplayParameters]):
    """See the module."""

    publishes_time = True

    _thread: threading.Thread | None = None
    _sources: ReplaySources | None = None
    _clock_output: Any = None
    _consumers: Consumers
    _servers: tuple[Any, ...] = ()

    def configure(self) -> None:
        p = self.parameters
        self._condition = threading.Condition()
        self._ended = False
        self._finished = False
        self._paused = p.paused
        self._position = 0  # of the next message
        self._single = 0  # messages to send although it is paused
        self._seek: int | None = None
        self._moved = True  # the relation of recorded and wall time is to be fixed anew
        self._not_taken: dict[str, int] = {}
        self._now = self._published = 0
        self._lead = round(p.lead * NANO * p.rate)
        sources = self._sources = ReplaySources(self, p, own_clock=p.clock)
        sources.load()
        times, self._senders, self._waiting_for = sources.times, sources.senders, sources.waiting_for
        self.lost_in_bag = sources.lost_in_bag
        if not len(times):
            raise InputError("nothing to replay: set one of the parameters bag, can_log, gnss_bytes, imu_bytes")
        if p.rate == 0 and (p.can_log or p.gnss_bytes or p.imu_bytes):
            raise InputError(
                "rate 0 works for bags alone: nobody knows how far buses and serial lines have got; set a rate above 0"
            )
        check_overlap(times, sources.senders, sources.items)
        order = np.argsort(times, kind="stable")
        begin = int(times[order[0]]) + round(p.start_offset * NANO)
        end = begin + round(p.duration * NANO) if p.duration else int(times[order[-1]])
        order = order[(times[order] >= begin) & (times[order] <= end)]
        if not len(order):
            length = (int(times.max()) - int(times.min())) / NANO
            raise InputError(f"start_offset {p.start_offset:g} s is behind the end: the recording has {length:.3f} s")
        self._times = times[order]
        # No clock has times below 0, and 0 is none: a log that counts from its own start is put off by the lead.
        self._times += max(1 + self._lead - int(self._times[0]), 0)
        self._items = [sources.items[i] for i in order]
        if p.clock:
            self._clock_output = self.create_publisher(Clock, "/clock", LOSSLESS)
        self._consumers = Consumers(self, self._condition)
        self._servers = (
            self.create_service(Trigger, "~/restart", self._on_restart),
            rosbag2.offer(self, "pause", "Pause", lambda: self._pause(True)),
            rosbag2.offer(self, "resume", "Resume", lambda: self._pause(False)),
            rosbag2.offer(self, "toggle_paused", "TogglePaused", lambda: self._pause(not self._paused)),
            rosbag2.offer(self, "is_paused", "IsPaused", lambda: self._paused),
            rosbag2.offer(self, "get_rate", "GetRate", lambda: float(self.parameters.rate)),
            rosbag2.offer(self, "set_rate", "SetRate", self._set_rate),
            rosbag2.offer(self, "seek", "Seek", self._seek_time),
            rosbag2.offer(self, "play_next", "PlayNext", lambda: self._burst(1) == 1),
            rosbag2.offer(self, "burst", "Burst", self._burst),
            rosbag2.offer(self, "stop", "Stop", self._end_here),
        )

    def start(self) -> None:
        self._ended = False
        self._moved = True
        self._consumers.ask(SETTINGS.look_every)
        self._thread = threading.Thread(target=self._guarded_run, name="replay", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        if self._thread is not None:
            with self._condition:
                self._ended = True
                self._condition.notify_all()
            self._thread.join()
            self._thread = None
            self._consumers.ask_no_more()

    def release(self) -> None:
        self.stop()
        if self._sources is not None:
            self._sources.close()
        for server in self._servers:
            self.destroy_service(server)
        if self._clock_output is not None:
            self.destroy_publisher(self._clock_output)
        if self._servers:  # which are made after the readers of what consumers answer
            self._consumers.close()
        self._servers = ()
        self._clock_output = None

    # The thread that sends

    def _guarded_run(self) -> None:
        try:
            self._run()
        except Exception as error:  # the node must end with a message, not hang with a dead thread
            self.get_logger().fatal(f"replay ended: {error if isinstance(error, InputError) else repr(error)}")
            self.exit_code = 2 if isinstance(error, InputError) else 1
            if self.finish is not None:
                self.finish()

    def _run(self) -> None:
        first = int(self._times[0])
        self._now = first - self._lead
        if not self._wait_for_the_others():
            return
        self._consumers.complete()
        self.get_logger().info("begins")
        tick = self._now
        self._position = reported = 0
        total = len(self._times)
        while True:
            with self._condition:
                while self._paused and not self._single and not self._ended and self._seek is None:
                    self._moved = True
                    self._condition.wait()
                if self._ended:
                    return
                if self._seek is not None:
                    tick = self._go_to(max(self._seek, first))
            if self._position == total:
                self._at_end(first)
                continue
            due = int(self._times[self._position])
            rate = self.parameters.rate
            if self._single:
                self._now = tick = due
                self._publish_clock(due)
            elif self._clock_output is not None and tick <= due:
                if self._wait_until(tick):
                    self._publish_clock(tick)
                    tick += SETTINGS.fast_tick if rate == 0 else round(SETTINGS.tick * max(rate, 1.0))
                continue
            if self._single or self._wait_until(due):
                self._single = max(self._single - 1, 0)
                self._send_next()
                if self._position * 100 // total != reported:
                    reported = self._position * 100 // total
                    self.get_logger().info(f"{reported} %")

    def _go_to(self, moment: int) -> int:
        """Go on from a time of the recording [ns], which is returned. The caller holds the condition."""
        self._position = int(np.searchsorted(self._times, moment))
        self._seek = None
        self._now = moment
        self._consumers.forget_progress()
        self._moved = True
        self._finished = False
        return moment

    def _at_end(self, first: int) -> None:
        """Begin again at the time `first` [ns] if asked to; else say once that all is sent, and wait for a seek."""
        if self.parameters.loop:
            self._seek = first
            return
        if not self._finished:
            self._drain()
            self._finished = True
            self.get_logger().info("finished: everything is sent")
            if self.parameters.exit_at_end and self.finish is not None:
                self.finish()
        with self._condition:
            if not self._ended and self._seek is None:
                self._condition.wait(0.5)

    def _send_next(self) -> None:
        """Send the message at the present position, and count for whom it was not taken."""
        source, item = self._items[self._position]
        name, send = self._senders[source]
        not_taken = send(item)
        if not_taken:
            self._not_taken[name] = self._not_taken.get(name, 0) + not_taken
        self._position += 1

    def _wait_until(self, moment: int) -> bool:
        """Wait for a time of the recording [ns]; False if something else has to be done first."""
        rate = self.parameters.rate
        if rate == 0:
            return self._wait_for_consumers(moment - round(self.parameters.window * NANO))
        wall = time.monotonic_ns()
        if self._moved:
            self._moved = False
            self._origin = (wall, self._now)
            if self._published:  # a time that stands still is no time that comes late
                self._publish_clock(self._published)
        began, at = self._origin
        wait = began + (moment - at) / rate - wall
        if wait > 0:
            with self._condition:
                if self._paused or self._ended or self._seek is not None or self._moved:
                    return False
                if self._condition.wait(wait * 1e-9):
                    return False
        self._now = moment
        return True

    def _wait_for_consumers(self, moment: int) -> bool:
        with self._condition:
            while self._consumers.behind(moment):
                if self._paused or self._ended or self._seek is not None:
                    return False
                if not self._condition.wait(SETTINGS.send_again):
                    self._publish_clock(self._published)  # to one that began to listen anew meanwhile
        return True

    def _publish_clock(self, stamp: int) -> None:
        if self._clock_output is not None:
            self._published = stamp
            seconds, nanoseconds = divmod(stamp, NANO)
            self._clock_output.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))

    def _wait_for_the_others(self) -> bool:
        """Give subscribers, consumers and readers of ports the time to appear; False if the replay ended meanwhile."""
        p = self.parameters
        deadline = time.monotonic() + p.wait
        consumers = max(p.consumers, 1 if p.rate == 0 else 0)
        clock_due = 0.0
        while True:
            missing = [what for what, ready in self._waiting_for if not ready()]
            # What is true of a drive is for comparison: a recorder may take it, an observer does not.
            unheard = [topic for topic in self.outputs.unheard if not topic.startswith("reference/")]
            missing += [f"a subscriber of {topic}" for topic in unheard]
            if consumers and time.monotonic() >= clock_due:  # each answer of a consumer ends the wait below
                self._publish_clock(self._now)
                clock_due = time.monotonic() + SETTINGS.look_every
            with self._condition:
                listening, expected = self._consumers.listening(consumers)
                if listening < expected:
                    missing.append(f"{expected - listening} of {expected} consumers")
                if self._ended:
                    return False
                if not missing:
                    return True
                if time.monotonic() > deadline:
                    text = f"waited {p.wait:g} s in vain for {', '.join(missing)}"
                    if listening < consumers:
                        raise InputError(f"{text}; a consumer is an observer or a recorder that is active")
                    self.get_logger().warning(text)
                    return True
                self._condition.wait(SETTINGS.look_every)

    def _drain(self) -> None:
        """Wait until the consumers have worked off everything, and then what the first made for the others."""
        last = int(self._times[-1])
        for moment in (last + 1_000_000, last + 2_000_000):
            self._publish_clock(moment)
            deadline = time.monotonic() + self.parameters.wait
            with self._condition:
                while (behind := self._consumers.behind(moment)) and not self._ended:
                    if time.monotonic() > deadline:
                        self.get_logger().warning(f"{', '.join(behind)} did not finish in {self.parameters.wait:g} s")
                        return
                    if not self._condition.wait(SETTINGS.send_again):
                        self._publish_clock(moment)

    # What comes from outside

    def _pause(self, paused: bool) -> None:
        with self._condition:
            self._paused = paused
            self._moved = True
            self._condition.notify_all()

    def _set_rate(self, rate: float) -> bool:
        wanted = Parameter("rate", value=rate)
        return bool(self.set_parameters([wanted])[0].successful)

    def _seek_time(self, time: Time) -> bool:
        """To a time of the recording; False where it has none such."""
        target = rosbag2.nanoseconds(time)
        if not self._times[0] <= target <= self._times[-1]:
            return False
        self._move(target)
        return True

    def _burst(self, count: int) -> int:
        """Send the next messages while it is paused; how many there are."""
        if not self._paused or self._finished:
            return 0
        possible = min(count or len(self._times), len(self._times) - self._position)
        with self._condition:
            self._single += possible
            self._condition.notify_all()
        return possible

    def _end_here(self) -> None:
        self._move(int(self._times[-1]) + 1)
        with self._condition:
            self._paused = False
            self._condition.notify_all()

    def _on_restart(self, _: Any, response: Any) -> Any:
        self._move(int(self._times[0]))
        response.success, response.message = True, "at the start"
        return response

    def _move(self, target: int) -> None:
        with self._condition:
            self._seek = target
            self._condition.notify_all()

    def parameters_changed(self, names: Collection[str]) -> None:
        if self._thread is None:
            return
        if "position" in names and self.parameters.position >= 0:
            wanted = int(self._times[0]) + round(self.parameters.position * NANO)
            self._move(min(wanted, int(self._times[-1])))
        with self._condition:
            self._moved = True
            self._condition.notify_all()

    def diagnostics(self) -> list[Diagnostic]:
        seconds = (self._now - int(self._times[0])) / NANO
        values = {"position [s]": f"{seconds:.2f}", "rate": f"{self.parameters.rate:g}"}
        values |= {f"not taken: {name}": str(count) for name, count in self._not_taken.items()}
        if self._not_taken:
            return [Diagnostic("replay", Level.WARN, f"nobody took all of {', '.join(self._not_taken)}", values)]
        text = "finished" if self._finished else "paused" if self._paused else "running"
        return [Diagnostic("replay", Level.OK, text, values)]

    def summary(self) -> dict[str, Any]:
        seconds = (int(self._times[-1]) - int(self._times[0])) / NANO
        return {**super().summary(), "not_taken": self._not_taken, "lost_in_bag": self.lost_in_bag, "seconds": seconds}


def main() -> int:
    """Entry point of `ros2 run vsense_ros replay`."""
    return run_node(Replay, ReplayParameters)


if __name__ == "__main__":
    sys.exit(main())
