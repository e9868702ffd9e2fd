"""Whether the signals of one drive can be true together: the one set of checks that everybody asks.

Sensors of one car tell the same motion in different ways. Speed times yaw rate is the lateral acceleration, the change
of speed the longitudinal one; the change of the fix is the GNSS velocity; the wheels turn as fast as the car drives,
and those on the outside faster; a steered car turns. Where two of these do not go together, a sign, an axis, a unit, a
frame or a clock is wrong, and who contradicts the most others has it. A `Finding` is a sentence for people; nothing is
changed.

`findings` gives all of them, `doubts` those about units and signs alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.held import period_of_updates
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import INPUTS, TOPICS

Array = NDArray[np.float64]
Fault = Literal[
    "sign",
    "axes",
    "unit",
    "lag",
    "held",
    "jump",
    "quantised",
    "clock",
    "frame",
    "duplicates",
    "cut",
    "frozen",
    "missing",
]

_GRAVITY = 9.81  # [m/s²]
_AS_KNOWN = 0.1  # relative difference of a rolling radius and that of the vehicle file which asks no question
_STEP = 0.02  # [s] of the common times
_LONGEST = 1200.0  # [s] of a drive that is looked at, in its middle
_HOLE = 1.0  # [s] in which a signal says nothing
_SMOOTH = 0.3  # [s], means in which fast signals are compared
_MOST_LAG = 1.0  # [s]
_SLOW = 3.0  # [m/s] below which courses and ratios say little
_FAST = 5.0  # [m/s] below which the course of GNSS says little
_HARD = 4.0  # [m/s²] of braking from which on wheels may lock
_FIXES = 10  # before and behind a step of the position
_SWAY = 3.0  # [s] over which a change has to happen to tell a lag
_TRACK = 1.5  # [m] about that of any car
_ANTENNA = 2.0  # [m] that an antenna may be beside the middle of a car
_AHEAD = 1.5  # [m] that it may well be ahead of the rear axle
_BESIDE = 0.01  # of the speed by which it may then be faster
STANDARD_RADIUS = 0.32  # [m] about the rolling radius of any car


@dataclass(frozen=True)
class Finding:
    """A doubt: about which topic, of which kind, in a sentence that follows the topic's name."""

    topic: str
    fault: Fault
    text: str


# One motion, told by several sensors


@dataclass
class _Motion:
    """What each sensor tells of one motion, at common times every `_STEP` seconds; NaN where it says nothing.

    `signals` by name, each with its source and the time over which it has to be averaged.
    """

    start: int  # [ns]
    t: Array  # [s]
    period: dict[str, float] = field(default_factory=dict)  # of each topic [s]
    signals: dict[str, Array] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        return name in self.signals

    @classmethod
    def of(cls, recording: Recording) -> _Motion | None:
        """The motion of a recording; None where nothing of it can be compared."""
        topics = ("imu/data", "gps/fix", "gps/velocity", "vehicle/wheel_speeds", "vehicle/steering", "vehicle/velocity")
        channels = {topic: c for topic in topics if (c := _channel(recording, topic)) is not None}
        if not channels:
            return None
        # Of a source whose clock is another one nothing can be compared; `_apart` tells of it.
        middle = float(np.median([float(np.median(c.stamp)) for c in channels.values()]))
        begin = max(min(float(np.quantile(c.stamp, 0.001)) for c in channels.values()), middle - _LONGEST / 2 * 1e9)
        end = min(max(float(np.quantile(c.stamp, 0.999)) for c in channels.values()), middle + _LONGEST / 2 * 1e9)
        if end - begin < 2e9:
            return None
        motion = cls(int(begin), np.arange(0.0, (end - begin) * 1e-9, _STEP))
        for topic, channel in channels.items():
            step = np.diff(channel.stamp)
            step = step[step > 0]
            motion.period[topic] = float(np.median(step)) * 1e-9 if len(step) else np.inf
        motion._take_imu(channels.get("imu/data"))
        motion._take_gnss(channels.get("gps/velocity"), channels.get("gps/fix"))
        motion._take_wheels(channels.get("vehicle/wheel_speeds"))
        motion._take_steering(channels.get("vehicle/steering"))
        return motion

    def _at(self, channel: Channel, values: Array) -> Array:
        """Values (n,) of a channel at the common times, averaged over a step of them where it is faster."""
        good = np.isfinite(values)
        seconds = (channel.stamp[good] - self.start) * 1e-9
        values = values[good]
        seconds, first = np.unique(seconds, return_index=True)
        values = values[first]
        if len(seconds) < 3:
            return np.full(len(self.t), np.nan)
        steps = np.diff(seconds)
        usual = float(np.median(steps))
        found = _averaged(self.t, seconds, values, _STEP) if usual < _STEP / 2 else np.interp(self.t, seconds, values)
        found[(self.t < seconds[0]) | (self.t > seconds[-1])] = np.nan
        limit = max(_HOLE, 3 * usual)
        for hole in np.flatnonzero(steps > limit):
            found[(self.t > seconds[hole]) & (self.t < seconds[hole + 1])] = np.nan
        return found

    def _take_imu(self, channel: Channel | None) -> None:
        if channel is None:
            return
        for kind, names in (("angular_velocity", "wx wy wz"), ("linear_acceleration", "ax ay az")):
            if (channel.columns[f"{kind}_covariance"][:, 0] == -1).all():
                continue
            for axis, name in enumerate(names.split()):
                values = channel.columns[kind][:, axis]
                if np.isfinite(values).sum() >= 10:
                    self.signals[name] = self._at(channel, values)

    def _take_gnss(self, velocity: Channel | None, fix: Channel | None) -> None:
        if velocity is not None:
            for axis, name in enumerate(("east", "north")):
                self.signals[name] = self._at(velocity, velocity.columns["linear"][:, axis])
        if fix is None:
            return
        latitude, longitude = fix.columns["latitude"][:, 0], fix.columns["longitude"][:, 0]
        good = np.isfinite(latitude) & np.isfinite(longitude) & (fix.columns["status"][:, 0] >= 0)
        if good.sum() < 10 or np.abs(latitude[good]).max() > 90 or np.abs(longitude[good]).max() > 180:
            return
        here = fix.select(good)
        latitude, longitude = np.radians(latitude[good]), np.radians(longitude[good])
        middle = float(np.median(latitude))
        sine = np.sin(middle)
        root = np.sqrt(1.0 - 6.69438e-3 * sine**2)
        meridian, normal = 6378137.0 * (1 - 6.69438e-3) / root**3, 6378137.0 / root
        self.signals["x"] = self._at(here, normal * np.cos(middle) * (longitude - longitude[0]))
        self.signals["y"] = self._at(here, meridian * (latitude - latitude[0]))
        if np.abs(longitude).max() < 1.5:  # as they would be with latitude and longitude exchanged
            middle = float(np.median(longitude))
            self.signals["x'"] = self._at(here, normal * np.cos(middle) * (latitude - latitude[0]))
            self.signals["y'"] = self._at(here, meridian * (longitude - longitude[0]))

    def _take_wheels(self, channel: Channel | None) -> None:
        if channel is None or channel.columns["velocity"].shape[1] == 0:
            return
        for index, name in enumerate(channel.names):
            self.signals[name] = self._at(channel, channel.columns["velocity"][:, index])

    def _take_steering(self, channel: Channel | None) -> None:
        if channel is None or channel.columns["position"].shape[1] == 0:
            return
        for index, name in enumerate(channel.names):
            self.signals[name] = self._at(channel, channel.columns["position"][:, index])

    def smooth(self, values: Array, span: float) -> Array:
        """Means over `span` seconds around each time; NaN near where something is missing."""
        width = max(round(span / _STEP), 1) | 1
        good = np.isfinite(values)
        total = np.concatenate([[0.0], np.cumsum(np.where(good, values, 0.0))])
        count = np.concatenate([[0], np.cumsum(good)])
        half = width // 2
        first = np.clip(np.arange(len(values)) - half, 0, len(values))
        last = np.clip(np.arange(len(values)) + half + 1, 0, len(values))
        with np.errstate(invalid="ignore"):
            found = (total[last] - total[first]) / (count[last] - count[first])
        found[count[last] - count[first] < width] = np.nan
        return found

    def slope(self, values: Array, span: float) -> Array:
        """Change of a signal over `span` seconds around each time, per second; NaN near where something is missing."""
        half = max(round(span / 2 / _STEP), 1)
        found = np.full(len(values), np.nan)
        if len(values) > 2 * half:
            found[half:-half] = (values[2 * half :] - values[: -2 * half]) / (2 * half * _STEP)
        return found


