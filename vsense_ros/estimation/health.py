"""What became of each sensor's messages, and the line of diagnostics about it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from vsense_ros.estimation.source import Source
from vsense_ros.messages.diagnostic import Diagnostic, Level

PATIENCE = 2_000_000_000  # [ns] of refusals in a row, after which it may be the filter that is wrong, and


@dataclass(frozen=True)
class HealthSettings:
    """When a sensor counts as silent or as contradicted: decisions of this project."""

    refusals: int = 5  # at least so many
    recent: int = 512  # stamps kept, to tell a repeated message from one that was overtaken
    periods: float = 10.0  # without a message, after which a sensor is silent, but not before
    shortest: float = 0.15  # [s], in which an operating system, or the end of a recording, may well hold messages back
    share: float = 0.05  # of the newest interval in the mean of intervals


SETTINGS = HealthSettings()


@dataclass
class Health:
    """Counters of one sensor, and its latest problem."""

    used: int = 0
    refused: int = 0  # by the gate
    refused_in_a_row: int = 0
    refused_from: int = 0  # stamp of the first of these, and
    refused_to: int = 0  # of the last [ns]
    late: int = 0  # re-propagated
    too_late: int = 0
    invalid: int = 0
    last_stamp: int = 0  # newest that was believed [ns]
    last_received: int = 0  # of any message, believed or not [ns]
    period: float = 0.0  # between messages, on average [s]
    back: int = 0  # arrival of the first message after the last silence [ns]
    problem: str = ""
    problem_at: int = 0  # arrival of the message that had it [ns]
    innovation_ratio: float = 1.0  # smoothed NIS over its expectation
    same_in_a_row: int = 0  # messages with equal content
    last_content: bytes = b""
    noise: str | None = None  # standard deviations that count, and whose they are
    noisier: Mapping[int, tuple[float, float]] = field(default_factory=dict)  # components, as of `SensorNoise`
    complete_at: int = 0  # stamp of the newest measurement that had all components [ns]
    component_at: dict[int, int] = field(default_factory=dict)  # of each of others [ns], 0: it never came
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=SETTINGS.recent))

    def receive(self, arrival: int, sensor: Source) -> None:
        """A message has arrived [ns]."""
        gap = (arrival - self.last_received) * 1e-9
        if self.last_received and gap > 0:
            # No silence that counts is shorter, and these comparisons cost less.
            if (gap > SETTINGS.shortest or gap > sensor.timeout) and gap > self.longest_silence(sensor):
                self.back = arrival
            elif not self.period:
                self.period = gap
            else:
                self.period += SETTINGS.share * (gap - self.period)
        self.last_received = arrival

    def lacks(self, value: list[float], stamp: int) -> None:
        """A measurement has come without some of its components, which are NaN."""
        for component, number in enumerate(value):
            if number == number:
                self.component_at[component] = stamp
            else:
                self.component_at.setdefault(component, self.complete_at)

    def absent(self, sensor: Source) -> list[int]:
        """Components that have come, and do not come any more while others do."""
        return [i for i in self.lacking(sensor) if self.component_at[i]]

    def lacking(self, sensor: Source) -> list[int]:
        """Components that do not come, though others do."""
        longest = self.last_stamp - self.longest_silence(sensor) * 1e9
        return [i for i, at in self.component_at.items() if max(at, self.complete_at) < longest]

    def longest_silence(self, sensor: Source) -> float:
        """Silence after which the sensor counts as lost [s]: ten periods, its `timeout` at most."""
        if not self.period:
            return sensor.timeout
        return min(sensor.timeout, max(SETTINGS.periods * self.period, SETTINGS.shortest))

    def complain(self, why: str) -> None:
        """Keep a problem of the newest message."""
        self.problem, self.problem_at = why, self.last_received

    @property
    def contradicts(self) -> bool:
        """True if it was refused for so long that it may be the filter that is wrong."""
        return self.refused_in_a_row >= SETTINGS.refusals and self.refused_to - self.refused_from >= PATIENCE

    def diagnostic(self, name: str, sensor: Source, now: int) -> Diagnostic:
        """One line; `now` [ns] on the clock of arrivals."""
        values = {
            "used": str(self.used),
            "refused": str(self.refused),
            "late": str(self.late),
            "too_late": str(self.too_late),
            "invalid": str(self.invalid),
            "innovation_ratio": f"{self.innovation_ratio:.2f}",
        }
        if self.noise:
            values["standard deviation"] = self.noise
        if not self.last_received:
            return Diagnostic(name, Level.STALE, f"no message on {sensor.topic}", values)
        silent, longest = (now - self.last_received) * 1e-9, self.longest_silence(sensor)
        doubted = self.back > 0 and 0 <= now - self.back < 2e9 * longest
        # Who comes and goes has one state, not two in turn.
        if silent > (2 * longest if doubted else longest):
            return Diagnostic(name, Level.STALE, f"silent for {silent:.1f} s on {sensor.topic}", values)
        if not self.last_stamp:
            return Diagnostic(name, Level.STALE, f"no usable message on {sensor.topic}: {self.problem}", values)
        if self.problem and abs(self.last_received - self.problem_at) < 2e9:
            level = Level.ERROR if self.contradicts else Level.WARN
            return Diagnostic(name, level, self.problem, values)
        if doubted:
            return Diagnostic(name, Level.WARN, f"back after a silence, for {(now - self.back) * 1e-9:.1f} s", values)
        return Diagnostic(name, Level.OK, "in use", values)
