"""A recount: what was measured since a time, filtered again with and without axes of an inertial sensor.

`runner.vote` has the test that it serves, and its sources.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors.base import MeasuredQuantity
from vsense_ros.runner.adapter import Adapter, Widening
from vsense_ros.runner.axes import Axes
from vsense_ros.runner.sums import SHORT
from vsense_ros.runner.vote_settings import STEERING, VOTE

Array = NDArray[np.float64]
_OF_PLACE: frozenset[MeasuredQuantity] = frozenset({"course", "heading", "position"})
Scores = dict[int, Array]  # by sensor (3, m): Σ (w² + 2 ln d), Σ w² and number of each component


class Ballot(NamedTuple):
    """A vote of the others without some axes of a sensor: `gain` is Δ, `disagreement` the mean of the squares of the
    whitened innovations of that sensor which agrees least. `against` is what those components lose that are predicted
    worse, `by_place` the part of the gain that is of sensors which measure the car's way on the map."""

    gain: float
    disagreement: float
    axes: Axes
    left: list[int]
    against: float = 0.0
    by_place: float = 0.0
    largest: float = 0.0

    def is_split(self, spared: Collection[tuple[int, int]]) -> bool:
        """True if the others do not agree that the axes are wrong: some are predicted much worse without them, or only
        the model says so, which is known to be wrong where axes are `spared`, and GNSS does not. Nor do they where
        nearly all of the gain is of one component: of two that contradict each other either may be wrong, or the model
        between them."""
        if self.gain - self.largest < min(VOTE.second * self.gain, VOTE.gain):
            return True
        enough = min(VOTE.gain, max(VOTE.suspect, VOTE.second * self.gain))
        only_model = any((self.axes.index, axis) in spared for axis in self.left) and self.by_place < enough
        return self.against > VOTE.suspect or only_model


class Belief(NamedTuple):
    """What follows from an axis that is believed.

    `gain` is twice the logarithm of what the likelihood of all others gains; other axes of its sensor, which may be
    wrong like it, can only speak against it. `own` is the mean square of the whitened innovations of the axis.
    """

    gain: float
    own: float


