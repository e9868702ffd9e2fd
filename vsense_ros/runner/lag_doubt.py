"""What lags of sensors may do to an estimate before they are found, or known to be none.

For a lag τ that is small beside the motion, two sensors of one rate r differ by

    e = -τ ṙ + g r.

The share g is what one of them measures too much: rear wheels roll on radii that the load of a bend changes, by 13 to
27 % of the yaw rate at 20 m/s. At the entry of a bend it looks like a lag, at its exit like the opposite. Twice a
second a Kalman filter of each pair takes in what the newest readings say of both; the information of n readings is

    Σ ṙ₁ ṙ₂ / (k s²) of τ,    Σ r₁ r₂ / (k s²) of g,

the products being of both sensors so that noise makes no motion; s² is the variance of what e has besides, of which k
values in a row are one. Before a bend or a change of speed shows anything, τ and g are zero with the standard
deviations that stamps and readings usually have. Where readings contradict what is known of τ, more is unknown. What τ
may be beyond what suspension and tyres look like makes errors in proportion to the motion: of yaw rate r, speed v and
heading

    δr = τ |ṙ|    δv_x = τ |v̇|    δv_y = τ |v r|    δψ = τ |r|

which fade as the filter corrects them, and a place gathers those of the velocity.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from math import exp, hypot, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vsense_ros.runner.adapter import Apart

Array = NDArray[np.float64]
TURN, GAIN = 0, 1  # the motions that are compared: turning and gaining speed


@dataclass(frozen=True)
class LagDoubtSettings:
    """How far lags are doubted: decisions of this project."""

    period: int = 500_000_000  # [ns] between two looks at the newest readings, while they leave a doubt, or
    relaxed: int = 1_000_000_000  # [ns] while they do not
    deviation: float = 0.03  # [s] of a lag before readings show anything: receivers and buses have 0.02 to 0.07
    shown: float = 0.1  # [s] of one that they contradict, until they have shown how long it is
    longest: float = 0.4  # [s] of a lag, for which a motion is still one of these equations
    least: float = 0.005  # [s] standard deviation of a lag, however long it is looked at
    walk: float = 2e-6  # [s²/s] by which its variance grows: 0.01 s in a minute
    share: float = 0.2  # [-] of a rate that a sensor measures too much, before it is known
    # [m] half of half a track: wheels that show a share more of a turn are too fast outside or too slow inside, and the
    # speed by all of them is wrong by half of that.
    speed_arm: float = 0.4
    share_time: float = 20.0  # [s] in which that is another, as it changes with the speed
    jump: float = 4.0  # [-] standard deviations from which on a lag has changed
    step: float = 0.04  # [s] between the values that are compared
    newest: float = 2.0  # [s] that are compared after a pause
    independent: float = 0.5  # [s] from one independent value to the next
    fades: float = 20.0  # [s] in which an offset between two sensors and the noise are found
    # Standard deviations of a difference of two sensors before it is known: of turn [rad/s] and gain of speed [m/s²].
    noise: tuple[float, float] = (0.01, 0.2)
    # Of a car at most, in these units: readings beyond say nothing of a lag, and their squares need not be finite.
    most: tuple[float, float] = (20.0, 100.0)
    sideways: float = 0.4  # [-] share of a velocity that is turned by a lag, which the filter believes
    over: float = 0.2  # [s] in which rates of the motion are taken
    corrected: float = 4.0  # [s] in which a filter corrects velocity, heading and place
    answered: float = 0.5  # [s] in which it corrects a yaw rate
    nothing: float = 0.003  # [s] of a lag that does nothing


DOUBT = LagDoubtSettings()


class Heard(Protocol):
    """Motion by one sensor: means of its rates of turn and of gain of speed (2, n) around times, over a span [s]."""

    rows: Array

    @property
    def period(self) -> float: ...
    def rates(self, times: Array, span: float) -> Array: ...


class _Pair:
    """By how much the stamps of one sensor are later than those of another, by one motion [s], and by which share it
    measures more of the motion: `mean` (2,) and `covariance` (2, 2) of both."""

    def __init__(self, noise: float, usual: float) -> None:
        self._usual = usual
        self._spread = noise**2
        self._offset = 0.0
        self.mean, self.covariance = np.zeros(2), np.diag([0.0, DOUBT.share**2])
        self.begin(DOUBT.deviation)

    def begin(self, deviation: float) -> None:
        """The lag is zero as far as is known, with a standard deviation."""
        self.mean[0] = 0.0
        self._know_little(deviation)

    def _know_little(self, deviation: float) -> None:
        """The lag has a standard deviation, whatever the share is."""
        self.covariance[0] = self.covariance[:, 0] = deviation**2, 0.0

    @property
    def doubt(self) -> float:
        """Root mean square of the lag, without what is usual [s]."""
        return sqrt(max(self.mean.item(0) ** 2 + self.covariance.item(0) - self._usual**2, 0.0))

    @property
    def share(self) -> float:
        """Root mean square of the share."""
        return sqrt(self.mean.item(1) ** 2 + self.covariance.item(3))

    def _age(self, seconds: float) -> None:
        """Let both change for a time [s]."""
        lag, share = self.covariance.diagonal().tolist()
        lag = max(lag, min(lag + DOUBT.walk * seconds, DOUBT.deviation**2))
        fade = exp(-seconds / DOUBT.share_time)
        self.mean[1] *= fade
        self.covariance[0, 1] = self.covariance[1, 0] = fade * self.covariance[0, 1]
        self.covariance[0, 0], self.covariance[1, 1] = lag, DOUBT.share**2 + fade**2 * (share - DOUBT.share**2)

    def take_in(self, one: Array, other: Array) -> None:
        """Take in rates by both sensors (n,) at times a step apart."""
        steps = DOUBT.step
        self._age(steps * len(one))
        # Of lag and share (2, n), by each sensor.
        of_one, of_other = (np.array([(r[:-2] - r[2:]) / (2 * steps), r[1:-1]]) for r in (one, other))
        difference = (one - other)[1:-1] - self._offset
        share = 1 - exp(-steps * len(difference) / DOUBT.fades)
        self._offset += share * float(difference.mean())
        products = of_one @ of_other.T
        products = _of_real_motion(products)
        left = difference - self.mean @ of_one
        if products is not None:
            both = 0.5 * (of_one + of_other)
            seen = both @ difference
            fitted = np.linalg.lstsq(products, seen, rcond=1e-6)[0]
            left = difference - fitted @ both
            spread = max(self._spread, float(left @ left) / len(left))
            noise = spread * DOUBT.independent / steps
            self._doubt_if_changed(seen, products, noise)
            known = np.linalg.inv(self.covariance)
            self.covariance = np.linalg.inv(known + products / noise)
            self.mean = self.covariance @ (known @ self.mean + seen / noise)
            self.mean[0] = min(max(self.mean.item(0), -DOUBT.longest), DOUBT.longest)
            self.covariance[0, 0] = max(self.covariance.item(0), DOUBT.least**2)
        self._spread += share * (float(left @ left) / len(left) - self._spread)

    def _doubt_if_changed(self, seen: Array, products: Array, noise: float) -> None:
        """Know little of the lag where readings contradict it: their products with the motion, `seen` (2,), and those
        of the motion (2, 2); `noise` is the variance of a reading for each of them."""
        moved, turned = products[0].tolist()
        lag = min(max((seen.item(0) - turned * self.mean.item(1)) / moved, -DOUBT.longest), DOUBT.longest)
        variance = noise / moved + (turned / moved) ** 2 * self.covariance.item(3)
        if (lag - self.mean.item(0)) ** 2 > DOUBT.jump**2 * (self.covariance.item(0) + variance):
            self._know_little(DOUBT.shown)


def _of_real_motion(products: Array) -> Array | None:
    """Products of two sensors' motions (2, 2) as those of one motion; None where noise is all they are."""
    first, second = products.diagonal().tolist()
    if not (first > 0 and second > 0):
        return None
    most = sqrt(first * second)
    mixed = min(max(0.5 * (products.item(1) + products.item(2)), -most), most)
    return np.array([[first, mixed], [mixed, second]])


