"""Which inertial axis is wrong: the one without which all others agree.

The filter is where sensors meet: it predicts what each of them measures from what the others said and from the laws of
the car. An axis of an inertial sensor, a gyro or an accelerometer, is judged by three tests.

1. *A jump.* An innovation of more than `gate` standard deviations is refused as ever, but of the axis alone. If it is
   refused for `_REFUSED`, or if its innovations add up to `_JUMP` standard deviations within 40 ms, it is out.
2. *No noise.* An axis that repeats its value, and used to be noisy, is frozen. It is out from the first repetition on.
3. *A contradiction* that is too small, or grows too slowly, for a gate. If a filter is right, its whitened innovations
   have zero mean and unit variance (Mehra 1970): their sum over n messages, divided by √n, is a standard normal
   number. If it exceeds `_ALARM` within 0.2 s or 1 s, something is wrong, and a vote is taken: what was measured since
   shortly before is filtered again, and again without each of the axes. An axis is wrong if the *others* are
   predictable better without it,

       Δ_i = Σ_{k≠i} (w_k² + 2 ln d_k)  with i  -  Σ_{k≠i} (w_k² + 2 ln d_k)  without i,

   with w the whitened innovation and d its standard deviation: twice the logarithm of what the likelihood of all other
   measurements gains (Schweppe 1965). A right axis helps to predict the others, so that Δ is negative; Δ > `_GAIN` is
   evidence of more than 10¹⁹ to 1. Less will do, `_GAIN_OF_ITS_OWN`, of an axis whose own innovations of the last 0.2 s
   add up to `_OF_ITS_OWN` standard deviations: two tests then say the same. The filter then goes back to before the
   contradiction, and on without the axis.

A vote needs somebody to agree with: where nothing but inertial sensors is there, nobody is taken out. One who is out is
asked on: once its innovations are as they should be for a while, twice as long each time, it is believed again, with a
bias that is not known any more, since it may have jumped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Filter, Given, Innovation
from vsense_ros.estimation.timeline import Channel, Event, Timeline

Array = NDArray[np.float64]

_REFUSED = 20_000_000  # [ns] of refusals in a row, and
_REFUSALS = 3  # at least so many, after which an axis has jumped: no single outlier does that
_STREAK = 50_000_000  # [ns] after which a refusal does not belong to those before
_BLOCK = 20_000_000  # [ns] in which innovations are summed
_WINDOWS = np.array([1, 2, 10, 50])  # blocks of the sums that are looked at: the first two for jumps
_SHORT = 2  # which of them is that of 0.2 s
# Which blocks, of a ring of as many as are looked at, each sum is of when the newest is at a place of it.
_ADDED = 1.0 * ((np.arange(50)[:, None, None] - np.arange(50)) % 50 < _WINDOWS[:, None])
_sum = np.add.reduce
_ALARM = 4.5  # standard deviations of such a sum
_JUMP = 9.5  # the same, of one block or two: the axis has jumped away from what all others say
_JUST_NOW = 200_000_000  # [ns] that are done again then
_CALM = 3.0  # the same of a sensor that agrees
_LOUD = 6.0  # mean normalized innovation squared per component of other sensors, within a second, that is an alarm
_PAUSES = 100_000_000, 1_000_000_000  # [ns] from a vote that decided nothing to the next: the first, and twice as long
_SETTLED = 2_000_000_000  # [ns] from the start on without a vote: what nobody knows yet is not one axis's fault
_URGENT = 1_000_000_000  # [ns] after the alarm each time, to the second
_BEFORE = 200_000_000  # [ns] before the alarm, from which on measurements are filtered again in a vote
_LOOK_BACK = 2_000_000_000  # [ns] that this is at most
_GAIN = 90.0  # twice a logarithm of likelihoods
_OF_ITS_OWN = 7.0  # standard deviations of an axis's own sum of 0.2 s, with which
_GAIN_OF_ITS_OWN = 15.0  # the same is enough
_WORTH_A_VOTE = 0.0  # the same, of leaving out the whole sensor
_DISAGREE = 3.5  # mean square of whitened innovations, beyond which a sensor does not agree with the others
_NEARLY = 0.35  # of the largest gain, from which on another axis may be the wrong one
_SUSPECT = 30.0  # the same, of an axis that is asked about again soon
_FROZEN = 20  # equal values in a row, of an axis that has noise
_LOOKS = 10  # values from one look for frozen axes to the next
_LIVELY = 0.2  # share of values that equal the one before, up to which an axis has noise
_SHARE = 0.03  # of the newest such share in their mean
_ROWS = 128  # messages in a block at most
_ASKED = 10_000_000  # [ns] from one innovation of an axis that is out, to the next
_SAME = 10  # times that it may say the same
_AGREED = 1_000_000_000  # [ns] that it has to agree for the first time
_LONGEST = 60_000_000_000  # [ns] after which an axis that agrees returns in any case
_AGREES = 4.0  # mean normalized innovation squared meanwhile
REMEMBERED = 2.5  # [s] that a timeline has to keep for votes


class Sums:
    """Of the whitened innovations of a sensor with m components over the last blocks: `totals` and `counts` (4, m) of
    each of `_WINDOWS`.

    It is called with every message: all views are made ahead, and beside its total each component has its number times
    `_ALARM`², so that one product tells what a sum is to be held against.
    """

    def __init__(self, m: int) -> None:
        rows, blocks = np.full((_ROWS, 2 * m), _ALARM**2), np.zeros((len(_ADDED), 2 * m))
        self._components, self._rows, self._blocks = m, rows, blocks
        self._values = [row[:m] for row in rows]
        self._first = [rows[:k] for k in range(_ROWS + 1)]
        self._sums, self._totals = list(blocks), [block[:m] for block in blocks]
        self._windows = np.zeros((len(_WINDOWS), 2 * m))
        self.totals, self._limits = self._windows[:, :m], self._windows[:, m:]
        self._square, self._beyond = np.zeros((len(_WINDOWS), m)), np.zeros((len(_WINDOWS), m), dtype=bool)
        self._row, self._block, self._until, self.begun = 0, 0, 0, False

    @property
    def counts(self) -> Array:
        """How many innovations each sum is of (4, m)."""
        return np.rint(self._limits / _ALARM**2)

    def clear(self) -> None:
        """Forget everything."""
        self._row, self._blocks[:], self._windows[:], self.begun = 0, 0.0, 0.0, False

    def forget(self, component: int) -> None:
        """All that a component has said."""
        self._rows[:, component] = 0.0
        for part in (self._blocks, self._windows):
            part[:, [component, self._components + component]] = 0.0

    def add(self, stamp: int, whitened: Array) -> bool:
        """Take in a message (m,), NaN where a component was absent; True where it ends a block after which a sum is as
        far from zero as `_ALARM`."""
        row, place = self._row, self._block
        self._values[row][:] = whitened
        self._row = row = row + 1
        if stamp < self._until and row < _ROWS:
            return False
        total = self._totals[place]
        _sum(self._first[row], axis=0, out=self._sums[place])
        if not isfinite(total.dot(total)):
            values = self._first[row][:, : self._components]
            there = values == values
            self._sums[place][:] = np.hstack([np.where(there, values, 0.0).sum(axis=0), there.sum(axis=0) * _ALARM**2])
        np.dot(_ADDED[place], self._blocks, out=self._windows)
        self._block = place + 1 if place + 1 < len(_ADDED) else 0
        self._row, self._until, self.begun = 0, stamp + _BLOCK, True
        np.square(self.totals, out=self._square)
        return bool(np.count_nonzero(np.greater(self._square, self._limits, out=self._beyond)))

    def far(self) -> Array:
        """How far each sum is from zero (4, m) [standard deviations]."""
        return np.asarray(np.abs(self.totals) / np.sqrt(np.maximum(self.counts, 1.0)))


@dataclass
class Out:
    """An axis that is not believed."""

    since: int  # [ns]
    why: str
    agreed_from: int = 0  # [ns]
    count: int = 0
    squares: float = 0.0
    total: float = 0.0  # of innovations, in units of the axis
    value: float = 0.0  # when it was asked last, and how often it had been the same
    same: int = 0


@dataclass
class Axes:
    """Of one inertial sensor with m components."""

    index: int
    channel: Channel
    words: tuple[str, ...]  # what the components are called
    gate: float  # largest normalized innovation squared of one component
    out: dict[int, Out] = field(default_factory=dict)
    wait: dict[int, int] = field(default_factory=dict)  # how long an axis must agree next time [ns]
    refused_from: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # first, last [ns], how many
    sums: Sums = field(init=False)
    newest: deque[Array] = field(default_factory=lambda: deque(maxlen=_FROZEN))  # as they came
    looked: int = 0  # messages since the last look for frozen axes
    asked: int = 0
    held: Array = field(init=False)  # share of values that equal the one before

    def __post_init__(self) -> None:
        m = len(self.words)
        self.sums, self.held = Sums(m), np.ones(m)

    @property
    def there(self) -> NDArray[np.bool_]:
        """What came of late, (m,)."""
        return np.asarray(self.sums.counts[0] > 0)

    def masked(self, value: Array) -> Array:
        """A measurement without what is out."""
        value = value.copy()
        value[list(self.out)] = np.nan
        return value

    @property
    def absent(self) -> list[str]:
        """What did not come of late."""
        return [
            word for word, there in zip(self.words, self.there.tolist(), strict=True) if not there and self.sums.begun
        ]

    def name(self, axis: int) -> str:
        """Of an axis, with that of its sensor."""
        return f"{self.channel.name} {self.words[axis]}"


class Found(NamedTuple):
    """What the others say without some axes of a sensor: `gain` is Δ, `disagreement` the mean of the squares of the
    whitened innovations of that sensor which agrees least."""

    gain: float
    disagreement: float
    axes: Axes
    left: list[int]


class Vote:
    """Of all inertial sensors of a filter on a timeline.

    `inertial` maps the index of their channels to the names of their components and their gate [standard deviations].
    `others_there()` says whether any other sensor is there that measures, `moving()` whether the car moves. `by_hand`
    lets an event act on the filter that is no measurement; `tell(sensor, sentence)` is called when something of a
    sensor is not believed.
    """

    def __init__(
        self,
        filter: Filter,
        channels: Sequence[Channel],
        inertial: dict[int, tuple[tuple[str, ...], float]],
        *,
        others_there: Callable[[], bool],
        moving: Callable[[], bool],
        by_hand: Callable[[Event], None],
        tell: Callable[[int, str], None],
    ) -> None:
        self._filter = filter
        self._others_there, self._moving, self._by_hand, self._tell = others_there, moving, by_hand, tell
        self.axes = {i: Axes(i, channels[i], words, gate**2) for i, (words, gate) in inertial.items()}
        self.returned: list[tuple[int, int, float]] = []  # sensor and axis, and how far its bias may have jumped
        self._frozen: list[tuple[Axes, int, float]] = []  # and at which value
        self._jumped: list[tuple[Axes, int]] = []
        self._alarm: int | None = None  # since when something is wrong [ns]
        self._voted, self._heard, self._pause = 0, 0, _PAUSES[0]
        self._begun = 0
        self._loud: dict[
            int, tuple[float, float]
        ] = {}  # of other sensors: mean normalized innovation squared, and when
        self._no_vote: set[int] = set()
        self.votes = 0

    def forget(self, stamp: int) -> None:
        """The filter begins anew, at a time [ns]; what is out stays out."""
        self._begun = stamp
        self._alarm, self._voted, self._pause = None, 0, _PAUSES[0]
        self._loud.clear()
        self._no_vote.clear()
        self._frozen.clear()
        self._jumped.clear()
        self.returned.clear()
        for axes in self.axes.values():
            axes.sums.clear()
            axes.refused_from.clear()
            axes.newest.clear()
            for out in axes.out.values():
                out.agreed_from = 0

    def believe_all(self) -> None:
        """Judge no axis from now on: each reading counts as far as its gate lets it."""
        self.axes.clear()

    @property
    def out(self) -> Iterator[tuple[Axes, int, Out]]:
        """All axes that are not believed."""
        for axes in self.axes.values():
            for axis, out in axes.out.items():
                yield axes, axis, out

    # One message

    def correct(self, axes: Axes, event: Event, first: bool) -> Innovation:
        """Let the filter use a message; `first` if it has not been used before. What is not believed of it becomes NaN
        in the event, so that it is not believed when it happens again either."""
        if first:
            axes.newest.append(event.value)
            axes.looked += 1
            if axes.looked >= _LOOKS:
                self._look_for_frozen(axes)
            if axes.out:
                self._ask(axes, event)
                event.value = axes.masked(event.value)
        found = self._filter.correct(axes.channel.name, event.value, event.variance, axes.gate)
        if found.nis > axes.gate:
            return self._look_closer(axes, event, found, first)
        if first:
            if axes.refused_from:
                axes.refused_from.clear()
            if axes.sums.add(event.stamp, found.whitened):
                self._is_far(axes, event.stamp)
        return found

    def _look_closer(self, axes: Axes, event: Event, found: Innovation, first: bool) -> Innovation:
        """Use a message axis by axis, as one of them, or all together, are far from what was expected."""
        seen = Innovation(found.whitened.copy(), found.factor.copy(), found.nis, accepted=False)
        value, used, now = event.value.copy(), 0, event.stamp
        whitened = np.full_like(value, np.nan)
        for axis in np.flatnonzero(np.isfinite(value)).tolist():
            alone = np.full_like(value, np.nan)
            alone[axis] = value[axis]
            found = self._filter.correct(axes.channel.name, alone, event.variance, axes.gate)
            if found.accepted:
                used += 1
                whitened[axis] = found.whitened[axis]
                axes.refused_from.pop(axis, None)
                continue
            event.value = event.value.copy()
            event.value[axis] = np.nan
            if not first:
                continue
            far = abs(found.nis) ** 0.5
            self._tell(axes.index, f"{axes.words[axis]}: innovation {far:.1f} standard deviations")
            begin, last, count = axes.refused_from.get(axis, (now, now, 0))
            if now - last > _STREAK:
                begin, count = now, 0
            axes.refused_from[axis] = begin, now, count + 1
            if now - begin >= _REFUSED and count + 1 >= _REFUSALS and self._others_there():
                self._take_out(axes, axis, begin, "jumped away from all others")
        if first and axes.sums.add(now, whitened):
            self._is_far(axes, now)
        limit = axes.channel.limit
        return seen._replace(nis=min(seen.nis, limit) if used else max(seen.nis, 1.01 * limit), accepted=used > 0)

    def _is_far(self, axes: Axes, stamp: int) -> None:
        """Raise the alarm where innovations of a sensor add up to more than noise does."""
        far = axes.sums.far()
        if far[:2].max() > _JUMP and stamp - self._begun >= _SETTLED and self._others_there():
            self._jumped.append((axes, int(far[:2].max(axis=0).argmax())))
        for window, furthest in zip(_WINDOWS[2:].tolist(), far[2:].max(axis=1).tolist(), strict=True):
            if furthest > _ALARM:
                self._sound(stamp, stamp - window * _BLOCK)
                break

    def measured(self, index: int, stamp: int, nis: float, components: int, limit: float) -> None:
        """The normalized innovation squared of a measurement of another sensor. One that is refused, and was in
        agreement with all just before, has jumped itself: it has no vote."""
        mean, before = self._loud.get(index) or (1.0, stamp)
        if nis > limit and mean < _CALM:
            self._no_vote.add(index)
        elif self._no_vote and nis <= limit:
            self._no_vote.discard(index)
        if index in self._no_vote:
            return
        passed = stamp - before
        if passed > 0:
            mean += min(passed * 1e-9, 1.0) * (min(nis, 100.0) / components - mean)
        self._loud[index] = mean, stamp
        if mean > _LOUD:
            self._sound(stamp, stamp - _LOOK_BACK)

    def _sound(self, now: int, since: int) -> None:
        """Raise the alarm, or keep it up."""
        if self._alarm is None or now - self._heard > _PAUSES[1]:
            self._alarm, self._pause = since - _BEFORE, _PAUSES[0]
        self._heard = now

    def _look_for_frozen(self, axes: Axes) -> None:
        """Whether an axis is frozen."""
        axes.looked, newest = 0, axes.newest
        if len(newest) < _FROZEN:
            return
        same = newest[-1] == newest[-2]
        if not np.count_nonzero(same):
            axes.held *= 1 - _SHARE  # a noisy sensor hardly says the same twice
            return
        if np.count_nonzero(same & (newest[-1] == newest[-_FROZEN])):
            values = np.array(newest)[-_FROZEN:]
            for axis in np.flatnonzero((values == values[-1]).all(axis=0) & (axes.held < _LIVELY)).tolist():
                if axis not in axes.out and self._moving():
                    self._frozen.append((axes, axis, float(values[-1, axis])))
        axes.held += _SHARE * (same - axes.held)

    def froze(self, index: int, value: Array) -> None:
        """All of a sensor has said this for so long that it is frozen."""
        axes = self.axes[index]
        for axis in np.flatnonzero(np.isfinite(value)).tolist():
            if axis not in axes.out:
                self._frozen.append((axes, axis, float(value[axis])))

    # Out, and in again

    def _take_out(self, axes: Axes, axis: int, since: int, why: str) -> None:
        axes.out[axis] = Out(since, why)
        axes.refused_from.pop(axis, None)
        axes.sums.forget(axis)
        self._tell(axes.index, f"{axes.words[axis]} {why}: not believed any more")

    def _ask(self, axes: Axes, event: Event) -> None:
        """What those that are out would say, and whether they agree by now."""
        now = event.stamp
        if now - axes.asked < _ASKED:
            return
        axes.asked = now
        for axis, out in list(axes.out.items()):
            alone = np.full_like(event.value, np.nan)
            alone[axis] = event.value[axis]
            out.same = out.same + 1 if alone[axis] == out.value else 0
            out.value = alone[axis]
            if not np.isfinite(alone[axis]) or out.same >= _SAME:
                out.agreed_from = 0
                continue
            found = self._filter.correct(axes.channel.name, alone, event.variance, -1.0)
            if not out.agreed_from or not found.nis <= axes.gate:
                out.agreed_from, out.count, out.squares, out.total = now, 0, 0.0, 0.0
                continue
            out.count += 1
            out.squares += found.nis
            out.total += float(found.whitened[axis] * found.factor[axis, axis])
            wait = axes.wait.get(axis, _AGREED)
            if now - out.agreed_from < wait:
                continue
            if out.squares > _AGREES * out.count:
                out.agreed_from = 0
                continue
            del axes.out[axis]
            axes.wait[axis] = min(2 * wait, _LONGEST)
            self.returned.append((axes.index, axis, abs(out.total) / out.count))

    # A vote

    def due(self, now: int) -> bool:
        """Whether something is to be decided."""
        return bool(self._frozen or self._jumped) or (
            self._alarm is not None
            and self._heard > self._voted
            and now - self._voted >= self._pause
            and now - self._begun >= _SETTLED
            and self._others_there()
        )

    def decide(self, timeline: Timeline) -> None:
        """Go back to before an axis froze; or take a vote, and if an axis is wrong, go back to before it was
        believed."""
        now = timeline.stamp
        for axes, axis, value in self._frozen:
            self._take_out(axes, axis, now, "is frozen")
            self._undo(timeline, now - _LOOK_BACK, axes, axis, value)
        for axes, axis in self._jumped:
            self._take_out(axes, axis, now - _JUST_NOW, "jumped away from all others")
            self._undo(timeline, now - _JUST_NOW, axes, axis)
        if self._frozen or self._jumped:
            self._frozen.clear()
            self._jumped.clear()
            return
        since = max(self._alarm or 0, now - _LOOK_BACK)
        if now - since > _URGENT:
            self._pause = min(2 * self._pause, _PAUSES[1])
        self._voted = now
        self.votes += 1
        everybody = self._scores(timeline, since, None)
        if everybody is None:
            return
        found: list[Found] = []
        for axes in self.axes.values():
            within = [a for a in np.flatnonzero(axes.there).tolist() if a not in axes.out]
            loud = axes.sums.far()[_SHORT].max() > _OF_ITS_OWN
            if not loud and self._without(timeline, since, everybody, axes, within).gain < _WORTH_A_VOTE:
                continue
            found += [self._without(timeline, since, everybody, axes, [a]) for a in within]
        if not found:
            return
        best = max(found, key=lambda one: one.gain)
        enough, suspect = _GAIN, _SUSPECT
        if best.axes.sums.far()[_SHORT, best.left[0]] > _OF_ITS_OWN:
            enough = suspect = _GAIN_OF_ITS_OWN
        if best.gain < suspect or best.disagreement > _DISAGREE:
            return
        self._pause = _PAUSES[0]
        if best.gain < enough:
            return
        self._alarm = None
        # Who is nearly as suspect as the worst may be the one: to do without both costs little, to believe one much.
        for one in found:
            if one.gain > max(suspect, _NEARLY * best.gain) and one.disagreement <= _DISAGREE:
                self._take_out(one.axes, one.left[0], since, "contradicts the others")
                self._undo(timeline, since, one.axes, one.left[0])
        self._loud.clear()
        for others in self.axes.values():
            others.sums.clear()

    def _undo(self, timeline: Timeline, since: int, axes: Axes, axis: int, value: float | None = None) -> None:
        """Go on from a time as if an axis had not said anything, or not this value."""
        for event in timeline.rewind(since):
            if event.sensor == axes.index and (value is None or event.value[axis] == value):
                event.value = event.value.copy()
                event.value[axis] = np.nan

    def _without(
        self, timeline: Timeline, since: int, everybody: dict[int, Array], axes: Axes, left: list[int]
    ) -> Found:
        """What the others say without some axes of a sensor."""
        without = self._scores(timeline, since, (axes.index, left))
        found = Found(-np.inf, np.inf, axes, left)
        if without is None:
            return found
        gain, disagreement = 0.0, 0.0
        for index, score in everybody.items():
            if index in self._no_vote:
                continue
            pair = np.array([score, without[index]])
            if index == axes.index:
                pair = np.delete(pair, left, axis=2)
            gain += float((pair[0, 0] - pair[1, 0]).sum())
            _, squares, count = pair[1].sum(axis=1).tolist()
            disagreement = max(disagreement, squares / max(count, 1.0))
        return Found(gain, disagreement, axes, left)

    def _scores(self, timeline: Timeline, since: int, without: tuple[int, list[int]] | None) -> dict[int, Array] | None:
        """Of each sensor (3, m): Σ (w² + 2 ln d), Σ w² and number of each component since a time, if some axes of one
        sensor had not been there."""
        scores: dict[int, Array] = {}

        def act(event: Event) -> None:
            channel = timeline.channels[event.sensor]
            if channel.by_hand:
                self._by_hand(event)
                return
            if channel.first_input is not None:
                self._filter.give(Given(channel.first_input, event.value))
                return
            value, axes = event.value, self.axes.get(event.sensor)
            if without is not None and event.sensor == without[0]:
                value = value.copy()
                value[without[1]] = np.nan
            limit = channel.limit if axes is None else axes.gate
            found = self._filter.correct(channel.name, value, event.variance, limit)
            score = scores.setdefault(event.sensor, np.zeros((3, len(value))))
            if axes is None or not found.nis > limit:
                _score(score, found)
                return
            for axis in np.flatnonzero(np.isfinite(value)).tolist():
                alone = np.full_like(value, np.nan)
                alone[axis] = value[axis]
                _score(score, self._filter.correct(channel.name, alone, event.variance, limit))

        return scores if timeline.again(since, act) else None


def _score(score: Array, found: Innovation) -> None:
    if found.nis < 0:
        return
    whitened, deviation = found.whitened, found.factor.diagonal()
    there = whitened == whitened
    squares = np.minimum(whitened[there] ** 2, 36.0)
    score[0, there] += squares + 2 * np.log(np.maximum(deviation[there], 1e-9))
    score[1, there] += squares
    score[2, there] += 1.0