def _averaged(at: Array, t: Array, value: Array, span: float) -> Array:
    """Means of samples over `span` seconds around the times `at`."""
    integral = np.concatenate([[0.0], np.cumsum(np.diff(t) * (value[1:] + value[:-1]) / 2)])
    begin, end = np.clip(at - span / 2, t[0], t[-1]), np.clip(at + span / 2, t[0], t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return (np.interp(end, t, integral) - np.interp(begin, t, integral)) / (end - begin)


@dataclass(frozen=True)
class _Match:
    """How two signals go together: their correlation and the size of the first over the second, both without a shift,
    and by how much the first is the later one [s], with the correlation then. `share` is what is left unexplained
    without the shift over what is left with it."""

    correlation: float
    size: float
    lag: float
    best: float
    share: float


def _match(one: Array, other: Array, most_lag: float = _MOST_LAG) -> _Match | None:
    """Compare two signals at common times; None where too little of them is there together."""
    good = np.isfinite(one) & np.isfinite(other)
    if good.sum() < 1.5 / _STEP:
        return None
    found = _correlation(one, other, 0)
    if found is None:
        return None
    correlation, size = found
    shifts = np.arange(-round(most_lag / _STEP), round(most_lag / _STEP) + 1)
    step = 2 if len(one) < 50_000 else 5
    values = np.full(len(shifts), np.nan)
    for i in range(0, len(shifts), step):
        shifted = _correlation(one, other, int(shifts[i]))
        values[i] = np.nan if shifted is None else abs(shifted[0])
    if np.isnan(values).all():
        return _Match(correlation, size, 0.0, abs(correlation), 1.0)
    at = int(np.nanargmax(values))
    for i in range(max(at - step, 0), min(at + step + 1, len(values))):
        shifted = _correlation(one, other, int(shifts[i]))
        values[i] = np.nan if shifted is None else abs(shifted[0])
    at = int(np.nanargmax(values))
    best = float(values[at])
    lag = float(shifts[at]) * _STEP
    left, left_then = 1 - correlation**2, 1 - best**2
    return _Match(correlation, size, lag, best, left / max(left_then, 1e-9))


def _correlation(one: Array, other: Array, shift: int) -> tuple[float, float] | None:
    """Correlation and ratio of the sizes of `one`, `shift` steps later, with `other`."""
    if shift > 0:
        one, other = one[shift:], other[:-shift]
    elif shift < 0:
        one, other = one[:shift], other[-shift:]
    good = np.isfinite(one) & np.isfinite(other)
    if good.sum() < 1.0 / _STEP:
        return None
    one, other = one[good] - one[good].mean(), other[good] - other[good].mean()
    a, b = float(np.sqrt(one @ one)), float(np.sqrt(other @ other))
    if a == 0.0 or b == 0.0:
        return None
    return float(one @ other) / (a * b), a / b


def _spread(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.std(good)) if len(good) > 10 else 0.0


def relations_of(recording: Recording) -> Relations | None:
    """The motion of a recording as each of its sensors tells it; None where nothing of it can be compared."""
    motion = _Motion.of(recording)
    if motion is None:
        return None
    relations = Relations(motion, recording.start)
    relations.derive()
    return relations if relations.speed is not None else None


_BODY_AXES = "it looks like the axes of the car (forward, left), expected east, north, up"


class Relations:
    """The contradictions between the sensors of one drive."""

    STEP: ClassVar[float] = _STEP

    def __init__(self, motion: _Motion, begin: int | None = None) -> None:
        self.m = motion
        self.begin = motion.start if begin is None else begin  # of the recording [ns]
        self.found: list[Finding] = []
        self.span = _SMOOTH
        gnss = max((motion.period[t] for t in ("gps/velocity", "gps/fix") if t in motion.period), default=0.0)
        self.gnss_span = max(_SMOOTH, 2.0 * gnss)
        self.east: Array | None = motion.signals.get("east")
        self.north: Array | None = motion.signals.get("north")
        self.blamed: set[str] = set()

    def say(self, topic: str, fault: Fault, text: str) -> None:
        self.blamed.add(topic)
        self.found.append(Finding(topic, fault, text))

    def run(self) -> list[Finding]:
        self.velocity_and_fix()
        self.fix_steps()
        self.derive()
        self.steering_still()
        self.turning()
        self.along()
        self.wheels()
        self.lags()
        return self.found

    # GNSS velocity against the change of the fix

    def velocity_and_fix(self) -> None:
        s = self.m.signals
        if "x" not in s:
            return
        if self.east is None or self.north is None:
            self.gnss_span = max(self.gnss_span, 2.0)
            self.east, self.north = (self._change(s[name], self.gnss_span / 2) for name in "xy")
            return
        noise = self._fix_noise()
        for span in (1.0, 2.0, 3.0):
            span = max(self.gnss_span, span)
            by_fix = np.array([self._change(s[name], span) for name in "xy"])
            velocity = np.array([self.m.smooth(self.m.smooth(v, span), span) for v in (self.east, self.north)])
            speed = np.hypot(*by_fix)
            good = np.isfinite(velocity).all(axis=0) & np.isfinite(by_fix).all(axis=0) & (speed > _SLOW)
            if good.sum() < 2.0 / _STEP:
                return
            usual = float(np.median(speed[good]))
            error = noise * np.sqrt(2 * self.m.period["gps/fix"] / span) / span
            if error < 0.05 * usual:
                break
        velocity, by_fix, speed = velocity[:, good], by_fix[:, good], speed[good]
        away = float(np.sqrt(np.median(np.sum((velocity - by_fix) ** 2, axis=0))))
        if away < max(0.1 * usual, 1.0, 5 * error):
            return
        east, north = by_fix
        size = float(np.median(np.hypot(*velocity)) / usual)
        units = {"km/h": 3.6, "mph": 1 / 0.44704, "knots": 3600 / 1852}
        forms: list[tuple[str, Fault, Array]] = [
            (_BODY_AXES, "frame", np.array([speed, 0 * speed])),
            ("east and north are exchanged", "frame", np.array([north, east])),
            ("its east has the opposite sign", "sign", np.array([-east, north])),
            ("its north has the opposite sign", "sign", np.array([east, -north])),
            ("both its components have the opposite sign", "sign", np.array([-east, -north])),
            ("it is turned by 90°", "frame", np.array([-north, east])),
            ("it is turned by 90°", "frame", np.array([north, -east])),
            *((f"it looks like {unit}, expected m/s", "unit", by_fix * factor) for unit, factor in units.items()),
        ]  # fmt: skip
        left = [float(np.sqrt(np.median(np.sum((velocity - form) ** 2, axis=0)))) for *_, form in forms]
        best = int(np.argmin(left))
        swapped = np.array([self._change(s[name], span)[good] for name in ("x'", "y'") if name in s])
        if len(swapped):
            without = float(np.sqrt(np.median(np.sum((velocity - swapped) ** 2, axis=0))))
            if without < min(0.3 * away, left[best]):
                self.say("gps/fix", "axes", "latitude and longitude are exchanged: its change is not gps/velocity")
                return
        close = left[best] < 0.35 * away and left[best] < max(0.2 * usual, 2.0)
        if not close and (away < max(0.4 * usual, 3.0) or good.sum() < 4.0 / _STEP):
            return
        # Whether velocity or fix is wrong, the gyro tells: the course of the right one turns with it.
        fix_is_wrong = self._turns_with_gyro(by_fix, good) < -0.5 and self._turns_with_gyro(velocity, good) > 0.5
        if fix_is_wrong:
            what = "latitude and longitude exchanged, or a sign of theirs?"
            self.say(
                "gps/fix", "axes", f"its change is not gps/velocity, with whose course the yaw rate agrees: {what}"
            )
            return
        if not close and not 0.6 < size < 1.6:
            text, fault = f"it is {size:.2f} times as fast", "unit"
        elif close:
            text, fault = forms[best][:2]
        else:
            text, fault = f"they are {away:.1f} m/s apart (median); body axes, or east and north exchanged?", "frame"
        self.say("gps/velocity", fault, f"is not the change of gps/fix: {text}")  # type: ignore[arg-type]
        self.gnss_span = max(self.gnss_span, 2.0)
        self.east, self.north = (self._change(s[name], self.gnss_span / 2) for name in "xy")

    def _change(self, position: Array, span: float) -> Array:
        """Velocity by a position, averaged twice over `span` seconds."""
        return self.m.slope(self.m.smooth(position, span), span)

    def _fix_noise(self) -> float:
        """Standard deviation of a fix [m], as far as it changes from one to the next."""
        step = max(round(self.m.period["gps/fix"] / _STEP), 1)
        found = []
        for name in "xy":
            values = self.m.signals[name][::step]
            bend = values[2:] - 2 * values[1:-1] + values[:-2]
            bend = bend[np.isfinite(bend)]
            found.append(1.4826 * float(np.median(np.abs(bend))) / np.sqrt(6) if len(bend) else 0.0)
        return max(found)

    def fix_steps(self) -> None:
        """A fix that steps to another place and stays there: what it is away from the way of the velocity."""
        s = self.m.signals
        if "x" not in s or "east" not in s or self.blamed & {"gps/fix", "gps/velocity"}:
            return
        every = max(round(self.m.period["gps/fix"] / _STEP), 1)
        steps = []
        for place, velocity in (("x", "east"), ("y", "north")):
            off = s[place] - np.cumsum(np.nan_to_num(s[velocity])) * _STEP
            off[~np.isfinite(s[velocity])] = np.nan
            rows = off[::every]
            if len(rows) < 4 * _FIXES:
                return
            means = np.convolve(rows, np.ones(_FIXES) / _FIXES, "valid")
            steps.append(means[_FIXES:] - means[:-_FIXES])
        size = np.hypot(*steps)
        known = size[np.isfinite(size)]
        if len(known) < 2 * _FIXES:
            return
        usual = float(np.median(known))
        at = int(np.nanargmax(size))
        if size[at] > max(4.0, 6.0 * usual):
            when = float(self.m.t[min((at + _FIXES) * every, len(self.m.t) - 1)])
            when += (self.m.start - self.begin) * 1e-9
            self.say("gps/fix", "jump", f"the position steps by {size[at]:.1f} m at {when:.1f} s against the velocity")

    def steering_still(self) -> None:
        """A steering angle that keeps its value while the car changes how it turns."""
        if self.speed is None or "gyro" not in self.turns:
            return
        lateral = self.m.smooth(self.speed * self.turns["gyro"], _SMOOTH)
        shape = lateral / np.maximum(self.speed, 1.0) ** 2
        for name in ("steering_wheel", "road_wheel_front"):
            if name not in self.m:
                continue
            own = self.m.signals[name]
            still = np.concatenate([[False], np.abs(np.diff(own)) < 1e-12])
            ends = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
            for begin, end in zip(ends[::2], ends[1::2], strict=True):
                if (end - begin) * _STEP < 2.0:
                    continue
                # The car needs a while to follow what went before.
                inside = slice(begin + round(0.5 / _STEP), end - round(0.3 / _STEP))
                part, form = lateral[inside], shape[inside]
                form = form[np.isfinite(part)]
                part = part[np.isfinite(part)]
                if len(part) > 10 and np.ptp(part) > 1.5 and np.ptp(form) > 0.5 * np.max(np.abs(form)):
                    text = f"{name} is frozen for {(end - begin) * _STEP:.1f} s from {self.m.t[begin]:.1f} s on"
                    self.say("vehicle/steering", "frozen", f"{text}: the car turns otherwise meanwhile")
                    break

    def _turns_with_gyro(self, velocity: Array, good: NDArray[np.bool_]) -> float:
        """Correlation of the turning of a velocity's course with the yaw rate; 0 where that says nothing."""
        if "wz" not in self.m:
            return 0.0
        full = np.full((2, len(self.m.t)), np.nan)
        full[:, good] = velocity
        turn = self._course_rate(full[0], full[1], 1.0)
        yaw = self.m.smooth(self.m.signals["wz"], 1.0)
        if _spread(turn) < 0.01 or _spread(yaw) < 0.01:
            return 0.0
        found = _correlation(yaw, turn, 0)
        return 0.0 if found is None else found[0]

    def _course_rate(self, east: Array, north: Array, span: float) -> Array:
        """How fast the course of a velocity turns to the left [rad/s]."""
        fast = np.hypot(east, north) > _FAST
        half = max(round(span / 2 / _STEP), 1)
        found = np.full(len(east), np.nan)
        if len(east) <= 2 * half:
            return found
        a = east[: -2 * half] + 1j * north[: -2 * half]
        b = east[2 * half :] + 1j * north[2 * half :]
        found[half:-half] = np.angle(b * np.conj(a)) / (2 * half * _STEP)
        found[~fast] = np.nan
        return found

    # Turning and speed, each told by several

    def derive(self) -> None:
        """Turning rates [rad/s] and accelerations along the car [m/s²] by who tells them."""
        s, m = self.m.signals, self.m
        self.speed: Array | None = None
        self.turns: dict[str, Array] = {}
        self.pushes: dict[str, Array] = {}
        if self.east is not None and self.north is not None:
            self.ground = np.hypot(self.east, self.north)
            self.speed = self.ground
            self.turns["gnss"] = self._course_rate(self.east, self.north, self.gnss_span)
            self.pushes["gnss"] = m.slope(self.ground, self.gnss_span)
        names = [name for name in s if name.startswith("wheel_")]
        if names:
            with np.errstate(all="ignore"):
                stack = np.array([s[name] for name in names])
                stack = stack[:, :]
                mean = np.where(np.isfinite(stack).all(axis=0), stack.mean(axis=0), np.nan)
            self.radius = self._radius(mean)
            self.rolling = mean * abs(self.radius)
            if self.speed is None:
                self.speed = np.abs(self.rolling)
            self.pushes["wheels"] = m.slope(m.smooth(self.rolling, 0.1), _SMOOTH)
            sides = [(s[f"wheel_{a}r"] - s[f"wheel_{a}l"]) for a in "rf" if {f"wheel_{a}r", f"wheel_{a}l"} <= s.keys()]
            if sides:
                self.turns["wheels"] = m.smooth(sides[0], _SMOOTH) * abs(self.radius) / _TRACK
        if "wz" in s:
            self.turns["gyro"] = m.smooth(s["wz"], _SMOOTH)
        if self.speed is None:
            return
        fast = np.where(self.speed > _SLOW, self.speed, np.nan)
        if "ay" in s:
            self.turns["accelerometer"] = m.smooth(s["ay"], _SMOOTH) / fast
        if "ax" in s:
            self.pushes["accelerometer"] = m.smooth(s["ax"], _SMOOTH)
        for name in ("steering_wheel", "road_wheel_front"):
            if name in s:
                ratio = 16.0 if name == "steering_wheel" else 1.0
                self.turns[name] = m.smooth(s[name], _SMOOTH) / ratio * fast / (2.7 + 0.004 * fast**2)
        # With wheels that may be locked the car does not turn as it is steered.
        push = self.pushes.get("gnss", self.pushes.get("wheels"))
        hard = np.zeros(len(m.t), bool) if push is None else np.abs(m.smooth(np.nan_to_num(push), 1.0)) > _HARD
        for turn in self.turns.values():
            turn[~(self.speed > _SLOW) | hard] = np.nan
        self._heading_of_velocity()

    def _heading_of_velocity(self) -> None:
        """A GNSS velocity whose course stays while the car turns is in the axes of the car."""
        if "east" not in self.m or "gps/velocity" in self.blamed or "gyro" not in self.turns:
            return
        east, north = self.m.signals["east"], self.m.signals["north"]
        good = (
            np.isfinite(east) & np.isfinite(north) & np.isfinite(self.turns["gyro"]) & (np.hypot(east, north) > _FAST)
        )
        if good.sum() < 2.0 / _STEP:
            return
        heading = np.cumsum(np.where(good, self.turns["gyro"], 0.0)) * _STEP
        course = np.unwrap(np.arctan2(north[good], east[good]))
        turned = _spread(heading[good] - np.polyval(np.polyfit(self.m.t[good], heading[good], 1), self.m.t[good]))
        if 0.03 < turned < 3.0 and _spread(course) < 0.2 * turned and abs(float(np.median(course))) < 0.03:
            text = "its course stays 0 while the car turns: it looks like the axes of the car, expected east, north, up"
            self.say("gps/velocity", "frame", text)
            self.turns.pop("gnss", None)
            if "x" in self.m.signals:
                self.gnss_span = max(self.gnss_span, 2.0)
                self.east, self.north = (self._change(self.m.signals[name], self.gnss_span / 2) for name in "xy")
                self.turns["gnss"] = self._course_rate(self.east, self.north, self.gnss_span)

    def _radius(self, mean: Array) -> float:
        """Rolling radius [m]: speed over ground over the turning of the wheels, or that of most cars."""
        if self.speed is not None:
            moving = (self.speed > _SLOW) & (np.abs(mean) > 0.5)
            if moving.sum() > 1.0 / _STEP:
                return float(np.median(self.speed[moving] / mean[moving]))
        return 0.32

    _TOPIC_OF: Mapping[str, str] = {
        "gnss": "gps/velocity",
        "wheels": "vehicle/wheel_speeds",
        "gyro": "imu/data",
        "accelerometer": "imu/data",
        "steering_wheel": "vehicle/steering",
        "road_wheel_front": "vehicle/steering",
    }

    def _span(self, one: str, other: str) -> float:
        return max(self.gnss_span if "gnss" in (one, other) else _SMOOTH, _SMOOTH)

    def _compare(self, signals: Mapping[str, Array], one: str, other: str) -> _Match | None:
        span = self._span(one, other)
        smooth = (lambda v: self.m.smooth(v, span)) if span > _SMOOTH else (lambda v: v)
        a = signals[one] if one == "gnss" else smooth(signals[one])
        b = signals[other] if other == "gnss" else smooth(signals[other])
        return _match(a, b)

    def _against_most(self, signals: Mapping[str, Array], least: float) -> dict[str, str]:
        """Who has a sign opposite to most of the others; with the name of one of these."""
        telling = [name for name, v in signals.items() if _spread(v) > least]
        sign: dict[tuple[str, str], int] = {}
        for one, other in combinations(telling, 2):
            match = self._compare(signals, one, other)
            if match is not None and abs(match.correlation) > 0.5:
                sign[one, other] = 1 if match.correlation > 0 else -1
        if not sign:
            return {}
        # The split of the sources into right and wrong that contradicts the fewest pairs, and calls the fewest wrong.
        best: tuple[int, float, tuple[str, ...]] | None = None
        weight = {"gnss": 1.2, "gyro": 1.1, "steering_wheel": 1.0, "road_wheel_front": 1.0, "wheels": 1.0}
        for count in range(len(telling) // 2 + 1):
            for wrong in combinations(telling, count):
                against = sum(s != (-1 if (a in wrong) != (b in wrong) else 1) for (a, b), s in sign.items())
                cost = (against, sum(weight.get(name, 0.9) for name in wrong), wrong)
                if best is None or cost[:2] < best[:2]:
                    best = cost
        assert best is not None
        wrong_ones = {}
        for name in best[2]:
            partners = [b if a == name else a for (a, b) in sign if name in (a, b)]
            partners = [p for p in partners if p not in best[2]]
            if partners:
                wrong_ones[name] = partners[0]
        return wrong_ones

    _WORDS: Mapping[str, str] = {
        "gnss": "the turning of the GNSS course",
        "wheels": "the difference of the wheels on the right and left",
        "gyro": "the yaw rate",
        "accelerometer": "the lateral acceleration",
        "steering_wheel": "steering_wheel",
        "road_wheel_front": "road_wheel_front",
    }
    _ALONG: Mapping[str, str] = {
        "gnss": "the change of the GNSS speed",
        "wheels": "the change of the wheel speeds",
        "accelerometer": "the longitudinal acceleration",
    }

    def turning(self) -> None:
        if self.speed is None:
            return
        self.sideways_wrong = False
        wrong = self._against_most(self.turns, 0.02)
        for name, other in wrong.items():
            topic = self._TOPIC_OF[name]
            if topic == "gps/velocity" and topic in self.blamed:
                continue
            if name == "accelerometer":
                self.sideways_wrong = True
                continue  # with the longitudinal one, below
            if name == "gnss":
                if "east" in self.m:
                    self.say(
                        topic, "frame", f"its course turns against {self._WORDS[other]}: east and north exchanged?"
                    )
                else:
                    self.say(
                        "gps/fix",
                        "axes",
                        f"its course turns against {self._WORDS[other]}: latitude and longitude exchanged?",
                    )
            elif name == "wheels":
                self.say(
                    topic, "axes", f"{self._WORDS[name]} is against {self._WORDS[other]}: are left and right exchanged?"
                )
            else:
                self.say(
                    topic, "sign", f"{self._WORDS[name]} is against {self._WORDS[other]}: expected positive to the left"
                )
        self._turning_sizes(wrong)
        self._gyro_axes()

    def _turning_sizes(self, wrong: Mapping[str, str]) -> None:
        """Units of yaw rate and lateral acceleration."""
        reference = next((n for n in ("gnss", "wheels") if n in self.turns and _spread(self.turns[n]) > 0.02), None)
        if reference is None or "gyro" not in self.turns:
            return
        match = self._compare(self.turns, "gyro", reference)
        if match is None or match.best < 0.9:
            return
        low, high = (0.5, 2.0) if reference == "gnss" else (0.3, 3.0)
        if 30 < match.size < 100:
            text = (
                f"the yaw rate looks like deg/s, expected rad/s: it is {match.size:.1f} times {self._WORDS[reference]}"
            )
            self.say("imu/data", "unit", text)
        elif not low < match.size < high:
            text = f"the yaw rate is {match.size:.3f} times {self._WORDS[reference]}, expected 1"
            self.say("imu/data", "unit", text)

    def _gyro_axes(self) -> None:
        """A turning that shows on another axis of the gyro than z."""
        reference = next((n for n in ("gnss", "wheels") if n in self.turns and _spread(self.turns[n]) > 0.03), None)
        if reference is None or "wz" not in self.m:
            return
        found = {}
        for name in ("wx", "wy", "wz"):
            if name in self.m:
                turn = self.m.smooth(self.m.signals[name], self._span("gyro", reference))
                match = _match(turn, self.turns[reference], 0.3)
                found[name] = (0.0, 0.0) if match is None else (match.best, match.size)
        best = max(found, key=lambda name: found[name][0])
        if best != "wz" and found[best][0] > 0.9 and found["wz"][0] < 0.6 and 0.5 < found[best][1] < 2.0:
            self.say("imu/data", "axes", f"the car turns on axis {best[1]} of the gyro, expected z (forward, left, up)")

    def along(self) -> None:
        """The accelerometers against the change of speed and the turning: signs and axes in the plane."""
        if self.speed is None or "ax" not in self.m or "ay" not in self.m:
            self._lateral_alone()
            return
        span = self._span("gnss", "gnss") if "gnss" in self.pushes else _SMOOTH
        push = self.pushes.get("gnss", self.pushes.get("wheels"))
        name = next((n for n in ("gyro", "gnss", "wheels") if n in self.turns and not self._blames(n)), None)
        if push is None or name is None:
            return
        m = self.m
        turn = self.turns[name] if name == "gnss" else m.smooth(self.turns[name], span)
        size = 1.0
        if name == "gyro":
            other = next((n for n in ("gnss", "wheels") if n in self.turns), None)
            match = None if other is None else self._compare(self.turns, "gyro", other)
            size = match.size if match is not None and match.best > 0.6 and not 0.5 < match.size < 2.0 else 1.0
        side = m.smooth(self.speed, span) * turn / size
        ax, ay = m.smooth(m.signals["ax"], span), m.smooth(m.signals["ay"], span)
        good = np.isfinite(push) & np.isfinite(side) & np.isfinite(ax) & np.isfinite(ay) & (self.speed > _SLOW)
        if good.sum() < 2.0 / _STEP:
            return
        expected, felt = np.array([push, side])[:, good], np.array([ax, ay])[:, good]
        offset = np.median(felt, axis=1, keepdims=True) - np.median(expected, axis=1, keepdims=True)
        del offset
        power = np.array([float(np.mean(e**2)) for e in expected])
        if power.max() < 0.5**2:
            return
        self._plane(expected, felt, power)

    def turning_told_by_others(self, *, wheels: bool = True, steering: bool = True, gyro: bool = False) -> Array | None:
        """How fast the car turns [rad/s], by the best that tells it besides an inertial sensor: the course of GNSS, the
        wheels, a steered wheel; None where nobody does, or the car hardly turns."""
        names = ("gnss", *(("gyro",) if gyro else ()), *(("wheels",) if wheels else ()),
                 *(("road_wheel_front", "steering_wheel") if steering else ()))  # fmt: skip
        told = (self.turns[name] for name in names if name in self.turns)
        return next((turn for turn in told if _spread(turn) > 0.02), None)

    def motion_told_by_others(self) -> tuple[Array, Array] | None:
        """Accelerations along the car and to its left [m/s²] by those besides an accelerometer, in means over
        `gnss_span`; None where they do not tell both."""
        push = self.pushes.get("gnss", self.pushes.get("wheels"))
        names = [name for name in ("gnss", "wheels", "gyro") if name in self.turns]
        if push is None or not names or self.speed is None:
            return None
        turn = self.turns[names[0]]
        side = self.m.smooth(self.speed, self.gnss_span) * (
            turn if names[0] == "gnss" else self.m.smooth(turn, self.gnss_span)
        )
        along = push if "gnss" in self.pushes else self.m.smooth(push, self.gnss_span)
        slow = ~(self.speed > _SLOW)
        return np.where(slow, np.nan, along), np.where(slow, np.nan, side)

    def _blames(self, name: str) -> bool:
        return self._TOPIC_OF[name] in self.blamed and any(
            f.topic == self._TOPIC_OF[name] and f.fault in ("sign", "axes", "frame") for f in self.found
        )

    def _lateral_alone(self) -> None:
        if getattr(self, "sideways_wrong", False):
            self.say(
                "imu/data",
                "sign",
                "the lateral acceleration is against speed times yaw rate: expected positive to the left",
            )

    def _plane(self, expected: Array, felt: Array, power: Array) -> None:
        """Which way the accelerometers lie in the plane explains what they felt."""
        forms: list[tuple[str, Fault, Array]] = [
            ("", "axes", np.array([[1, 0], [0, 1]])),
            ("the IMU looks turned by 180° about z: longitudinal and lateral acceleration are both reversed", "axes",
             np.array([[-1, 0], [0, -1]])),
            ("the lateral acceleration is against speed times yaw rate: expected positive to the left", "sign",
             np.array([[1, 0], [0, -1]])),
            ("the longitudinal acceleration is against the change of speed: expected positive forward", "sign",
             np.array([[-1, 0], [0, 1]])),
            ("the axes x and y of the accelerometer are exchanged", "axes", np.array([[0, 1], [1, 0]])),
            ("the IMU looks turned by 90° about z", "axes", np.array([[0, 1], [-1, 0]])),
            ("the IMU looks turned by 90° about z", "axes", np.array([[0, -1], [1, 0]])),
            ("the axes x and y of the accelerometer are exchanged and reversed", "axes", np.array([[0, -1], [-1, 0]])),
        ]  # fmt: skip
        scale = float(np.sqrt(np.mean(felt**2) / np.mean(expected**2)))
        if 0.06 < scale < 0.2:
            felt = felt * _GRAVITY  # in g, of which the check of gravity speaks if it can
        left = []
        for _, _, turn in forms:
            error = felt - turn @ expected
            # The attitude and offsets of the sensor stay in the means.
            error = error - np.clip(np.median(error, axis=1, keepdims=True), -1.0, 1.0)
            left.append(float(np.mean(np.abs(error))))
        order = np.argsort(left)
        best = int(order[0])
        if best == 0 or left[best] > 0.5 * left[0]:
            if 0.06 < scale < 0.2 and left[0] < 0.6 * float(np.mean(np.abs(expected))):
                self.say(
                    "imu/data",
                    "unit",
                    "the accelerations look like g, expected m/s²: they are a tenth of those of the motion",
                )
            return
        # Where the car was driven along one axis only, several explain it alike: the one with the fewest changes.
        alike = [i for i in range(1, len(forms)) if left[i] < 1.2 * left[best] + 0.02]
        single = [i for i in alike if i in (2, 3)]
        chosen = best
        if single and min(power) < 0.3**2:
            chosen = single[0]
        text, fault, _ = forms[chosen]
        if chosen in (2, 3) and min(power) < 0.3**2:
            text += ", or the IMU is turned by 180° about z"
        self.say("imu/data", fault, text)

    # Wheels against each other and GNSS

    def wheels(self) -> None:
        s = self.m.signals
        names = [name for name in s if name.startswith("wheel_")]
        if len(names) >= 2:
            stack = np.array([self.m.smooth(s[name], 0.5) for name in names])
            usual = np.median(stack, axis=0)
            moving = np.isfinite(stack).all(axis=0) & (np.abs(usual) > 10.0)
            if moving.sum() > 2.0 / _STEP and len(names) > 2:
                ratio = np.median(stack[:, moving] / usual[moving], axis=1)
                for name, size in zip(names, ratio, strict=True):
                    if not 0.9 < size < 1.1:
                        fault: Fault = "sign" if size < 0 else "unit"
                        self.say("vehicle/wheel_speeds", fault, f"{name} turns {size:.2f} times as fast as the others")
            self._stuck_wheels(names)

    def _stuck_wheels(self, names: list[str]) -> None:
        """A wheel that stands or keeps its speed while the others change theirs."""
        s = self.m.signals
        width = round(1.5 / _STEP)
        for name in names:
            others = np.array([s[other] for other in names if other != name])
            own = s[name]
            still = np.concatenate([[False], np.abs(np.diff(own)) < 1e-9])
            ends = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
            for begin, end in zip(ends[::2], ends[1::2], strict=True):
                if end - begin < width:
                    continue
                part = others[:, begin:end]
                part = part[:, np.isfinite(part).all(axis=0)]
                if part.shape[1] < 2 or float(np.median(np.abs(part))) < 5.0:
                    continue
                # A wheel at constant speed keeps its value only if it is coarse, and then the others do so, too.
                if float(np.median(np.mean(np.abs(np.diff(part, axis=1)) > 1e-9, axis=1))) > 0.5:
                    text = f"{name} is frozen for {(end - begin) * _STEP:.1f} s from {self.m.t[begin]:.1f} s on"
                    self.say("vehicle/wheel_speeds", "frozen", text)
                    break

    # Clocks

    def lags(self) -> None:
        """Which sensor's time stamps do not go with those of the others."""
        if self.speed is None:
            return
        of = {
            "imu": "imu/data",
            "wheels": "vehicle/wheel_speeds",
            "gnss": "gps/velocity",
            "steering": "vehicle/steering",
        }
        late: dict[tuple[str, str], list[tuple[float, float]]] = {}

        def judge(
            pair: tuple[str, str], match: _Match | None, allowed: tuple[float, float], least: float = 0.85
        ) -> None:
            if match is None or match.best < least:
                return
            sharp = match.share > 1.6 and match.best - abs(match.correlation) > 0.004
            lag = match.lag if sharp else 0.0
            excess = lag - allowed[1] if lag > allowed[1] else lag - allowed[0] if lag < allowed[0] else 0.0
            late.setdefault(pair, []).append((lag if excess else 0.0, match.best))

        def swaying(signals: Mapping[str, Array]) -> dict[str, Array]:
            return {name: v - self.m.smooth(v, _SWAY) for name, v in signals.items()}

        turns, pushes = swaying(self.turns), swaying(self.pushes)
        steer = next((n for n in ("road_wheel_front", "steering_wheel") if n in turns), None)
        if "gyro" in turns and _spread(turns["gyro"]) > 0.03:
            if "wheels" in turns:
                judge(("imu", "wheels"), self._compare(turns, "gyro", "wheels"), (-0.12, 0.12), 0.93)
            if steer is not None:
                judge(("imu", "steering"), self._compare(turns, "gyro", steer), (-0.06, 0.4))
        slow = self.gnss_span > 1.0
        # Where tyres hardly slip, the course of a point this far ahead of the rear axle turns before the car does.
        moving = self.speed[self.speed > _SLOW]
        early = _AHEAD / float(moving.mean()) if len(moving) else 0.0
        if "gnss" in turns:
            if "gyro" in turns and _spread(turns["gyro"]) > 0.03:
                judge(
                    ("imu", "gnss"),
                    self._compare(turns, "gyro", "gnss"),
                    (-0.3, 0.12 + early) if not slow else (-0.6, 0.6 + early),
                    0.93,
                )
            if "accelerometer" in turns and _spread(turns["accelerometer"]) > 0.03:
                match = self._compare(turns, "accelerometer", "gnss")
                judge(("imu", "gnss"), match, (-0.15, 0.15) if not slow else (-0.6, 0.6), 0.93)
        if "accelerometer" in pushes:
            for other, name in (("gnss", "gnss"), ("wheels", "wheels")):
                if other in pushes and _spread(pushes[other]) > 0.5:
                    tolerance = 0.2 if not slow else 0.6
                    match = self._compare(pushes, "accelerometer", other)
                    # The nose dips after the brakes have taken hold, which an accelerometer feels as well.
                    judge(("imu", name), match, (-tolerance / 2, tolerance), 0.9)
        if "gnss" in pushes and "wheels" in pushes and _spread(pushes["gnss"]) > 0.5:
            tolerance = 0.15 if not slow else 0.6
            judge(("wheels", "gnss"), self._compare(pushes, "wheels", "gnss"), (-tolerance, tolerance), 0.9)
        if "gnss" in turns and "wheels" in turns and _spread(turns["wheels"]) > 0.03:
            judge(
                ("wheels", "gnss"),
                self._compare(turns, "wheels", "gnss"),
                (-0.3, 0.15 + early) if not slow else (-0.6, 0.6 + early),
                0.93,
            )
        verdict = {pair: max(found, key=lambda item: item[1]) for pair, found in late.items()}
        bad = {pair: lag for pair, (lag, _) in verdict.items() if lag != 0.0}
        fine = [pair for pair, (lag, _) in verdict.items() if lag == 0.0]
        while bad:
            votes = {
                n: sum(n in p for p in bad) - sum(0.2 if "steering" in p else 0.9 for p in fine if n in p)
                for n in {x for p in bad for x in p}
            }
            guilty = max(sorted(votes), key=lambda n: (votes[n], n == "steering", n == "gnss"))
            if len(bad) == 1 and np.ptp(list(votes.values())) < 0.5 and "steering" not in votes:
                # Two that contradict each other, and nobody else to ask.
                ((one, other),), (lag,) = bad.keys(), bad.values()
                for name, by, than in ((one, lag, other), (other, -lag, one)):
                    side = "behind" if by > 0 else "ahead of"
                    self.say(of[name], "lag", f"lies {abs(by):.2f} s {side} {of[than]}: which of the clocks is wrong?")
                break
            pairs = [pair for pair in bad if guilty in pair]
            told = []
            for pair in pairs:
                lag = bad.pop(pair) * (1 if pair[0] == guilty else -1)
                other = pair[1] if pair[0] == guilty else pair[0]
                told.append(f"{abs(lag):.2f} s {'behind' if lag > 0 else 'ahead of'} {of[other]}")
            self.say(of[guilty], "lag", f"lies {', '.join(told)}: is its clock or its latency wrong?")
        self._fix_lag(("imu", "gnss") in fine or ("wheels", "gnss") in fine)

    def _fix_lag(self, velocity_is_right: bool) -> None:
        """The fix against the velocity of the same receiver."""
        s = self.m.signals
        if "x" not in s or "east" not in s or "gps/velocity" in self.blamed or "gps/fix" in self.blamed:
            return
        span = max(self.gnss_span, 0.6)
        pairs = []
        for place, velocity in (("x", "east"), ("y", "north")):
            pairs.append((self.m.slope(s[place], span), self.m.smooth(s[velocity], span)))
        one = np.concatenate([pairs[0][0], np.full(100, np.nan), pairs[1][0]])
        other = np.concatenate([pairs[0][1], np.full(100, np.nan), pairs[1][1]])
        if max(_spread(p[1]) for p in pairs) < 1.0:
            return
        match = _match(one, other)
        if (
            match is not None
            and match.best > 0.95
            and match.share > 2.0
            and abs(match.lag) > max(0.15, 0.5 * self.gnss_span)
        ):
            one_of = "is a clock or a latency wrong?" if velocity_is_right else "which of the two is wrong?"
            topics = ("gps/fix", "gps/velocity") if not velocity_is_right else ("gps/fix",)
            for topic, by in zip(topics, (match.lag, -match.lag), strict=False):
                than = "gps/velocity" if topic == "gps/fix" else "gps/fix"
                self.say(topic, "lag", f"lies {abs(by):.2f} s {'behind' if by > 0 else 'ahead of'} {than}: {one_of}")


def clock_offset(reference: Recording, other: Recording) -> tuple[float, float] | None:
    """What has to be added to the times of a recording to have those of another of the same drive [s], and how alike
    the motions are then (a correlation); None where they have none to compare.

    Whatever both tell is compared: the turning rate, or the speed, of whichever sensor.
    """
    motions = [_Motion.of(recording) for recording in (reference, other)]
    if motions[0] is None or motions[1] is None:
        return None
    relations = [Relations(motion) for motion in motions if motion is not None]
    for relation in relations:
        relation.velocity_and_fix()
        relation.derive()
    best: tuple[float, float] | None = None
    pairs = [(relations[0].turns, relations[1].turns), (relations[0].pushes, relations[1].pushes)]
    for one, two in pairs:
        for a in one.values():
            for b in two.values():
                found = _offset(a, b)
                if found is not None and (best is None or found[1] > best[1]):
                    best = found
    if best is None or best[1] < 0.7:
        return None
    return best[0] + (motions[0].start - motions[1].start) * 1e-9, best[1]


def _offset(one: Array, other: Array) -> tuple[float, float] | None:
    """By how much `other` has to be put later to go along with `one` [s], and their correlation then.

    By way of the Fourier transform, as two recordings may begin at any time of each other.
    """
    if _spread(one) == 0.0 or _spread(other) == 0.0:
        return None
    a, b = (np.nan_to_num(v - np.nanmean(v)) for v in (one, other))
    good = [np.isfinite(v).astype(float) for v in (one, other)]
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))

    def across(x: Array, y: Array) -> Array:
        return np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)

    both = np.maximum(np.rint(across(*good)), 0.0)
    power = across(a**2, good[1]) * across(good[0], b**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = across(a, b) / np.sqrt(np.maximum(power, 1e-12))
    least = max(5.0 / _STEP, 0.3 * min(good[0].sum(), good[1].sum()))
    alike[both < least] = -1.0
    at = int(np.argmax(alike))
    before, here, behind = (float(alike[(at + k) % size]) for k in (-1, 0, 1))
    if here <= 0.0:
        return None
    bend = before - 2 * here + behind
    part = 0.5 * (before - behind) / bend if bend < 0 and min(before, behind) > 0 else 0.0
    shift = at if at < size // 2 else at - size
    return (shift + part) * _STEP, here


# Signals that cannot be right by themselves


def _held(recording: Recording) -> Iterator[Finding]:
    """Topics that are sent more often than their source measures."""
    for topic in INPUTS:
        channel = _channel(recording, topic)
        if channel is None:
            continue
        parts = [v for _, v in measured(channel) if np.isfinite(v).all() and np.ptp(v) > 0.0]
        if not parts:
            continue
        groups = [parts]
        if topic == "imu/data" and len(parts) > 1:
            groups = [[part] for part in parts]
        found = [every for group in groups if (every := period_of_updates(np.column_stack(group))) is not None]
        if len(found) == len(groups) or (len(found) > len(groups) / 2 and topic == "imu/data"):
            every = min(found)
            step = float(np.median(np.diff(channel.stamp))) * 1e-9
            rate = f"{1 / step:.4g} Hz hold what is measured at {1 / step / every:.4g} Hz" if step > 0 else ""
            yield Finding(topic, "held", f"each value stands in {every} messages: {rate}")


# The largest change [per second] that a car can make, and what noise of any sensor stays below, by kind of signal.
_FASTEST: Mapping[str, tuple[float, float]] = {
    "angular_velocity": (60.0, 0.25),
    "linear_acceleration": (2000.0, 6.0),
    "velocity": (600.0, 2.0),
    "steering_wheel": (20.0, 0.05),
    "road_wheel_front": (2.0, 0.02),
    "gps": (30.0, 1.5),
}
# The largest step of resolution that raises no question.
_RESOLUTION: Mapping[str, float] = {
    "angular_velocity": 0.008,
    "linear_acceleration": 0.15,
    "velocity": 0.3,
    "steering_wheel": 0.035,
    "road_wheel_front": 0.0035,
    "gps": 0.08,
}


def _kind_of(channel: Channel, name: str) -> str | None:
    if channel.topic == "vehicle/steering":
        joint = name.partition(".")[2]
        return joint if joint in _FASTEST else None
    if channel.topic == "gps/velocity":
        return "gps"
    kind = name.partition(".")[0]
    return kind if kind in _FASTEST else None


def _jumps(recording: Recording) -> Iterator[Finding]:
    """Changes from one message to the next that no car makes."""
    for topic in ("imu/data", "gps/velocity", "vehicle/wheel_speeds", "vehicle/steering"):
        channel = _channel(recording, topic)
        if channel is None:
            continue
        for name, values in measured(channel):
            kind = _kind_of(channel, name)
            if kind is None or (topic == "gps/velocity" and name == "linear.z"):
                continue
            good = np.isfinite(values)
            seconds, values = channel.stamp[good] * 1e-9, values[good]
            if len(values) < 20:
                continue
            step, change = np.diff(seconds), np.diff(values)
            usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.01
            noise = 1.4826 * float(np.median(np.abs(change - np.median(change))))
            fastest, floor = _FASTEST[kind]
            allowed = fastest * np.clip(step, usual, 1.0) + 7 * noise + floor
            jumps = np.flatnonzero(np.abs(change) > allowed)
            jumps = jumps[(step[jumps] < 1.0) & (step[jumps] >= 0)]
            if len(jumps) and len(jumps) < 0.05 * len(values):
                at = (int(channel.stamp[good][jumps[0] + 1]) - recording.start) * 1e-9
                times = f", {len(jumps)} times in all" if len(jumps) > 1 else ""
                yield Finding(topic, "jump", f"{name} jumps by {change[jumps[0]]:+.3g} at {at:.2f} s{times}")


def _quantised(recording: Recording) -> Iterator[Finding]:
    """Signals of which only coarse steps are recorded."""
    for topic in ("imu/data", "gps/velocity", "vehicle/wheel_speeds", "vehicle/steering", "gps/fix"):
        channel = _channel(recording, topic)
        if channel is None:
            continue
        told = []
        for name, values in measured(channel):
            kind = "fix" if topic == "gps/fix" and name in ("latitude", "longitude") else _kind_of(channel, name)
            if kind is None:
                continue
            limit = 2e-6 if kind == "fix" else _RESOLUTION[kind]
            step = _resolution(values)
            if step > limit:
                told.append((name, step))
        if told:
            name, step = max(told, key=lambda item: item[1])
            also = f", likewise {', '.join(n for n, _ in told if n != name)}" if len(told) > 1 else ""
            unit = " deg" if topic == "gps/fix" else ""
            yield Finding(topic, "quantised", f"{name} has steps of {step:.3g}{unit}, which is coarse{also}")


def _resolution(values: Array) -> float:
    """The step of which all values are multiples; 0 where there is none, or too few values to tell."""
    values = values[np.isfinite(values)]
    if len(values) < 50:
        return 0.0
    levels = np.unique(values)
    if len(levels) < 3:
        return 0.0
    steps = np.diff(levels)
    step = float(np.min(steps[steps > 1e-9 * np.abs(levels).max()], initial=np.inf))
    if not np.isfinite(step):
        return 0.0
    beside = np.abs(steps / step - np.rint(steps / step))
    return step if np.mean(beside < 0.03) > 0.97 and np.mean(np.rint(steps / step) < 20) > 0.5 else 0.0


def _frozen_fixes(recording: Recording) -> Iterator[Finding]:
    """GNSS that repeats itself while the car moves."""
    channel = _channel(recording, "gps/velocity")
    if channel is None:
        return
    east, north = channel.columns["linear"][:, :2].T
    same = np.concatenate([[False], (np.diff(east) == 0) & (np.diff(north) == 0)]) & (np.hypot(east, north) > 1.0)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    for begin, end in zip(ends[::2], ends[1::2], strict=True):
        length = (int(channel.stamp[end - 1]) - int(channel.stamp[begin])) * 1e-9
        if length > 1.5 and end - begin >= 5:
            at = (int(channel.stamp[begin]) - recording.start) * 1e-9
            yield Finding("gps/velocity", "frozen", f"is frozen for {length:.1f} s from {at:.1f} s on")
            return


def _apart(recording: Recording) -> Iterator[Finding]:
    """Topics that end early, begin late, or have no time in common with the others; clocks that run or jump."""
    spans = {
        topic: (int(c.stamp.min()), int(c.stamp.max()))
        for topic in INPUTS
        if (c := recording.channels.get(topic)) is not None and len(c) >= 2
    }
    alone = {
        topic
        for topic, (begin, end) in spans.items()
        if len(spans) > 1 and all(begin > e or end < b for other, (b, e) in spans.items() if other != topic)
    }
    if len(spans) > 2 or not alone:
        for topic in alone if len(alone) < len(spans) else ():
            begin, end = spans[topic]
            away = min((begin - e if begin > e else b - end) for o, (b, e) in spans.items() if o != topic) * 1e-9
            yield Finding(topic, "clock", f"has no time in common with the other topics: {away:.1f} s away from them")
    else:
        first, second = sorted(spans)
        yield Finding(first, "clock", f"has no time in common with {second}")
    together = {topic: span for topic, span in spans.items() if topic not in alone}
    for topic, away in _moved(together).items():
        side = "later" if away > 0 else "earlier"
        yield Finding(
            topic, "clock", f"begins and ends {abs(away):.1f} s {side} than the others: is its clock another one?"
        )
        del together[topic]
    for topic, (begin, end) in together.items():
        period = (end - begin) / max(len(recording.channels[topic]) - 1, 1)
        slack = max(1e9, 5 * period)
        later = [e - end for o, (_, e) in together.items() if o != topic and e - end > slack]
        earlier = [begin - b for o, (b, _) in together.items() if o != topic and begin - b > slack]
        if later and 2 * len(later) >= len(together) - 1:
            yield Finding(topic, "cut", f"ends {float(np.median(later)) * 1e-9:.1f} s before the others")
        if earlier and 2 * len(earlier) >= len(together) - 1:
            yield Finding(topic, "cut", f"begins {float(np.median(earlier)) * 1e-9:.1f} s after the others")
    for topic in spans:
        yield from _clock(recording.channels[topic], recording.start)


def _moved(spans: Mapping[str, tuple[int, int]]) -> dict[str, float]:
    """Topics that begin and end by the same time [s] later or earlier than the others, which agree."""
    found = {}
    if len(spans) < 3:
        return {}
    begins, ends = (float(np.median([span[i] for span in spans.values()])) for i in (0, 1))
    for topic, (begin, end) in spans.items():
        first, last = (begin - begins) * 1e-9, (end - ends) * 1e-9
        if min(abs(first), abs(last)) > 1.0 and abs(first - last) < 0.3:
            found[topic] = (first + last) / 2
    return found if len(found) == 1 else {}


def _clock(channel: Channel, start: int) -> Iterator[Finding]:
    """Time stamps that run or step against the times of arrival."""
    if len(channel) < 20 or np.array_equal(channel.stamp, channel.received):
        return
    delay = (channel.received - channel.stamp) * 1e-9
    seconds = (channel.received - channel.received[0]) * 1e-9
    steps = np.diff(delay)
    usual = float(np.median(np.abs(steps))) + 1e-6
    sudden = np.flatnonzero(np.abs(steps) > max(0.25, 20 * usual))
    for index in sudden[:1]:
        before, after = (
            float(np.median(delay[max(index - 8, 0) : index + 1])),
            float(np.median(delay[index + 1 : index + 9])),
        )
        if abs(after - before) > 0.2:
            at = (int(channel.received[index + 1]) - start) * 1e-9
            yield Finding(
                channel.topic, "clock", f"its clock steps by {before - after:+.2f} s at {at:.2f} s, against the arrival"
            )
            return
    parts = 10
    if seconds[-1] < 5.0 or len(channel) < 40:
        return
    edges = np.linspace(0, len(channel), parts + 1).astype(int)
    least = np.array([delay[a:b].min() for a, b in pairwise(edges)])
    middle = np.array([float(np.median(seconds[a:b])) for a, b in pairwise(edges)])
    slope, offset = np.polyfit(middle, least, 1)
    left = float(np.std(least - slope * middle - offset))
    drift = slope * (middle[-1] - middle[0])
    if abs(drift) > max(0.04, 6 * left) and abs(slope) > 1e-3:
        side = "slower" if slope > 0 else "faster"
        yield Finding(channel.topic, "clock", f"its clock runs {abs(slope):.2%} {side} than that of the arrivals")


def _repeated(recording: Recording) -> Iterator[Finding]:
    """Whole topics that are copies of each other."""
    seen: dict[bytes, str] = {}
    for topic in INPUTS:
        channel = recording.channels.get(topic)
        if channel is None or len(channel) < 10:
            continue
        rows = channel.stamp
        again = len(rows) - len(np.unique(rows))
        backwards = int((np.diff(channel.in_order().stamp) < 0).sum())
        if again and backwards and again > int((np.diff(rows) == 0).sum()):
            yield Finding(
                topic, "duplicates", f"{again} messages come a second time with the time stamp of an earlier one"
            )
        seen[channel.stamp.tobytes()] = topic


def _usable(recording: Recording) -> Iterator[Finding]:
    """A recording in which there is nothing to be read."""
    if not any(topic in INPUTS and len(channel) for topic, channel in recording.channels.items()):
        names = ", ".join(sorted(recording.channels)) or "nothing"
        yield Finding("recording", "missing", f"has none of the topics that are read here: it has {names}")
    if recording.messages_lost:
        yield Finding("recording", "cut", f"{recording.messages_lost} messages are lost; the notes say where")
    yield from (Finding("recording", "cut", text) for text in recording.damage)


def findings(recording: Recording, radius: float | None = None) -> list[Finding]:
    """All doubts about a recording; the rolling `radius` [m] is that of the car, if it is known."""
    old = [Finding(topic, _fault(text), text) for topic, texts in doubts(recording, radius).items() for text in texts]
    motion = _Motion.of(recording)
    relations = [] if motion is None else Relations(motion, recording.start).run()
    frames = {f.topic for f in relations if f.fault in ("frame", "axes", "unit", "sign") and f.topic.startswith("gps/")}
    if frames:
        # What was judged by a GNSS velocity that is wrong itself.
        old = [f for f in old if "GNSS" not in f.text and f.topic not in frames]
    clocks = {f.topic for f in _apart(recording) if f.fault == "clock"}
    if clocks:  # what does not go together at other times
        old = [f for f in old if "GNSS" not in f.text or not clocks & {"gps/velocity", "gps/fix", f.topic}]
    if frozen := {f.topic for f in _frozen_fixes(recording)}:
        relations = [f for f in relations if f.topic not in frozen and f.fault not in ("lag", "jump", "frame")]
    repeating = {f.topic for f in _held(recording)}
    relations = [f for f in relations if not (f.fault == "lag" and (clocks or repeating))]
    found: list[Finding] = []
    checks: list[Callable[[Recording], Iterator[Finding]]] = [
        _usable, _held, _jumps, _quantised, _frozen_fixes, _apart, _repeated,
    ]  # fmt: skip
    for finding in (*old, *relations, *(f for check in checks for f in check(recording))):
        said = any(
            f.topic == finding.topic and f.fault == finding.fault and finding.fault in ("sign", "unit", "jump")
            for f in found
        )
        if not said:
            found.append(finding)
    return found


def _fault(text: str) -> Fault:
    """The kind of an older doubt."""
    if "jumps" in text:
        return "jump"
    if "gravity is on" in text:
        return "axes"
    if "against" in text or "backwards" in text:
        return "sign"
    return "unit"


def measured(channel: Channel) -> Iterator[tuple[str, Array]]:
    """Measured values of a channel by name; fields that are marked absent are left out."""
    for name, column in channel.columns.items():
        if "covariance" in name or name in ("status", "service"):
            continue
        if channel.kind == "geometry_msgs/msg/TwistWithCovarianceStamped" and name == "angular":
            continue
        mark = channel.columns.get(f"{name}_covariance")
        if channel.kind == "sensor_msgs/msg/Imu" and mark is not None and mark.shape[1] and (mark[:, 0] == -1).all():
            continue
        labels = channel.names if channel.names else ("x", "y", "z", "w")
        for index in range(column.shape[1]):
            yield (f"{name}.{labels[index]}" if column.shape[1] > 1 or channel.names else name), column[:, index]


# Units and signs, each against GNSS alone


def doubts(recording: Recording, radius: float | None = None) -> dict[str, list[str]]:
    """Doubts about units and signs, by topic; the rolling `radius` [m] is that of the car, if it is known."""
    found = {
        "imu/data": [*_gravity(recording), *_turning(recording)],
        "vehicle/wheel_speeds": list(_rolling(recording, radius)),
        "vehicle/steering": [*_steering_range(recording), *_steering_sign(recording)],
        "gps/fix": list(_fixes(recording)),
        "vehicle/brake_pressure": list(_pressure(recording)),
    }
    return {topic: sentences for topic, sentences in found.items() if sentences}


def _channel(recording: Recording, topic: str) -> Channel | None:
    """A topic of the right type with more than a second of data."""
    channel = recording.channels.get(topic)
    if channel is None or channel.kind != TOPICS[topic].kind or len(channel) < 10 or np.ptp(channel.seconds) < 1.0:
        return None
    return present(channel)


def present(channel: Channel) -> Channel:
    """The channel with NaN where a message marks a vector as absent, as those do that carry a part of a topic."""
    if channel.kind != "sensor_msgs/msg/Imu":
        return channel
    columns = dict(channel.columns)
    for name in ("orientation", "angular_velocity", "linear_acceleration"):
        mark = columns.get(f"{name}_covariance")
        if mark is None or not mark.shape[1]:
            continue
        absent = mark[:, 0] == -1
        if absent.any() and not absent.all():
            columns[name] = np.where(absent[:, None], np.nan, columns[name])
    return replace(channel, columns=columns)


def _gnss_motion(recording: Recording) -> tuple[NDArray[np.int64], Array, Array] | None:
    """Times [ns], speeds [m/s] and unwrapped courses [rad, counter-clockwise from east] of GNSS."""
    channel = _channel(recording, "gps/velocity")
    if channel is None:
        return None
    order = np.argsort(channel.stamp, kind="stable")
    east, north = channel.columns["linear"][order, :2].T
    good = np.isfinite(east) & np.isfinite(north)
    if good.sum() < 10:
        return None
    return channel.stamp[order][good], np.hypot(east, north)[good], np.unwrap(np.arctan2(north, east)[good])


def _at(stamp: NDArray[np.int64], channel: Channel, values: Array) -> Array:
    """Values of a channel at other times; NaN where it has none."""
    good = np.isfinite(values)
    if not good.any():
        return np.full(len(stamp), np.nan)
    order = np.argsort(channel.stamp[good], kind="stable")
    return np.interp(
        (stamp - stamp[0]) * 1e-9, (channel.stamp[good][order] - stamp[0]) * 1e-9, values[good][order], np.nan, np.nan
    )


def _rolling(recording: Recording, known: float | None) -> Iterator[str]:
    wheels, motion = _channel(recording, "vehicle/wheel_speeds"), _gnss_motion(recording)
    if wheels is None or motion is None:
        return
    wheels = wheels.select(np.flatnonzero(np.isfinite(wheels.columns["velocity"]).any(axis=1)))
    if not len(wheels):
        return
    stamp, speed, course = motion
    turning = _at(stamp, wheels, np.nanmean(wheels.columns["velocity"], axis=1))
    moving = (speed > 3.0) & np.isfinite(turning) & (np.abs(turning) > 0.1)
    if moving.sum() < 10:
        return
    # An antenna beside the middle of the car is faster than its wheels in bends to one side, and slower in others.
    bent = np.gradient(course, (stamp - stamp[0]) * 1e-9)[moving] / speed[moving]
    known_well = _ANTENNA * abs(float(np.mean(bent))) < _BESIDE
    radius = float(np.median(speed[moving] / turning[moving]))
    if radius < 0:
        yield "turn backwards while GNSS moves: is the sign wrong?"
    if known is not None and abs(abs(radius) / known - 1.0) < _AS_KNOWN:
        return
    guesses = {"m/s": 1.0, "km/h": 1 / 3.6, "rpm": 2 * np.pi / 60 * 0.32, "deg/s": np.pi / 180 * 0.32}
    for unit, ratio in guesses.items():
        if unit == "km/h" and not known_well:
            continue  # which is near the radius of a small wheel
        tolerance = 0.03 if unit in ("m/s", "km/h") else 0.4
        if abs(abs(radius) / ratio - 1.0) < tolerance:
            yield f"look like {unit}, expected rad/s: GNSS speed is {abs(radius):.4f} times their values"
            return
    if not 0.2 < abs(radius) < 0.6:
        yield f"GNSS speed is {abs(radius):.4f} m times their values, which is no rolling radius of a car"


def _gravity(recording: Recording) -> Iterator[str]:
    imu = _channel(recording, "imu/data")
    if imu is None or (imu.columns["linear_acceleration_covariance"][:, 0] == -1).all():
        return
    mean = np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in imu.columns["linear_acceleration"].T])
    if np.isnan(mean).any():
        return
    size = float(np.linalg.norm(mean))
    if 0.9 < size < 1.1:
        yield "specific force looks like g, expected m/s²: its mean is 1"
    elif size < 1.0:
        yield "specific force has no gravity in it: expected +9.81 m/s² upwards at rest"
    elif abs(size - _GRAVITY) > 1.5:
        yield f"specific force has a mean of {size:.2f}, expected 9.81 m/s²"
    axis = int(np.argmax(np.abs(mean)))
    if size >= 0.9 and (axis != 2 or mean[2] < 0):
        yield f"gravity is on {'-' if mean[axis] < 0 else '+'}{'xyz'[axis]}, expected +z (axes x forward, y left, z up)"