class LagDoubt:
    """The doubt about lags of one car's sensors, of pairs of them by the motions that they compare, with the standard
    deviations of what suspension, tyres and levers make look like a lag [s]; `lags` are the largest by turning and by
    gaining speed [s]. `wheels` is the place of the wheel speeds, -1 for none."""

    def __init__(self, usual: Mapping[tuple[tuple[int, int], int], float], wheels: int = -1) -> None:
        self._pairs = {(pair, motion): _Pair(DOUBT.noise[motion], s) for (pair, motion), s in usual.items()}
        self._rolling = [one for (pair, motion), one in self._pairs.items() if motion == TURN and wheels in pair]
        self._until: dict[tuple[int, int], float] = {}
        self._recent: deque[tuple[int, tuple[float, float], float]] = deque(maxlen=16)
        self._lasting = Apart()
        self.lags = self._widest()

    def _widest(self) -> tuple[float, float]:
        """The largest doubt of all pairs by turning and by gaining speed [s]."""
        turn, gain = (
            max((one.doubt for (_, kind), one in self._pairs.items() if kind == motion), default=0.0)
            for motion in (TURN, GAIN)
        )
        return turn * (turn > DOUBT.nothing), gain * (gain > DOUBT.nothing)

    @property
    def period(self) -> int:
        """Time from one look at the newest readings to the next [ns]."""
        return DOUBT.period if any(self.lags) else DOUBT.relaxed

    def forget(self) -> None:
        """Times count anew."""
        self._until.clear()
        self._recent.clear()
        self._lasting = Apart()

    def changed(self, sensor: int, deviation: float) -> None:
        """What is taken off the stamps of a sensor has changed; it has a standard deviation [s]."""
        for (pair, _), one in self._pairs.items():
            if sensor in pair:
                one.begin(deviation)
        self.lags = self._widest()

    def compare(self, motions: Mapping[int, Heard], late: Mapping[int, float]) -> None:
        """Take in what is new of the motions by sensors, whose stamps are taken to be late [s]."""
        there = {i: motion for i, motion in motions.items() if len(motion.rows) > 2}
        for pair in combinations(there, 2):
            if (pair, GAIN) not in self._pairs:
                continue
            one, other = (there[i] for i in pair)
            span = max(2 * max(one.period, other.period), DOUBT.over)
            ends = [there[i].rows[-1, 0] - late.get(i, 0.0) for i in pair]
            until = min(ends) - span
            begin = self._until.get(pair, until)
            if until - begin < DOUBT.period * 1e-9:
                self._until.setdefault(pair, until)
                continue
            self._until[pair] = until
            begin = max(begin, until - DOUBT.newest)
            times = np.arange(begin - DOUBT.step, until + DOUBT.step, DOUBT.step)
            for motion, rates in enumerate(
                zip(*(there[i].rates(times + late.get(i, 0.0), span) for i in pair), strict=True)
            ):
                if (np.abs(rates) < DOUBT.most[motion]).all() and (pair, motion) in self._pairs:
                    self._pairs[pair, motion].take_in(*rates)
        self.lags = self._widest()

    def feel(self, stamp: int, h: float, yaw_rates: tuple[float, float], speed: float) -> None:
        """Take in how the car moves at a time [ns], `h` [s] after the last one, and how it turns by gyro and steering,
        of which one may be the later one [rad/s]. Nothing is taken in while one of them is none of a car."""
        if not all(abs(one) < DOUBT.most[TURN] for one in yaw_rates):
            return
        while self._recent and stamp - self._recent[0][0] > 1.5e9 * DOUBT.over:
            self._recent.popleft()
        self._recent.append((stamp, yaw_rates, speed))
        before, its_rates, its_speed = self._recent[0]
        yaw_rate = max(map(abs, yaw_rates))
        turned = max(abs(now - then) for now, then in zip(yaw_rates, its_rates, strict=True))
        passed = max((stamp - before) * 1e-9, h)
        turn, gain = self.lags
        ahead, across = gain * abs(speed - its_speed) / passed, DOUBT.sideways * turn * abs(speed) * yaw_rate
        fade, soon, was = exp(-h / DOUBT.corrected), exp(-h / DOUBT.answered), self._lasting
        share = max((one.share for one in self._rolling), default=0.0)
        # v̇_x = a_x + v_y r
        ahead = hypot(ahead, across * yaw_rate * DOUBT.answered, DOUBT.speed_arm * share * yaw_rate)
        self._lasting = Apart(
            ahead=max(ahead, fade * was.ahead),
            across=max(across, fade * was.across),
            yaw_rate=max(turn * turned / passed, soon * was.yaw_rate),
            place=fade * was.place + h * hypot(ahead, turn * abs(speed) * yaw_rate),
            heading=max(turn * yaw_rate, fade * was.heading),
        )

    @property
    def apart(self) -> Apart:
        """Standard deviations of the errors that lags may make now."""
        return self._lasting
