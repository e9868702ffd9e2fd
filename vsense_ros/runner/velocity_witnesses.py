"""Direct witnesses of where the car went: who is wrong where wheels, GNSS velocity and GNSS position contradict.

Each of them gives the displacement of the car within some seconds by an equation of its own:

    wheels     ∫ v (cos ψ, sin ψ) dt    with the median v of the rolling speeds, as the middle of the rear axle and the
                                        antenna then have it, and the heading ψ of the filter
    velocity   ∫ (v_east, v_north) dt
    position   p(t) - p(t - T)

Of a car without wheel speeds the inertial sensor is asked in their place: from a velocity that was measured at the
beginning, and the acceleration along the car since then, less its mean error of the last half minute. It is never found
to be wrong itself, and depends too much on the velocity to show that a position is.

Where wheels and velocity contradict each other, the one is wrong that the position contradicts more, by the ratio of
the likelihoods of both; where they agree, and the position contradicts both, the position is. Wheels know no side
slip, so that they are compared by the lengths of displacements, and by whether they go the same way. A position whose
stamps are late by τ is wrong by τ times what the velocity changes by, which no witness is blamed for.

In a bend at a yaw rate r, where the rear axle does not slip, a wheel at (x, y) from its middle rolls at

    sqrt((v - r y)² + (r x)²)    and an antenna there moves at (v - r y, r x).
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import copysign, cos, hypot, isfinite, nan, sin, sqrt
from typing import NamedTuple

from vsense_ros.estimation.timeline import Event
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class VelocityWitnessSettings:
    """Margins and times; they were chosen such that no healthy recording of ours has a contradiction, and are decisions
    of this project."""

    windows: tuple[float, ...] = (1.0, 3.0, 10.0)  # [s] over which displacements are compared
    period: float = 0.3  # [s] between comparisons
    longest_gap: float = 1.5  # [s] between two messages that are still one way
    share: float = 0.03  # [-] of the way: radius, slip, side slip
    speed: float = 0.3  # [m/s] slip, and stamps that are early or late while the speed changes
    late: float = 0.15  # [s] by which a position may be later or earlier than the velocities
    ends: float = 0.2  # [s] at both ends of a window, in which the velocities are averaged that change meanwhile
    tyres: float = 10.0  # [m/s²] across, beyond which no yaw rate is that of a car
    deviations: float = 3.0  # [-] of the noise of two positions
    averaged: int = 8  # [-] positions
    restart: float = 10.0  # [m] by which a position jumps, or the way of the velocities begins anew
    evidence: float = 4.5  # [-] logarithm of the ratio of likelihoods that decides between wheels and velocity
    confirmed: int = 1  # [-] further comparisons in a row that give the same verdict
    before: float = 2.0  # [s] before a contradiction; inertial axes left out since then may have been right
    longest_wait: float = 3.0  # [s] in which no inertial axis is left out, as one of the witnesses may be wrong
    doubted: float = 2.0  # [m/s] by which a sensor that was wrong may have drawn the velocity, at most
    sideways: float = 0.3  # [-] share of a wrong velocity that may be lateral
    felt: float = 4.0  # [s] longest window over which an acceleration is integrated,
    bias: float = 0.1  # [m/s²] with this error that lasts: slopes, bias
    bias_time: float = 30.0  # [s] over which its mean error is taken
    sliding: float = 3.0  # [m/s²] longitudinal acceleration from which on wheels may slide, until
    rolling_again: float = 0.5  # [s] later
    agreed: float = 2.0  # [s] of agreement after which a sensor is believed again; twice as long each time, up
    longest: float = 60.0  # [s] to this


SETTINGS = VelocityWitnessSettings()


class Place(NamedTuple):
    """Where a way has come to [m] at a time [ns], east and north of where it began."""

    stamp: int
    east: float
    north: float


class Way:
    """The way that one sensor says the car went, as long as the longest window."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._places: list[Place] = []
        self._velocity = (0.0, 0.0)

    @property
    def newest(self) -> int:
        """Stamp of the newest place [ns]; 0 if there is none."""
        return self._stamps[-1] if self._stamps else 0

    def clear(self) -> None:
        """Forget everything."""
        self._stamps.clear()
        self._places.clear()

    def go(self, stamp: int, east: float, north: float) -> None:
        """Take in a velocity [m/s]: the way is its integral by the trapezoidal rule."""
        if not isfinite(east + north):
            return
        last = self._places[-1] if self._follows(stamp) else Place(stamp, 0.0, 0.0)
        half = 0.5e-9 * (stamp - last.stamp)
        before = self._velocity
        self._velocity = (east, north)
        self.be(stamp, last.east + half * (before[0] + east), last.north + half * (before[1] + north))

    def be(self, stamp: int, east: float, north: float) -> None:
        """Take in a place [m]."""
        if not isfinite(east + north) or (stamp <= self.newest and self._follows(stamp)):
            return
        if not self._follows(stamp):
            self.clear()
        self._stamps.append(stamp)
        self._places.append(Place(stamp, east, north))
        if len(self._stamps) > 256 and self._stamps[128] < stamp - 1.2e9 * SETTINGS.windows[-1]:
            del self._stamps[:128], self._places[:128]

    def reverse(self) -> None:
        """All of the way was the other way round."""
        self._places = [Place(stamp, -east, -north) for stamp, east, north in self._places]
        self._velocity = (-self._velocity[0], -self._velocity[1])

    def _follows(self, stamp: int) -> bool:
        """True if a message belongs to the same way as those before."""
        return bool(self._stamps) and abs(stamp - self._stamps[-1]) <= SETTINGS.longest_gap * 1e9

    def at(self, stamp: int) -> tuple[float, float] | None:
        """Where the way was at a time [ns], between two messages; None where it is not known."""
        i = bisect_right(self._stamps, stamp)
        if not 0 < i < len(self._stamps):
            return None if not i or self._stamps[-1] != stamp else self._places[-1][1:]
        before, after = self._places[i - 1], self._places[i]
        share = (stamp - before.stamp) / (after.stamp - before.stamp)
        return before.east + share * (after.east - before.east), before.north + share * (after.north - before.north)

    def ahead(self, stamp: int) -> tuple[float, float] | None:
        """Where the way was at a time [ns], or is when it goes on as at its end; None where it is not known."""
        if not self._places or stamp <= self.newest:
            return self.at(stamp)
        if not self._follows(stamp):
            return None
        last, h = self._places[-1], (stamp - self.newest) * 1e-9
        return last.east + h * self._velocity[0], last.north + h * self._velocity[1]

    def over(self, stamp: int) -> tuple[float, float] | None:
        """The mean velocity around a time [ns], [m/s]; None where it is not known."""
        half = int(0.5e9 * SETTINGS.ends)
        moved = self.between(stamp - half, stamp + half)
        return None if moved is None else (moved[0] / SETTINGS.ends, moved[1] / SETTINGS.ends)

    def between(self, begin: int, end: int) -> tuple[float, float] | None:
        """The displacement from one time to another [ns], [m]; None where it is not known."""
        first, last = self.at(begin), self.at(end)
        if first is None or last is None:
            return None
        return last[0] - first[0], last[1] - first[1]