def _turns(recording: Recording, channel: Channel, values: Array) -> tuple[float, float] | None:
    """Slope and correlation of values against the turning rate of the GNSS course, both over one second."""
    motion = _gnss_motion(recording)
    if motion is None:
        return None
    stamp, speed, course = motion
    seconds = (stamp - stamp[0]) * 1e-9
    later = np.searchsorted(seconds, seconds + 1.0)
    row = np.flatnonzero(later < len(seconds))
    later = later[row]
    span = seconds[later] - seconds[row]
    fast = (speed[row] > 5.0) & (speed[later] > 5.0) & (span < 1.5) & (span > 0)
    if fast.sum() < 10:
        return None
    row, later, span = row[fast], later[fast], span[fast]
    rate = (course[later] - course[row]) / span
    good = np.isfinite(values)
    if good.sum() < 10:
        return None
    order = np.argsort(channel.stamp[good], kind="stable")
    time = (channel.stamp[good][order] - stamp[0]) * 1e-9
    sums = np.concatenate([[0.0], np.cumsum(np.diff(time) * values[good][order][:-1])])
    mean = (np.interp(seconds[later], time, sums) - np.interp(seconds[row], time, sums)) / span
    if np.std(rate) < np.radians(0.4) or np.std(mean) == 0.0:
        return None
    correlation = float(np.corrcoef(rate, mean)[0, 1])
    return float(np.std(mean) / np.std(rate)) * np.sign(correlation), correlation


