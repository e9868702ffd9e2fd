"""The vote about inertial sensors: an axis is wrong if all others agree without it.

The filter is where sensors meet: it predicts what each of them measures from what the others measured and from the laws
of the car. An axis of an inertial sensor, a gyro or an accelerometer, is judged by three tests, whose limits stand in
`vote_settings`.

1. *A jump.* An innovation of more than `gate` standard deviations is refused, but of the axis alone. If it is refused
   for `refused_for`, or if its innovations add up to `jump` standard deviations within 40 ms, the axis is out.
2. *No noise.* An axis that repeats its value, and used to be noisy, is frozen. It is out from the first repetition on.
3. *A contradiction* that is too small, or grows too slowly, for a gate. If a filter is right, its whitened innovations
   have zero mean and unit variance (Mehra 1970): their sum over n messages, divided by √n, is a standard normal
   number. If it exceeds `alarm` within 0.2 s or 1 s, something is wrong, and a vote is taken: what was measured since
   shortly before is filtered again, and again without each of the axes. An axis is wrong if the *others* are
   predicted better without it,

       Δ_i = Σ_{k≠i} (w_k² + 2 ln d_k)  with i  -  Σ_{k≠i} (w_k² + 2 ln d_k)  without i,

   with w the whitened innovation and d its standard deviation: twice the logarithm of what the likelihood of all other
   measurements gains (Schweppe 1965). A right axis helps to predict the others, so that Δ is negative; Δ > `gain` is
   evidence of more than 10¹⁹ to 1. Less will do, `gain_with_own`, of an axis whose own innovations of the last 0.2 s
   add up to `own` standard deviations: two tests then say the same. The filter then goes back to before the
   contradiction, and on without the axis. Where the others scatter by more than they state, Δ is too large by the mean
   square of their whitened innovations, and `gain` is multiplied by that.

Deviations are those that innovations usually have (`sums`): no filter of a real car is as good as it states.

The others must agree. Where nearly all of the gain is of a single component, and the rest is no evidence by itself, two
contradict each other, or the model between them is wrong. If the readings that are predicted worse without the axis
lose more than `suspect`, the model is wrong and not the axis: a gyro that is wrong is contradicted by all wheels, not
by those of one axle. And while the lateral forces are known not to be those of the vehicle file (`force_judge`), the
yaw rate is out only if GNSS alone says so, by `gain`, or by `suspect` and a quarter of the whole gain: all other
sensors contradict it through that model. For the first `look_back` of an alarm that has to have been known before it,
because a gyro that is wrong makes the forces seem so. All of a sensor is out where the others do not agree about a
single axis, and gain more, by `suspect`, without all of them. Until it is decided who is wrong, the lateral velocity
that is published is as uncertain as it is large: a wrong gyro integrates to it (`jury_judge`).

A vote needs somebody to agree with: where nothing but inertial sensors is there, nobody is taken out. One who is out
may be right, and the filter wrong: it appeals (`appeal`). It is asked on, too: once its innovations are as they should
be for a while, twice as long each time, it is believed again, with a bias that is not known any more, since it may have
jumped. One that was frozen and moves on from the value at which it stood was at the end of its range: it measures what
it measured before, and is believed at once, whatever the model has come to expect meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.runner.adapter import Adapter
from vsense_ros.runner.appeal import Appeals
from vsense_ros.runner.axes import FROZEN, Axes, Out
from vsense_ros.runner.recount import Ballot, Recount
from vsense_ros.runner.sums import SHORT, WINDOWS
from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]


class Vote:
    """The vote about all inertial sensors of a filter on a timeline; `adapter` knows the axes that the filter can do
    without.

    `others_there()` is true if any other sensor measures the motion of the car. `by_hand` lets an event act on the
    filter that is no measurement; `report(sensor, sentence)` is called when something of a sensor is not believed, with
    an empty one when that was wrong.
    """

    def __init__(
        self,
        adapter: Adapter,
        channels: Sequence[Channel],
        *,
        others_there: Callable[[], bool],
        by_hand: Callable[[Event], None],
        report: Callable[[int, str], None],
    ) -> None:
        self._adapter, self._inertial = adapter, adapter.inertial
        self._others_there, self._by_hand, self._report = others_there, by_hand, report
        self.axes = {
            i: Axes(i, channels[i], one.words, one.judged, one.conditions, one.gate**2)
            for i, one in adapter.inertial.axes().items()
        }
        self.returned: list[tuple[int, int, float]] = []  # sensor and axis, and how far its bias may have jumped
        self.appeals = Appeals(self.axes, self.returned, report)
        self._frozen: list[tuple[Axes, int, float]] = []  # and at which value
        self._jumped: list[tuple[Axes, int, float]] = []  # and how far [usual deviations]
        self.alarm: int | None = None  # since when something is wrong [ns]
        self._voted, self._pause = 0, VOTE.first_pause
        self.begun = self.heard = 0  # when the filter began, and the alarm was raised or kept up last [ns]
        self._loud: dict[
            int, tuple[float, float]
        ] = {}  # of other sensors: mean normalized innovation squared, and when
        self._no_vote: set[int] = set()
        # Sensors and axes that a direct witness confirms, and the stamp of its newest message that does [ns].
        self.confirmed: dict[tuple[int, int], int] = {}
        self.spared: frozenset[tuple[int, int]] = frozenset()  # axes that contradict a model known to be wrong
        self._spared_before = self.spared  # these at the time of the alarm, and when that was raised [ns]
        self._raised = 0
        self.wait = False  # True while something else may be wrong, and no axis is left out
        # Places of whole sensors that may be what is wrong, where axes of a sensor at a place seem to be.
        self.jury: Callable[[int, list[int]], list[int]] = lambda index, axes: []
        self.accused: int | None = None  # the one of them that a vote has found to be
        self.undecided = False  # True while an axis is suspect, and the others do not agree that it is wrong
        self.doubted = False  # True once several axes were wrong at once, which has drawn the filter anywhere

    def forget(self, stamp: int) -> None:
        """The filter begins anew, at a time [ns]; what is out stays out."""
        self.begun = stamp
        self.alarm, self._voted, self._pause = None, 0, VOTE.first_pause
        self.undecided = False
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

    @property
    def out(self) -> Iterator[tuple[Axes, int, Out]]:
        """All axes that are not believed."""
        for axes in self.axes.values():
            for axis, out in axes.out.items():
                yield axes, axis, out

    def left_out(self, index: int) -> list[int]:
        """The axes of an inertial sensor that are out."""
        axes = self.axes.get(index)
        return list(axes.out) if axes is not None else []

    def frozen(self, index: int) -> list[int]:
        """Those of them that are because they are frozen."""
        return [axis for axis in self.left_out(index) if self.axes[index].out[axis].why == FROZEN]

    # One message

    def correct(self, axes: Axes, event: Event, first: bool) -> Innovation:
        """Let the filter use a message; `first` if it has not been used before. What is not believed of it becomes NaN
        in the event, so that it is not believed when it happens again either."""
        if first:
            axes.newest.append(event.value)
            axes.looked += 1
            if axes.looked >= VOTE.looks:
                self._look_for_frozen(axes)
            if axes.out:
                self._ask(axes, event)
                event.without(list(axes.out))
        innovation = self._inertial.correct(axes.channel, event, axes.gate)
        if innovation.nis > axes.gate:
            return self._look_closer(axes, event, innovation, first)
        if first:
            if axes.refused_from:
                axes.refused_from.clear()
            if axes.sums.add(event.stamp, innovation.whitened):
                self._is_far(axes, event.stamp)
        return innovation

    def _look_closer(self, axes: Axes, event: Event, innovation: Innovation, first: bool) -> Innovation:
        """Use a message axis by axis, as one of them, or all together, are far from what was expected."""
        seen = Innovation(innovation.whitened.copy(), innovation.factor.copy(), innovation.nis, accepted=False)
        value, used, now = event.value.copy(), 0, event.stamp
        whitened = np.full_like(seen.whitened, np.nan)
        for axis, innovation in self._inertial.correct_by_axis(axes.channel, replace(event, value=value), axes.gate):
            if innovation.accepted:
                used += 1
                whitened[axis] = innovation.whitened[axis]
                axes.refused_from.pop(axis, None)
                continue
            far = abs(innovation.nis) ** 0.5
            if far <= (axes.gate * axes.sums.usual.item(0, axis)) ** 0.5:
                whitened[axis] = innovation.whitened[axis]
                if self._inertial.believe(axes.channel, replace(event, value=value), axis):
                    used += 1
                    continue
            event.without([axis])
            if not first:
                continue
            self._report(axes.index, f"{axes.words[axis]}: innovation {far:.1f} standard deviations")
            begin, last, count = axes.refused_from.get(axis, (now, now, 0))
            if now - last > VOTE.streak:
                begin, count = now, 0
            axes.refused_from[axis] = begin, now, count + 1
            long = now - begin >= VOTE.refused_for and count + 1 >= VOTE.refusals
            confirmed = self.confirmed.get((axes.index, axis))
            if confirmed is not None:
                if long and confirmed - begin >= VOTE.confirmed:
                    # A direct witness has measured the same for a while, so that the model is wrong.
                    event.value[axis] = value[axis]
                    used += self._inertial.believe(axes.channel, event, axis)
            elif long and not self.wait and self._others_there():
                del axes.refused_from[axis]
                self._jumped.append((axes, axis, far / axes.sums.usual.item(0, axis) ** 0.5))
        if first and axes.sums.add(now, whitened):
            self._is_far(axes, now)
        limit = axes.channel.limit
        return seen._replace(nis=min(seen.nis, limit) if used else max(seen.nis, 1.01 * limit), accepted=used > 0)

    def _is_far(self, axes: Axes, stamp: int) -> None:
        """Raise the alarm where innovations of a sensor add up to more than noise does."""
        far = axes.sums.far()
        quick = far[:2, : len(axes.words)]
        for index, axis in self.confirmed:
            if index == axes.index:
                quick[:, axis] = 0.0
        if quick.max() > VOTE.jump and stamp - self.begun >= VOTE.settled and self._others_there():
            self._jumped.append((axes, int(quick.max(axis=0).argmax()), 0.0))
        for window, sums in zip(WINDOWS[2:].tolist(), far[2:], strict=True):
            if np.any(sums > axes.sums.alarm):
                self._sound(stamp, stamp - window * VOTE.block)
                break

    def measured(self, index: int, stamp: int, nis: float, components: int, limit: float) -> None:
        """The normalized innovation squared of a measurement of another sensor. One that is refused, and was in
        agreement with all just before, has jumped itself: it has no vote."""
        mean, before = self._loud.get(index) or (1.0, stamp)
        if nis > limit and mean < VOTE.calm:
            self._no_vote.add(index)
        elif self._no_vote and nis <= limit:
            self._no_vote.discard(index)
        if index in self._no_vote:
            return
        passed = stamp - before
        if passed > 0:
            mean += min(passed * 1e-9, 1.0) * (min(nis, 100.0) / components - mean)
        self._loud[index] = mean, stamp
        if mean > VOTE.loud:
            self._sound(stamp, stamp - VOTE.look_back)

    def _sound(self, now: int, since: int) -> None:
        """Raise the alarm, or keep it up."""
        if self.alarm is None or now - self.heard > VOTE.last_pause:
            self.alarm, self._pause = since - VOTE.before, VOTE.first_pause
            self._raised, self._spared_before = now, self.spared
        self.heard = now

    def _look_for_frozen(self, axes: Axes) -> None:
        """Note the axes that have repeated their value too often."""
        axes.looked, newest = 0, axes.newest
        if len(newest) < VOTE.frozen:
            return
        same = newest[-1] == newest[-2]
        if not np.count_nonzero(same):
            axes.held *= 1 - VOTE.share  # a noisy sensor hardly says the same twice
            return
        if np.count_nonzero(same & (newest[-1] == newest[-VOTE.frozen])):
            values = np.array(newest)[-VOTE.frozen :]
            for axis in np.flatnonzero((values == values[-1]).all(axis=0) & (axes.held < VOTE.lively)).tolist():
                if axis in axes.judged and axis not in axes.out and self._adapter.moving:
                    self._frozen.append((axes, axis, float(values[-1, axis])))
        axes.held += VOTE.share * (same - axes.held)

    def froze(self, index: int, value: Array) -> None:
        """All of a sensor has said this for so long that it is frozen."""
        axes = self.axes[index]
        for axis in np.flatnonzero(np.isfinite(value)).tolist():
            if axis in axes.judged and axis not in axes.out:
                self._frozen.append((axes, axis, float(value[axis])))

    # Out, and in again

    def _take_out(self, axes: Axes, axis: int, since: int, why: str, now: int, far: float = 0.0) -> None:
        """Do not believe an axis any more, which was so `far` from what was expected of single readings."""
        sums = axes.sums.far()[:, axis]
        sums[0] = max(sums[0], far)
        axes.leave_out(axis, Out(since, why, now, far=sums))
        self._report(axes.index, f"{axes.words[axis]} {why}: not believed any more")

    def _ask(self, axes: Axes, event: Event) -> None:
        """Compare the axes that are out with what is expected, and believe those again that agree by now."""
        now = event.stamp
        if now - axes.asked < VOTE.asked:
            return
        axes.asked = now
        for axis, out in list(axes.out.items()):
            value = float(event.value[axis])
            out.same = out.same + 1 if value == out.value else 0
            out.value = value
            if not np.isfinite(value) or out.same >= VOTE.same:
                out.agreed_from = out.moved = 0
                continue
            if self._moved_on(axes, axis, out):
                axes.believe(axis, now)
                self.returned.append((axes.index, axis, 0.0))
                continue
            innovation = self._inertial.innovation_of_axis(axes.channel, event, axis)
            usual = axes.sums.usual.item(0, axis)
            if not out.agreed_from or not innovation.nis <= usual * axes.gate:
                out.agreed_from, out.count, out.squares, out.total = now, 0, 0.0, 0.0
                continue
            out.count += 1
            out.squares += innovation.nis
            out.total += float(innovation.whitened[axis] * innovation.factor[axis, axis])
            wait = axes.wait.get(axis, VOTE.agreed)
            if now - out.agreed_from < wait:
                continue
            if out.squares > VOTE.agrees * usual * out.count:
                out.agreed_from = 0
                continue
            axes.believe(axis, now)
            axes.wait[axis] = min(2 * wait, VOTE.longest)
            self.returned.append((axes.index, axis, abs(out.total) / out.count))

    def _moved_on(self, axes: Axes, axis: int, out: Out) -> bool:
        """True if an axis that was frozen has gone on from the value at which it stood."""
        if out.value == out.stood:
            out.moved = 0
        elif out.moved == 0:
            noise = float(self._adapter.intake.sensors[axes.index].deviations()[axis])
            on = abs(out.value - out.stood) <= VOTE.step * noise
            out.moved, out.stood = (1, out.stood) if on else (0, nan)
        else:
            out.moved += 1
        return out.moved > VOTE.moved

    # A vote

    def due(self, now: int) -> bool:
        """True if something is to be decided: an axis froze or jumped, or there is an alarm and it is time to vote."""
        if self.wait:
            return False
        if self._frozen or self._jumped or self.appeals.due(now):
            return True
        return (
            self.alarm is not None
            and self.heard > self._voted
            and now - self._voted >= self._pause
            and now - self.begun >= VOTE.settled
            and self._others_there()
        )

    def decide(self, timeline: Timeline) -> None:
        """Go back to before an axis froze or jumped; or take a vote, and if an axis is wrong, go back to before it was
        believed."""
        if self._frozen or self._jumped:
            self._without_broken(timeline)
            self._frozen.clear()
            self._jumped.clear()
        elif self.appeals.due(timeline.stamp):
            self.appeals.hear(timeline, self._recount)
        else:
            self._take_vote(timeline)

    def _without_broken(self, timeline: Timeline) -> None:
        """Leave out the axes that froze or jumped."""
        now = timeline.stamp
        for axes, axis, value in self._frozen:
            self._take_out(axes, axis, now, FROZEN, now)
            axes.out[axis].stood = axes.out[axis].value = value
            self._undo(timeline, now - VOTE.look_back, axes, axis, value)
        since = now - VOTE.redone_after_jump
        if self._jumped and not self._frozen and self._jump_of_another(timeline, since):
            return
        for axes, axis, far in self._jumped:
            self._take_out(axes, axis, since, "jumped away from all others", now, far)
            self._undo(timeline, since, axes, axis)

    def _spares(self, now: int) -> frozenset[tuple[int, int]]:
        """Axes that contradict a model which was known to be wrong before: a gyro that is wrong makes it seem so."""
        return self.spared if now - self._raised > VOTE.look_back else self._spared_before

    def _take_vote(self, timeline: Timeline) -> None:
        """Filter again what was measured since the alarm, with and without each axis, and leave out those that are
        wrong."""
        now = timeline.stamp
        since = max(self.alarm or 0, now - VOTE.look_back)
        if now - self.begun < VOTE.settled + VOTE.first_pause:  # nobody could be left out before
            self._raised, self._spared_before = now, self.spared
        if now - since > VOTE.urgent:
            self._pause = min(2 * self._pause, VOTE.last_pause)
        self._voted, self.undecided = now, False
        recount = self._recount(timeline, since)
        if recount.everybody is None:
            return
        ballots = recount.ballots(self.confirmed)
        if not ballots:
            return
        spared = self._spares(now)
        ballots, best, far = self._likeliest(ballots, spared)
        enough, suspect = (VOTE.gain_with_own,) * 2 if far else (VOTE.gain, VOTE.suspect)
        self.undecided = best.gain >= suspect
        if not self.undecided or best.disagreement > VOTE.disagree:
            return
        self._pause = VOTE.first_pause
        # Where the others scatter by more than is stated, a logarithm of likelihoods is too large by as much.
        if best.gain < enough * max(1.0, best.disagreement) or best.is_split(spared) or self._is_another(recount, best):
            return
        self.alarm, self.undecided = None, False
        # Who is nearly as suspect as the worst may be the one: to do without both costs little, to believe one much.
        for one in ballots:
            near = one.gain > max(suspect, VOTE.nearly * best.gain) and one.disagreement <= VOTE.disagree
            if near and len(one.left) == len(best.left) and not one.is_split(spared):
                self.doubted |= len(one.left) > 1
                for axis in one.left:
                    self._take_out(one.axes, axis, since, "contradicts the others", now)
                    self._undo(timeline, since, one.axes, axis)
        self._loud.clear()
        for others in self.axes.values():
            others.sums.clear()

    def _likeliest(
        self, ballots: list[Ballot], spared: frozenset[tuple[int, int]]
    ) -> tuple[list[Ballot], Ballot, bool]:
        """Those that come into question, and the best of them: without a single axis, or without several at once where
        the others do not agree that a single one is wrong. The third is true if that axis is far from what is expected
        by itself."""
        best = max((one for one in ballots if len(one.left) == 1), key=lambda one: one.gain)
        agreed = best.disagreement <= VOTE.disagree
        if agreed and not best.is_split(spared):
            return ballots, best, bool(best.axes.sums.far()[SHORT, best.left[0]] > VOTE.own)
        least = max(VOTE.gain, best.gain + VOTE.suspect) if agreed else VOTE.gain
        together = [one for one in ballots if one.gain > least and one.disagreement <= VOTE.disagree]
        return together or ballots, max(together, key=lambda one: one.gain, default=best), False

    def _undo(self, timeline: Timeline, since: int, axes: Axes, axis: int, value: float | None = None) -> None:
        """Go on from a time as if an axis had not said anything, or not this value."""
        for event in timeline.rewind(since):
            if event.sensor == axes.index and (value is None or event.value[axis] == value):
                event.without([axis])

    def doubtful(self, since: int) -> Iterator[tuple[Axes, int, Out]]:
        """Axes that were left out after a time [ns] for what they read then, as if nothing else had been wrong."""
        return ((axes, axis, out) for axes, axis, out in self.out if out.decided >= since and out.why != FROZEN)

    def reconsider(self, since: int, ahead: Sequence[Event]) -> None:
        """Believe again what was left out after a time [ns], as something else was wrong then; `ahead` is what happens
        once more."""
        for axes, axis, _ in list(self.doubtful(since)):
            del axes.out[axis]
            self._report(axes.index, "")
        for event in ahead:
            judged = self.axes.get(event.sensor)
            if judged is not None and event.whole is not None:
                event.value, event.whole = event.whole, None
                if judged.out:
                    event.without(list(judged.out))
        self.forget(self.begun)

    def _jump_of_another(self, timeline: Timeline, since: int) -> bool:
        """True if axes seem to have jumped because the steering angle or a whole sensor has."""
        axes, axis, _ = self._jumped[0]
        if self._adapter.steering_error is None and not self.jury(axes.index, [axis]):
            return False
        recount = self._recount(timeline, since)
        if recount.everybody is None:
            return False
        return self._is_another(recount, recount.without(axes, [axis]))

    def _is_another(self, recount: Recount, best: Ballot) -> bool:
        """True if steering or a whole sensor explain better than an axis what contradicts; the sensor is accused."""
        if recount.steering_explains(best):
            return True
        self.accused = recount.wrong_sensor(best, self.jury(best.axes.index, best.left))
        return self.accused is not None

    def _recount(self, timeline: Timeline, since: int) -> Recount:
        return Recount(timeline, since, self._adapter, self.axes, self._no_vote, self._by_hand)