class Felt:
    """The way that follows from accelerations along the car, from a velocity that is known at its beginning.

    With g the integral of the acceleration, and e the direction in which the car points, it is

        (v₀ - g₀) ∫ e dt + ∫ g e dt.
    """

    def __init__(self) -> None:
        self._ahead, self._gained, self._gains = Way(), Way(), Way()
        self._gain = self._bias = 0.0  # [m/s] and [m/s²]
        self._stamp = 0  # [ns]

    def feel(self, stamp: int, acceleration: float, heading: float) -> None:
        """Take in an acceleration along the car [m/s²]."""
        h, self._stamp = (stamp - self._stamp) * 1e-9, stamp
        if not 0 < h < SETTINGS.longest_gap or not isfinite(acceleration):
            self._ahead.clear()
            return
        self._gain += h * (acceleration - self._bias)
        c, s = cos(heading), sin(heading)
        self._ahead.go(stamp, c, s)
        self._gained.go(stamp, self._gain * c, self._gain * s)
        self._gains.be(stamp, self._gain, 0.0)

    @property
    def newest(self) -> int:
        """Stamp of the newest place [ns]; 0 if there is none."""
        return self._ahead.newest

    def learn(self, velocity: Way, begin: int, end: int) -> None:
        """Take in by how much the velocity changed from one time to another [ns], whose mean acceleration is right."""
        ends = [velocity.over(stamp) for stamp in (begin, end - int(0.5e9 * SETTINGS.ends))]
        gains = [self._gains.at(begin), self._gains.at(end - int(0.5e9 * SETTINGS.ends))]
        if ends[0] is None or ends[1] is None or gains[0] is None or gains[1] is None:
            return
        seconds = (end - begin) * 1e-9 - 0.5 * SETTINGS.ends
        error = (gains[1][0] - gains[0][0] - hypot(*ends[1]) + hypot(*ends[0])) / seconds
        self._bias += SETTINGS.period / SETTINGS.bias_time * error

    def between(self, velocity: Way, begin: int, end: int) -> tuple[float, float] | None:
        """The displacement from one time to another [ns], [m], by the velocity at the first; None where it is not
        known."""
        first, gain = velocity.over(begin), self._gains.at(begin)
        ahead, gained = self._ahead.between(begin, end), self._gained.between(begin, end)
        if first is None or gain is None or ahead is None or gained is None:
            return None
        more = hypot(*first) - gain[0]
        return more * ahead[0] + gained[0], more * ahead[1] + gained[1]