def _turning(recording: Recording) -> Iterator[str]:
    imu = _channel(recording, "imu/data")
    if imu is None or (imu.columns["angular_velocity_covariance"][:, 0] == -1).all():
        return
    found = _turns(recording, imu, imu.columns["angular_velocity"][:, 2])
    if found is None or abs(found[1]) < 0.6:
        return
    slope = found[0]
    if slope < 0:
        yield "the yaw rate is against the turning of the GNSS course: expected positive to the left"
    if 30 < abs(slope) < 100:
        yield f"the yaw rate looks like deg/s, expected rad/s: it is {abs(slope):.1f} times the turning of the course"
    elif not 0.5 < abs(slope) < 2.0 and abs(found[1]) > 0.9:
        yield f"the yaw rate is {abs(slope):.3f} times the turning of the GNSS course, expected 1"


def _steering_range(recording: Recording) -> Iterator[str]:
    steering = _channel(recording, "vehicle/steering")
    if steering is None or steering.columns["position"].shape[1] == 0:
        return
    for index, name in enumerate(steering.names):
        values = steering.columns["position"][:, index]
        largest = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        limit = 1.2 if name.startswith("road_wheel") else 15.0
        if largest > limit:
            yield f"{name} reaches {largest:.1f} rad, which no car does: is it in degrees?"


