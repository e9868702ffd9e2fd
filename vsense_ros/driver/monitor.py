"""Health of one stream of measurements: rate, silence, faults and the order of its time stamps.

All drivers share it, so that a silent CAN message and a silent IMU are judged and worded alike.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass

from vsense_ros.messages.diagnostic import Diagnostic, Level

NANO = 1_000_000_000
LATEST = 2**31 * NANO  # [ns] what the stamp of a message, whose seconds have 32 bits, can no longer hold


@dataclass(frozen=True, slots=True)
class StreamLimits:
    """What is normal for a stream.

    A fault colours the diagnostic for `fault_hold` seconds. A stamp that is not later than the one before, or later by
    more than `max_gap`, is refused; after `resync_after` refused stamps in a row that agree with each other the
    clock is taken to have been set, and the stream goes on from there.
    """

    timeout: float  # [s] silence longer than this makes the stream stale
    nominal_rate: float | None = None  # [Hz]; None: no expectation
    max_gap: float = 10.0  # [s]
    resync_after: int = 5
    fault_hold: float = 2.0  # [s]


class StreamMonitor:
    """Judges the stamps of one stream, counts its faults and reports its health.

    Times are integer nanoseconds. `at` is the time of arrival, in the clock that is later given to `diagnostic`;
    where a driver knows no such time it is the stamp itself.
    """

    RATE_WINDOW = 64
    LOWEST_RATE, HIGHEST_RATE = 0.7, 1.5  # relative to the nominal rate

    def __init__(self, name: str, limits: StreamLimits) -> None:
        self.name = name
        self.limits = limits
        self._max_gap = limits.max_gap * NANO
        self.accepted = 0
        self.faults: Counter[str] = Counter()
        self.doubts: Counter[str] = Counter()
        self.others: Counter[str] = Counter()  # what came and was rightly passed over
        self.absence = ""  # why nothing may ever have been received, as the driver knows it
        self._last_stamp: int | None = None
        self._last_at: int | None = None
        self._last_heard: int | None = None
        self._stray_stamp: int | None = None
        self._strays = 0
        self._recent: deque[int] = deque(maxlen=self.RATE_WINDOW)
        self._recent_faults: dict[str, tuple[int, Level]] = {}

    @property
    def last_stamp(self) -> int | None:
        """Stamp of the newest accepted measurement [ns]."""
        return self._last_stamp

    def fault(self, reason: str, at: int, level: Level = Level.WARN) -> None:
        """Count a fault that is not about time stamps (a checksum, a NaN …)."""
        self.faults[reason] += 1
        self._recent_faults[reason] = (at, level)
        self._last_heard = at

    def note(self, reason: str, at: int) -> None:
        """Count a doubt about a measurement that is passed on all the same."""
        self.doubts[reason] += 1
        self._recent_faults[reason] = (at, Level.WARN)

    def passed(self, what: str) -> None:
        """Count what is no measurement and no fault."""
        self.others[what] += 1

    def accept(self, stamp: int, at: int | None = None) -> bool:
        """True if a measurement with this stamp belongs in the stream; if not, the fault is counted.

        With `at`, a long gap between stamps is accepted where the arrivals show the same gap.
        """
        last = self._last_stamp
        if last is not None and last < stamp < LATEST and stamp - last <= self._max_gap:  # as nearly always
            self._strays = 0
            self._take(stamp, at)
            return True
        if not 0 <= stamp < LATEST:
            self.fault("time stamp out of range", at if at is not None else self._last_stamp or 0)
            return False
        reason = self._objection(stamp, at)
        if reason is None:
            self._strays = 0
        else:
            follows = self._stray_stamp is not None and 0 < stamp - self._stray_stamp <= self.limits.max_gap * NANO
            if reason != "duplicated time stamp":
                self._strays = self._strays + 1 if follows and self._strays else 1
                self._stray_stamp = stamp
            # Arrival is the clock of the reports; without one, the last stamp that was believed stands for it.
            when = at if at is not None else self._last_stamp if self._last_stamp is not None else stamp
            if self._strays < self.limits.resync_after:
                self.fault(reason, when)
                return False
            when = at if at is not None else stamp
            self._strays = 0
            self._recent.clear()
            self._recent_faults.clear()
            self.note("clock was set to another time", when)
        self._take(stamp, at)
        return True

    def _take(self, stamp: int, at: int | None) -> None:
        self._last_stamp = stamp
        self._last_at = at
        self._last_heard = at if at is not None else stamp
        self._recent.append(stamp)
        self.accepted += 1

    def _objection(self, stamp: int, at: int | None) -> str | None:
        if self._last_stamp is None:
            return None
        step = stamp - self._last_stamp
        if step == 0:
            return "duplicated time stamp"
        if step < 0:
            return "time stamp going backwards"
        if step > self.limits.max_gap * NANO:
            known = at is not None and self._last_at is not None
            if not known or abs(step - (at - self._last_at)) > self.limits.max_gap * NANO:  # type: ignore[operator]
                return "time stamp jumping ahead"
        return None

    def rate(self) -> float | None:
        """Mean rate of the latest accepted stamps [Hz]; None before there are enough."""
        if len(self._recent) < self.RATE_WINDOW // 4:
            return None
        return (len(self._recent) - 1) * NANO / (self._recent[-1] - self._recent[0])

    def diagnostic(self, now: int, values: Mapping[str, str] | None = None) -> Diagnostic:
        """Health at the time `now` [ns]; calling it changes nothing."""
        figures = {"accepted": str(self.accepted), "dropped": str(sum(self.faults.values()))}
        rate = self.rate()
        if rate is not None:
            figures["rate [Hz]"] = f"{rate:.1f}"
        if self.limits.nominal_rate is not None:
            figures["nominal rate [Hz]"] = f"{self.limits.nominal_rate:g}"
        figures |= {reason: str(count) for reason, count in (self.faults + self.doubts + self.others).items()}
        figures |= dict(values or {})
        level, message = self._judge(now, rate)
        return Diagnostic(self.name, level, message, figures)

    def _judge(self, now: int, rate: float | None) -> tuple[Level, str]:
        # `now` lies before `at` where it comes from a clock that ticks, and far before where the clock was set back.
        hold = self.limits.fault_hold * NANO
        recent = {r: level for r, (at, level) in self._recent_faults.items() if abs(now - at) <= hold}
        faults = ", ".join(recent)
        silence = self.limits.timeout * NANO
        if self._last_heard is None:
            return Level.STALE, f"never received: {self.absence}" if self.absence else "never received"
        if now - self._last_heard > silence:
            return (
                Level.STALE,
                f"silent for {(now - self._last_heard) / NANO:.2f} s (timeout {self.limits.timeout:g} s)",
            )
        reference = self._last_at if self._last_at is not None else self._last_stamp
        if reference is None or now - reference > silence:
            return Level.ERROR, f"nothing usable: {faults or 'no valid measurement'}"
        if recent:
            return max(recent.values()), faults
        nominal = self.limits.nominal_rate
        if nominal is None or rate is None or self.LOWEST_RATE * nominal <= rate <= self.HIGHEST_RATE * nominal:
            return Level.OK, "ok"
        return Level.WARN, f"rate {rate:.1f} Hz, nominal {nominal:g} Hz"