@dataclass
class _Comparison:
    """Pairs of witnesses, by their places, whose displacements are apart or agree over any of the windows; those that
    are apart over a short one, `lately`; and by how much at most [m/s].

    `evidence` is the logarithm of the ratio of likelihoods of velocity and wheels, positive against the wheels;
    `opposite` is true if wheels that go the other way would agree with the velocity.
    """

    apart: set[frozenset[int]] = field(default_factory=set)
    together: set[frozenset[int]] = field(default_factory=set)
    lately: set[frozenset[int]] = field(default_factory=set)
    apart_by: float = 0.0
    evidence: float = 0.0
    opposite: bool = False

    def agrees(self, index: int) -> bool:
        """True if a witness agrees with another one and has not contradicted any of late."""
        return not any(index in pair for pair in self.lately) and any(index in pair for pair in self.together)


class VelocityWitnesses:
    """Wheels, or without them the inertial sensor, velocity and position of one car; `hear` takes every message in
    order of arrival.

    `wrong` is the place of the sensor that is wrong, None for none or as long as that is not clear; `since` the stamp
    since when two of them have contradicted each other [ns], 0 while none do. `opposite` is true if the wheels are
    wrong and would be right with the other sign. `apart_by` is by how much the speeds differ at most [m/s].
    """

    def __init__(self, vehicle: Vehicle, sensors: Mapping[str, SensorBase]) -> None:
        self._sensors = tuple(sensors.values())
        self.wheels = place_of(self._sensors, "rolling speed")
        self.velocity = place_of(self._sensors, "course")
        self.position = place_of(self._sensors, "position")
        car = car_numbers(vehicle)
        self._radius, self._base = car["rear_radius"], car["to_front"] + car["to_rear"]
        self._to_left = [side * car[f"{axle}_half_track"] for axle in ("front", "rear") for side in (1, -1)]
        antenna = (0.0, 0.0, 0.0) if self.velocity < 0 else self._sensors[self.velocity].mounting().tolist()[:3]
        self._antenna = car["to_rear"] + antenna[0], antenna[1]  # from the middle of the rear axle [m]
        self.forget()

    @property
    def possible(self) -> bool:
        """True if there are three witnesses."""
        felt = place_of(self._sensors, "rates and forces")
        return min(max(self.wheels, felt), self.velocity, self.position) >= 0

    def forget(self) -> None:
        """The filter begins anew."""
        self._felt = Felt()
        self._ways = {i: Way() for i in (self.wheels, self.velocity, self.position)}
        self._variance = 0.0  # of a position, averaged [m²]
        self._yaw_rate = 0.0  # [rad/s] that the inertial sensor felt last
        compared = self.wheels, self.velocity
        # Of positions from the ways of both: the newest offsets, and how their mean goes on.
        self._offsets = {i: deque[tuple[float, float]](maxlen=SETTINGS.averaged) for i in compared}
        self._offset_ways = {i: Way() for i in compared}
        self._compared = self._streak = 0
        self._sliding_until = 0  # [ns]
        self._suspect: int | None = None
        self.wrong: int | None = None
        self.opposite = False
        self.apart_by = 0.0
        self.since = 0
        self.agreed = dict.fromkeys(self._ways, 0)  # since when each has agreed with another one [ns], 0: it does not

    def hear(self, event: Event, heading_of: Callable[[], float]) -> None:
        """Take in a message; `heading_of` gives the heading of the filter [rad]."""
        index = event.sensor
        way = self._ways[index]
        if index == self.wheels:
            if event.stamp < self._sliding_until:
                way.clear()
                return
            c, s = cos(heading := heading_of()), sin(heading)
            along, across = self._rolled(event.value.tolist())
            way.go(event.stamp, along * c - across * s, along * s + across * c)
            return
        east, north = event.value.tolist()[:2]
        if index == self.velocity:
            way.go(event.stamp, east, north)
        else:
            self._locate(event)
        end = min(self._felt.newest if i < 0 else way.newest for i, way in self._ways.items())
        if abs(end - self._compared) >= SETTINGS.period * 1e9:
            self._compared = end
            self._compare(end)

    def _rolled(self, spins: list[float]) -> tuple[float, float]:
        """Velocity along and across the car at the antenna [m/s], where no axle slips, by spins of the wheels."""
        speeds = [self._radius * spin for spin in spins]
        most = SETTINGS.tyres / max(abs(_median(speeds)), 1.0)
        rate = min(max(self._yaw_rate, -most), most)
        for i in (0, 1):
            speeds[i] = copysign(sqrt(max(speeds[i] ** 2 - (rate * self._base) ** 2, 0.0)), speeds[i])
        forward = _median([speed + rate * left for speed, left in zip(speeds, self._to_left, strict=True)])
        ahead, left = self._antenna
        return forward - rate * left, rate * ahead

    def feel(self, stamp: int, felt: list[float], heading: float = 0.0) -> None:
        """Take in an inertial reading (6) in the axes of the car, which points at a heading [rad]: where brakes or
        engine act strongly, wheels may slide, and are not asked."""
        if self.wheels < 0:
            self._felt.feel(stamp, felt[3], heading)
        self._yaw_rate = felt[2] if isfinite(felt[2]) else 0.0
        if abs(felt[3]) > SETTINGS.sliding:
            self._sliding_until = stamp + int(SETTINGS.rolling_again * 1e9)

    def _locate(self, event: Event) -> None:
        """Take in a position: its noise is averaged over several, as offsets from the ways of wheels and velocity."""
        stamp = event.stamp
        east, north = event.value.tolist()[:2]
        self._ways[self.position].be(stamp, east, north)
        for index, way in self._offset_ways.items():
            there, offsets = self._ways[index].ahead(stamp), self._offsets[index]
            if there is None or not isfinite(east + north):
                offsets.clear()
                way.clear()
                continue
            offset = east - there[0], north - there[1]
            if offsets and _length(offset, offsets[-1]) > SETTINGS.restart:
                offsets.clear()
            offsets.append(offset)
            count = len(offsets)
            way.be(stamp, sum(one[0] for one in offsets) / count, sum(one[1] for one in offsets) / count)
            self._variance = float(event.variance.max()) / count

    def reverse_wheels(self) -> None:
        """The wheels have turned the other way than they said."""
        self._ways[self.wheels].reverse()
        self._offsets[self.wheels].clear()
        self._offset_ways[self.wheels].clear()
        self.wrong, self.opposite, self._streak, self.since = None, False, 0, 0

    def _compare(self, end: int) -> None:
        """Compare the ways up to the time [ns] that all of them have come to."""
        seen = _Comparison()
        for window in SETTINGS.windows:
            self._compare_over(window, end, seen)
        seen.together -= seen.apart
        if self.wheels < 0 and not seen.apart:
            self._felt.learn(self._ways[self.velocity], end - int(SETTINGS.windows[1] * 1e9), end)
        self.apart_by = seen.apart_by
        self.since = (self.since or end) if seen.apart else 0
        now = max(way.newest for way in self._ways.values())
        for i in self._ways:
            self.agreed[i] = (self.agreed[i] or now) if seen.agrees(i) else 0
        suspect = self._suspected(seen)
        self._streak = self._streak + 1 if suspect is not None and suspect == self._suspect else 0
        self._suspect = suspect
        self.wrong = suspect if self._streak >= SETTINGS.confirmed else None
        self.opposite = self.wrong == self.wheels and seen.opposite

    def _compare_over(self, window: float, end: int, seen: _Comparison) -> None:
        """Compare the displacements over a window [s] up to a time [ns]."""
        wheels, velocity, position = self._ways
        begin = end - int(window * 1e9)
        ways = {i: way.between(begin, end) for i, way in self._ways.items()}
        positions = {i: self._position(i, ways[i], begin, end) for i in (wheels, velocity)}
        if wheels < 0:
            ways[wheels] = None if window > SETTINGS.felt else self._felt.between(self._ways[velocity], begin, end)
            positions[wheels] = positions[velocity]
        change = self._change(begin, end)
        for pair, other in (
            ((wheels, velocity), ways[velocity]),
            ((wheels, position), positions[wheels]),
            ((velocity, position), positions[velocity]),
        ):
            one = ways[pair[0]]
            if one is None or other is None:
                continue
            if not self._contradict(pair, one, other, window, change):
                seen.together.add(frozenset(pair))
                continue
            seen.apart.add(frozenset(pair))
            seen.apart_by = max(seen.apart_by, _length(one, other) / window)
            if window < SETTINGS.windows[-1]:
                seen.lately.add(frozenset(pair))
            if pair == (wheels, velocity):
                against = self._far(one, positions[wheels]) - self._far(other, positions[velocity])
                seen.evidence = max(seen.evidence, against, key=abs)
                back = (-one[0], -one[1])
                seen.opposite |= wheels >= 0 and not self._contradict(pair, back, other, window, change)

    def _suspected(self, seen: _Comparison) -> int | None:
        """The place of the sensor that a comparison shows to be wrong; None if it shows none."""
        if abs(seen.evidence) > SETTINGS.evidence:
            suspect = self.wheels if seen.evidence > 0 else self.velocity
            return suspect if suspect >= 0 else None
        if self.wheels < 0:
            return None  # what is felt since then depends on the velocity
        others = self.wheels, self.velocity
        if frozenset(others) in seen.together and all(frozenset((i, self.position)) in seen.apart for i in others):
            return self.position
        return None

    def _position(
        self, index: int, way: tuple[float, float] | None, begin: int, end: int
    ) -> tuple[float, float] | None:
        """The displacement of the positions, as their averaged offset from a way says it."""
        more = self._offset_ways[index].between(begin, end)
        return None if way is None or more is None else (way[0] + more[0], way[1] + more[1])

    def _far(self, one: tuple[float, float], position: tuple[float, float] | None) -> float:
        """How unlikely a displacement along the way is, with that of the positions: a negative logarithm."""
        if position is None:
            return 0.0
        length = copysign(hypot(*one), one[0] * position[0] + one[1] * position[1])
        return (hypot(*position) - length) ** 2 / (4 * self._variance)

    def _change(self, begin: int, end: int) -> float:
        """By how much the velocity changes from one time to another [ns], [m/s], by who says the least."""
        part = int(SETTINGS.ends * 1e9)
        changes = []
        for i in (self.wheels, self.velocity):
            first, last = self._ways[i].between(begin, begin + part), self._ways[i].between(end - part, end)
            if first is not None and last is not None:
                changes.append(_length(first, last) / SETTINGS.ends)
        return min(changes, default=0.0)

    def _contradict(
        self, pair: tuple[int, int], one: tuple[float, float], other: tuple[float, float], window: float, change: float
    ) -> bool:
        """True if two displacements are apart by more than their margins, where the velocity changed by this much
        meanwhile [m/s]."""
        s = SETTINGS
        lengths = hypot(*one), hypot(*other)
        margin = s.share * max(lengths) + s.speed * window
        if self.wheels < 0 and self.wheels in pair:
            margin += 0.5 * s.bias * window**2
        if self.position in pair:
            margin += s.deviations * sqrt(2 * self._variance) + s.late * change
        if self.wheels not in pair:
            return _length(one, other) > margin
        opposite = one[0] * other[0] + one[1] * other[1] < 0
        return abs(lengths[0] - (-lengths[1] if opposite else lengths[1])) > margin


def _median(values: list[float]) -> float:
    """The median of those that are there; NaN for none."""
    present = sorted(value for value in values if isfinite(value))
    if not present:
        return nan
    half = len(present) // 2
    return 0.5 * (present[half] + present[~half])


def _length(one: tuple[float, float], other: tuple[float, float]) -> float:
    """The distance of two places."""
    return hypot(one[0] - other[0], one[1] - other[1])