def _steering_sign(recording: Recording) -> Iterator[str]:
    steering = _channel(recording, "vehicle/steering")
    if steering is None or steering.columns["position"].shape[1] == 0:
        return
    for index, name in enumerate(steering.names):
        found = _turns(recording, steering, steering.columns["position"][:, index])
        if found is None or abs(found[1]) < 0.6:
            continue
        slope = abs(found[0])
        if found[1] < 0:
            yield f"{name} is against the turning of the GNSS course: expected positive to the left"
        # Steering angle over yaw rate is (wheelbase / speed + understeer) times the ratio: below 5 s for any car at
        # more than 5 m/s; in degrees it is at least 57 times the smallest, 0.1 s.
        if slope > (2.0 if name.startswith("road_wheel") else 40.0):
            yield f"{name} is {slope:.0f} s times the yaw rate, which is too much for rad: is it in degrees?"


def _fixes(recording: Recording) -> Iterator[str]:
    channel = _channel(recording, "gps/fix")
    if channel is None:
        return
    latitude, longitude = channel.columns["latitude"][:, 0], channel.columns["longitude"][:, 0]
    if not (np.isfinite(latitude) & np.isfinite(longitude)).any():
        return
    if np.nanmax(np.abs(latitude)) > 90 or np.nanmax(np.abs(longitude)) > 180:
        yield "latitude or longitude is out of range: expected degrees"
        return
    if np.nanmax(np.abs(latitude)) < 1.6 and np.nanmax(np.abs(longitude)) < 3.2:
        yield "latitude and longitude are near zero: are they radians, or is there no fix?"
        return
    motion = _gnss_motion(recording)
    if motion is None:
        return
    stamp, speed, course = motion
    seconds = (channel.stamp - stamp[0]) * 1e-9
    at = (stamp - stamp[0]) * 1e-9
    pause = np.diff(seconds)
    north = np.diff(latitude) * 111_200.0
    east = np.diff(longitude) * 111_200.0 * np.cos(np.radians(latitude[:-1]))
    moved = np.hypot(east, north)
    fast = np.interp(seconds, at, speed)
    reach = np.maximum(fast[:-1], fast[1:]) * np.abs(pause) * 1.5 + 5.0
    # Where the velocity leads, and how far fixes usually are from there: noise of a fix is no jump.
    middle = seconds[:-1] + pause / 2
    way = [np.interp(middle, at, speed * turn(course)) * pause for turn in (np.cos, np.sin)]
    off = np.array([east - way[0], north - way[1]])
    known = off[:, np.isfinite(off).all(axis=0)]
    noise = float(
        np.max(1.4826 * np.median(np.abs(known - np.median(known, axis=1, keepdims=True)), axis=1), initial=0.0)
    )
    beyond = np.hypot(*off) > 5.0 * noise + 5.0
    for index in np.flatnonzero((moved > reach) & beyond & (np.abs(pause) < 60.0)):
        when = (int(channel.stamp[index + 1]) - recording.start) * 1e-9
        yield f"the position jumps by {moved[index]:.1f} m at {when:.2f} s, at {fast[index]:.1f} m/s"


def _pressure(recording: Recording) -> Iterator[str]:
    channel = _channel(recording, "vehicle/brake_pressure")
    if channel is None or channel.columns["effort"].shape[1] == 0:
        return
    largest = float(np.nanmax(channel.columns["effort"]))
    if 0.5 < largest < 1000.0:
        yield f"reaches {largest:.1f} Pa only, which brakes nothing: is it in bar or kPa?"