class Recount:
    """The votes of all sensors by what they have measured since a time [ns]; those in `without_vote` have none.

    `axes` are those of the inertial sensors; `by_hand` lets an event act on the filter that is no measurement.
    """

    def __init__(
        self,
        timeline: Timeline,
        since: int,
        adapter: Adapter,
        axes: Mapping[int, Axes],
        without_vote: Collection[int],
        by_hand: Callable[[Event], None],
    ) -> None:
        self._timeline, self._since = timeline, since
        self._adapter, self._axes, self._without_vote, self._by_hand = adapter, axes, without_vote, by_hand

    @cached_property
    def everybody(self) -> Scores | None:
        """The scores with all axes and sensors; None if the filter can not go back to that time."""
        return self._scores(None)

    def ballots(self, confirmed: Collection[tuple[int, int]]) -> list[Ballot]:
        """The votes of the others without each axis that may be wrong, none that is out, by sensor and axis; and
        without all of these of a sensor. One that a direct witness has confirmed is wrong only where those sensors
        that are such witnesses say so by themselves: a witness has wide margins, which they do without."""
        ballots: list[Ballot] = []
        for axes in self._axes.values():
            believed = [a for a in axes.present if a not in axes.out]
            for a in believed:
                if (axes.index, a) in confirmed and (one := self.without(axes, [a])).by_place > VOTE.gain:
                    ballots.append(one)
            within = [a for a in believed if (axes.index, a) not in confirmed]
            if not within:
                continue
            loud = axes.sums.far()[SHORT, : len(axes.words)].max() > VOTE.own
            together = self.without(axes, within)
            if not loud and together.gain < VOTE.worth_a_vote:
                continue
            ballots += [self.without(axes, [a]) for a in within] + [together] * (len(within) > 1)
        return ballots

    def without(self, axes: Axes, left: list[int]) -> Ballot:
        """Let the others vote without some axes of a sensor."""
        everybody = self.everybody
        without = None if everybody is None else self._scores((axes.index, left))
        if everybody is None or without is None:
            return Ballot(-np.inf, np.inf, axes, left)
        gain, disagreement, against, by_place, largest = 0.0, 0.0, 0.0, 0.0, 0.0
        for index, score in everybody.items():
            if index in self._without_vote:
                continue
            pair = np.array([score, without[index]])
            if index == axes.index:
                pair = np.delete(pair, left, axis=2)
            gains = pair[0, 0] - pair[1, 0]
            gain += float(gains.sum())
            largest = max(largest, float(gains.max(initial=0.0)))
            against -= float(np.minimum(gains, 0.0).sum())
            if self._adapter.measures(index) & _OF_PLACE:
                by_place += float(gains.sum())
            _, squares, count = pair[1].sum(axis=1).tolist()
            disagreement = max(disagreement, squares / max(count, 1.0))
        return Ballot(gain, disagreement, axes, left, against, by_place, largest)

    def believing(self, axes: Axes, axis: int) -> Belief:
        """What follows if an axis that is out had been believed."""
        without, believed = self.everybody, self._scores(None, believed=(axes.index, axis))
        if without is None or believed is None or axes.index not in believed:
            return Belief(-np.inf, np.inf)
        gain = elsewhere = 0.0
        for index, score in without.items():
            gains = score[0] - believed[index][0]
            if index == axes.index:
                gain += float(np.delete(gains, axis).sum())
            elif index not in self._without_vote:
                elsewhere += float(gains.sum())
        _, squares, count = believed[axes.index][:, axis].tolist()
        return Belief(min(gain, 0.0) + elsewhere, squares / count if count else np.inf)

    def steering_explains(self, best: Ballot) -> bool:
        """True if a wrong steering angle explains what all have measured, the axis that seems wrong included, better
        than that axis does. Then nobody is left out: the direct witnesses will see the steering."""
        error, everybody = self._adapter.steering_error, self.everybody
        if error is None or everybody is None:
            return False
        free = self._scores(None, free=error)
        if free is None:
            return False
        gain = sum(
            float((score[0] - free[i][0]).sum()) for i, score in everybody.items() if i not in self._without_vote
        )
        return gain > best.gain + _beyond_noise(everybody[best.axes.index], best.left)

    def wrong_sensor(self, best: Ballot, candidates: Collection[int]) -> int | None:
        """The one of some whole sensors without which all others agree, the axis that seems wrong among them, and are
        predicted better than without that axis; None if there is none. Where all axes of a sensor seem wrong, it is the
        sensor without which the others gain more. It has to explain what the axis read: wheels that slip agree less
        with all others, too, while an axis jumps for another reason."""
        everybody, alone = self.everybody, self._scores((best.axes.index, best.left))
        if everybody is None or alone is None:
            return None
        found, most = None, max(VOTE.gain_with_own, best.gain if len(best.left) > 1 else 0.0)
        for index in candidates:
            if index not in everybody:
                continue
            whole = index, list(range(everybody[index].shape[1]))
            without = self._scores(whole)
            if without is None:
                continue
            gain = more = disagreement = 0.0
            for i, score in without.items():
                if i == index or i in self._without_vote:
                    continue
                _, squares, count = score.sum(axis=1).tolist()
                disagreement = max(disagreement, squares / max(count, 1.0))
                common = [c for c in range(score.shape[1]) if i != best.axes.index or c not in best.left]
                gain += float((everybody[i] - score)[0].sum())
                more += float((alone[i] - score)[0, common].sum())
            agree = gain > most and more > 0.0 and disagreement < VOTE.disagree
            if agree and self._explains(whole, best, everybody, without):
                found, most = index, gain
        return found

    def _explains(self, whole: tuple[int, list[int]], best: Ballot, before: Scores, after: Scores) -> bool:
        """True if what the axes of a ballot read beyond their noise is gone for the most part without a `whole` sensor,
        by the scores with it and without it; what was refused of a single axis counts, too."""
        if len(best.left) == 1:
            refused = best.axes.index, best.left[0]
            with_it, without_it = self._scores(None, believed=refused), self._scores(whole, believed=refused)
            if with_it is None or without_it is None:
                return False
            before, after = with_it, without_it
        if best.axes.index not in before or best.axes.index not in after:
            return False
        first, left = (_beyond_noise(scores[best.axes.index], best.left) for scores in (before, after))
        return left <= VOTE.unexplained * first

    def _scores(
        self,
        without: tuple[int, list[int]] | None,
        free: int | None = None,
        believed: tuple[int, int] | None = None,
    ) -> Scores | None:
        """The scores as if some axes of one sensor had not been there; or as if the steering had not been, whose error
        is the element `free` of the state; or as if one axis of a sensor had been `believed`, however far it was from
        what was expected."""
        found: dict[int, list[tuple[Array, Array]]] = {}  # by sensor: whitened innovations and their deviations
        timeline, widened = self._timeline, self._since

        def act(event: Event) -> None:
            nonlocal widened
            channel = timeline.channels[event.sensor]
            if free is not None and event.stamp - widened >= STEERING.period:
                self._adapter.widen(Widening(free, STEERING.density * (event.stamp - widened) * 1e-9))
                widened = event.stamp
            if channel.by_hand:
                self._by_hand(event)
                return
            if channel.first_input is not None:
                if free is None or "steering" not in self._adapter.measures(event.sensor):
                    self._adapter.give(channel, event)
                return
            axes, gate = self._axes.get(event.sensor), np.inf
            if believed is not None and event.sensor == believed[0] and event.whole is not None:
                whole, axis = event.whole, believed[1]
                event = Event(event.sensor, event.stamp, event.value.copy(), event.variance)
                event.value[axis] = whole[axis]
            if without is not None and event.sensor == without[0]:
                event = Event(event.sensor, event.stamp, event.value.copy(), event.variance)
                event.value[without[1]] = np.nan
            if axes is None:
                innovation = self._adapter.correct(channel, event)
            else:
                if believed is None or event.sensor != believed[0]:
                    gate = axes.gate
                innovation = self._adapter.inertial.correct(channel, event, gate)
            seen = found.setdefault(event.sensor, [])
            if axes is None or not innovation.nis > gate:
                seen.append(_copied(innovation))
                return
            for _, alone in self._adapter.inertial.correct_by_axis(channel, event, axes.gate):
                seen.append(_copied(alone))

        if not timeline.again(self._since, act):
            return None
        return {sensor: _score(*(np.array(part) for part in zip(*seen, strict=True))) for sensor, seen in found.items()}


def _beyond_noise(score: Array, axes: list[int]) -> float:
    """By how much the squares of the whitened innovations of some axes of a sensor add up to more than noise does."""
    _, squares, count = score[:, axes].sum(axis=1).tolist()
    return max(squares - count, 0.0)


def _copied(innovation: Innovation) -> tuple[Array, Array]:
    """The whitened innovation of a measurement and its deviations, (m,) each, NaN where nothing was measured."""
    if innovation.nis < 0:
        nothing = np.full(len(innovation.whitened), np.nan)
        return nothing, nothing
    return innovation.whitened.copy(), innovation.factor.diagonal().copy()


def _score(whitened: Array, deviation: Array) -> Array:
    """The scores (3, m) of a sensor by its n whitened innovations and their deviations, (n, m) each."""
    there = whitened == whitened
    squares = np.where(there, np.minimum(whitened**2, VOTE.largest_square), 0.0)
    logarithms = np.where(there, 2 * np.log(np.maximum(deviation, 1e-9)), 0.0)
    # Added one after the other, as sums of pairs would round otherwise.
    return np.stack([part.cumsum(axis=0)[-1] for part in (squares + logarithms, squares, 1.0 * there)])
