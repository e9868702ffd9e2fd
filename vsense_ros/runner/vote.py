"""The vote about sensors: whoever is wrong is found by all others, and left out.

The filter is where sensors meet: it predicts what each of them measures from what the others measured and from the laws
of the car. Each axis of a gyro or an accelerometer, each wheel, each other sensor, and the steering, which drives the
model, can be the one that is wrong (`suspects`). Limits stand in `vote_settings`.

1. *A jump.* An innovation of more than `gate` standard deviations is refused, but of the axis of an inertial sensor
   alone. If it is refused for `refused_for`, or if its innovations add up to `jump` standard deviations within 40 ms,
   something has jumped: the axis, or what it is predicted from.
2. *No noise.* An axis that repeats its value, and used to be noisy, is frozen. It is out from the first repetition on.
3. *A contradiction* that is too small, or grows too slowly, for a gate. If a filter is right, its whitened innovations
   have zero mean and unit variance (Mehra 1970): their sum over n messages, divided by √n, is a standard normal number.
   If it exceeds `alarm` within 0.2 s or 1 s, something is wrong.

After a jump or an alarm a vote is taken: the recent past is filtered again without each suspect (`trial`). Wrong is who
explains all the rest: without it all others agree, and are predicted better by `gain`, evidence of more than 10¹⁹ to 1.
Less will do, `gain_with_own`, of a component whose own innovations of the last 0.2 s add up to `own` standard
deviations: two tests then say the same. If nobody alone explains the rest, two together may. The filter then goes back
to before the contradiction, and on without them. An input that is left out is held, and its error estimated from all
other sensors, as it may change by `input_density`.

While a vote has found somebody to be suspect, and not decided, the contradiction is `open`: the estimate may be as
wrong as the hypotheses differ.

A vote needs somebody to agree with: where nothing but inertial sensors is there, nobody is taken out. One who is out is
asked on: once its innovations are as they should be for a while, twice as long each time, it is believed again, with a
bias that is not known any more, since it may have jumped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.runner.adapter import Adapter, Move, Widening
from vsense_ros.runner.components import Components
from vsense_ros.runner.sums import SHORT, WINDOWS
from vsense_ros.runner.suspects import Out, Suspect
from vsense_ros.runner.trial import Hypothesis, Trial
from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]

JUMPED, CONTRADICTS, FROZEN = "jumped away from all others", "contradicts the others", "is frozen"


@dataclass(frozen=True)
class Contradiction:
    """A contradiction that no vote has decided: since when [ns], and who may be wrong, the likeliest first."""

    since: int
    suspects: tuple[Suspect, ...]


class Vote:
    """The vote about all sensors of a filter on a timeline; `adapter` knows what the filter can do without.

    `others_there()` is true if any other sensor measures the motion of the car. `by_hand` lets an event act on the
    filter that is no measurement; `tell(sensor, sentence)` is called when something of a sensor is not believed.
    """

    def __init__(
        self,
        adapter: Adapter,
        channels: Sequence[Channel],
        *,
        others_there: Callable[[], bool],
        by_hand: Callable[[Event], None],
        tell: Callable[[int, str], None],
    ) -> None:
        self._adapter = adapter
        self._others_there, self._by_hand, self._tell = others_there, by_hand, tell
        self.components = {i: _components(i, channels[i], adapter) for i in adapter.judged()}
        self._inputs = {
            i: Suspect(i, (), channels[i].name, "", element) for i, element in adapter.input_errors().items()
        }
        self.out: dict[Suspect, Out] = {}
        self.open: Contradiction | None = None
        self.asked: list[Move | Widening] = []  # of the state, because somebody is out or believed again
        self._wait: dict[Suspect, int] = {}  # how long one must agree next time [ns]
        self._frozen: list[tuple[Suspect, float]] = []  # and at which value
        self._jumped: list[Suspect] = []
        self._alarm: int | None = None  # since when something is wrong [ns]
        self._voted, self._heard, self._pause = 0, 0, VOTE.first_pause
        self._begun = self._widened = 0
        self._loud: dict[int, tuple[float, int]] = {}  # mean normalized innovation squared of a sensor, and when
        self.votes = 0

    def forget(self, stamp: int) -> None:
        """The filter begins anew, at a time [ns]; what is out stays out."""
        self._begun = self._widened = stamp
        self._alarm, self._voted, self._pause = None, 0, VOTE.first_pause
        self._loud.clear()
        self._frozen.clear()
        self._jumped.clear()
        self.asked.clear()
        self._close()
        for components in self.components.values():
            components.sums.clear()
            components.refused_from.clear()
            components.newest.clear()
        for out in self.out.values():
            out.agreed_from = 0

    def believe_all(self) -> None:
        """Judge nothing from now on: each reading counts as far as its gate lets it."""
        self.components.clear()
        self._inputs.clear()

    def is_inertial(self, sensor: int) -> bool:
        """True for an inertial sensor that is judged."""
        components = self.components.get(sensor)
        return components is not None and components.inertial

    def without(self, sensor: int) -> Iterator[tuple[Suspect, Out]]:
        """What of a sensor is not believed."""
        return ((suspect, out) for suspect, out in self.out.items() if suspect.sensor == sensor)

    # One message

    def correct(self, components: Components, event: Event, first: bool) -> Innovation:
        """Let the filter use a message; `first` if it has not been used before. What is not believed of it becomes NaN
        in the event, so that it is not believed when it happens again either."""
        channel = components.channel
        if first and components.left:
            self._ask(components, event)
            if components.left:
                event.value = components.masked(event.value)
        if not components.inertial:
            found = self._adapter.correct(channel, event)
            if first and not found.nis < 0 and components.sums.add(event.stamp, _bounded(found.whitened)):
                self._is_far(components, event.stamp)
            return found
        if first:
            components.newest.append(event.value)
            components.looked += 1
            if components.looked >= VOTE.looks:
                self._look_for_frozen(components)
        found = self._adapter.correct_inertial(channel, event, components.gate)
        if found.nis > components.gate:
            return self._look_closer(components, event, found, first)
        if first:
            if components.refused_from:
                components.refused_from.clear()
            if components.sums.add(event.stamp, found.whitened):
                self._is_far(components, event.stamp)
        return found

    def _look_closer(self, components: Components, event: Event, found: Innovation, first: bool) -> Innovation:
        """Use a message axis by axis, as one of them, or all together, are far from what was expected."""
        seen = Innovation(found.whitened.copy(), found.factor.copy(), found.nis, accepted=False)
        value, used, now = event.value.copy(), 0, event.stamp
        whitened = np.full_like(seen.whitened, np.nan)
        channel = components.channel
        for axis, found in self._adapter.correct_by_axis(channel, replace(event, value=value), components.gate):
            if found.accepted:
                used += 1
                whitened[axis] = found.whitened[axis]
                components.refused_from.pop(axis, None)
                continue
            if event.whole is None:
                event.whole = event.value
            event.value = event.value.copy()
            event.value[axis] = np.nan
            if not first:
                continue
            far = abs(found.nis) ** 0.5
            self._tell(components.index, f"{components.words[axis]}: innovation {far:.1f} standard deviations")
            begin, last, count = components.refused_from.get(axis, (now, now, 0))
            if now - last > VOTE.streak:
                begin, count = now, 0
            components.refused_from[axis] = begin, now, count + 1
            if now - begin >= VOTE.refused_for and count + 1 >= VOTE.refusals and self._others_there():
                self._jumped.append(components.alone(axis))
        if first and components.sums.add(now, whitened):
            self._is_far(components, now)
        limit = channel.limit
        return seen._replace(nis=min(seen.nis, limit) if used else max(seen.nis, 1.01 * limit), accepted=used > 0)

    def _is_far(self, components: Components, stamp: int) -> None:
        """Raise the alarm where innovations of a sensor add up to more than noise does."""
        far = components.sums.far()
        quick = far[:2, : len(components.words)]
        settled = stamp - self._begun >= VOTE.settled
        if components.inertial and quick.max() > VOTE.jump and settled and self._others_there():
            self._jumped.append(components.alone(int(quick.max(axis=0).argmax())))
        for window, sums in zip(WINDOWS[2:].tolist(), far[2:], strict=True):
            if np.any(sums > components.sums.alarm):
                self._sound(stamp, stamp - window * VOTE.block)
                break

    def measured(self, index: int, stamp: int, nis: float, components: int) -> None:
        """The normalized innovation squared of a measurement of a sensor that is not inertial."""
        if nis < 0:
            return
        mean, before = self._loud.get(index) or (1.0, stamp)
        passed = stamp - before
        if passed > 0:
            mean += min(passed * 1e-9, 1.0) * (min(nis, 100.0) / components - mean)
        self._loud[index] = mean, stamp
        if mean > VOTE.loud:
            self._sound(stamp, stamp - VOTE.look_back)

    def hear_input(self, event: Event) -> None:
        """An input has come that has not been used before. If it is not believed, it becomes NaN in the event."""
        suspect = self._inputs.get(event.sensor)
        out = None if suspect is None else self.out.get(suspect)
        if suspect is None or out is None:
            return
        error = suspect.input_error
        assert error is not None
        far, deviation = self._adapter.input_innovation(event, error, out.offset)
        agrees = bool(abs(far) <= VOTE.input_gate * deviation)
        if not agrees or not out.agreed_from:
            out.agreed_from, out.count, out.squares = event.stamp if agrees else 0, 0, 0.0
        else:
            out.count += 1
            out.squares += (far / deviation) ** 2
            if self._may_return(suspect, out, event.stamp):
                self.asked += self._adapter.input_returns(event, error, out.offset)
                return
        event.value = np.full_like(event.value, np.nan)

    def pass_time(self, now: int) -> None:
        """Ask for what the errors of inputs that are left out may have changed by since the last time."""
        if not self.out or now - self._widened < VOTE.widened:
            return
        passed, self._widened = min(now - self._widened, VOTE.look_back), now
        self.asked += [
            Widening(suspect.input_error, VOTE.input_density * passed * 1e-9)
            for suspect in self.out
            if suspect.input_error is not None
        ]

    def _sound(self, now: int, since: int) -> None:
        """Raise the alarm, or keep it up."""
        if self._alarm is None or now - self._heard > VOTE.last_pause:
            self._alarm, self._pause = since - VOTE.before, VOTE.first_pause
        self._heard = now

    def _look_for_frozen(self, components: Components) -> None:
        """Note the axes that have repeated their value too often."""
        components.looked, newest = 0, components.newest
        if len(newest) < VOTE.frozen:
            return
        same = newest[-1] == newest[-2]
        if not np.count_nonzero(same):
            components.held *= 1 - VOTE.share  # a noisy sensor hardly says the same twice
            return
        if np.count_nonzero(same & (newest[-1] == newest[-VOTE.frozen])):
            values = np.array(newest)[-VOTE.frozen :]
            for axis in np.flatnonzero((values == values[-1]).all(axis=0) & (components.held < VOTE.lively)).tolist():
                if axis in components.judged and axis not in components.left and self._adapter.moving:
                    self._frozen.append((components.alone(axis), float(values[-1, axis])))
        components.held += VOTE.share * (same - components.held)

    def froze(self, index: int, value: Array) -> None:
        """All of a sensor has said this for so long that it is frozen."""
        components = self.components[index]
        for axis in np.flatnonzero(np.isfinite(value)).tolist():
            if axis in components.judged and axis not in components.left:
                self._frozen.append((components.alone(axis), float(value[axis])))

    # Out, and in again

    def _take_out(self, suspect: Suspect, since: int, why: str) -> None:
        self.out[suspect] = Out(since, why)
        components = self.components.get(suspect.sensor)
        if components is not None:
            components.left = sorted({*components.left, *suspect.components})
            for component in suspect.components:
                components.refused_from.pop(component, None)
                components.sums.forget(component)
        self._tell(suspect.sensor, f"{suspect.words} {why}: not believed any more".strip())

    def _ask(self, components: Components, event: Event) -> None:
        """Compare what is out with what is expected, and believe again who agrees by now."""
        now = event.stamp
        if now - components.asked < VOTE.asked:
            return
        components.asked = now
        for suspect, out in list(self.without(components.index)):
            first = suspect.components[0]
            values = event.value[list(suspect.components)]
            out.same = out.same + 1 if values[0] == out.value else 0
            out.value = float(values[0])
            if not np.isfinite(values).all() or (components.inertial and out.same >= VOTE.same):
                out.agreed_from = 0
                continue
            found = self._adapter.innovation_of(components.channel, event, suspect.components)
            many = len(suspect.components)
            if not out.agreed_from or not found.nis <= (components.gate if many == 1 else components.channel.limit):
                out.agreed_from, out.count, out.squares, out.total = now, 0, 0.0, 0.0
                continue
            out.count += 1
            out.squares += found.nis / many
            out.total += float(found.whitened[first] * found.factor[first, first])
            if not self._may_return(suspect, out, now):
                continue
            components.left = sorted({c for other, _ in self.without(components.index) for c in other.components})
            bias = self._adapter.bias(components.index, first, abs(out.total) / out.count)
            if bias is not None:
                element, deviation = bias
                self.asked.append(Move(element, 0.0, deviation))

    def _may_return(self, suspect: Suspect, out: Out, now: int) -> bool:
        """True, and it is not out any more, if one who is out has agreed with the others for long enough."""
        wait = self._wait.get(suspect, VOTE.agreed)
        if now - out.agreed_from < wait or out.count < VOTE.agreements:
            return False
        if out.squares > VOTE.agrees * out.count:
            out.agreed_from = 0
            return False
        del self.out[suspect]
        self._wait[suspect] = min(2 * wait, VOTE.longest)
        return True

    # A vote

    def due(self, now: int) -> bool:
        """True if something is to be decided."""
        if self.open is not None and now - self._heard > VOTE.closed_after:
            self._close()
        return bool(self._frozen or self._jumped) or (
            self._alarm is not None
            and self._heard > self._voted
            and now - self._voted >= self._pause
            and now - self._begun >= VOTE.settled
            and self._others_there()
        )

    def decide(self, timeline: Timeline) -> None:
        """Go back to before an axis froze; or take a vote, and if somebody is wrong, go back to before it was
        believed."""
        now = timeline.stamp
        if self._frozen:
            for suspect, value in self._frozen:
                self._take_out(suspect, now, FROZEN)
                self._undo(timeline, now - VOTE.look_back, suspect, value)
            self._frozen.clear()
            return
        jumped = [suspect for suspect in dict.fromkeys(self._jumped) if suspect not in self.out]
        self._jumped.clear()
        if jumped:
            self._decide_jump(timeline, now - VOTE.redone_after_jump, jumped)
            return
        since = max(self._alarm or 0, now - VOTE.look_back)
        if now - since > VOTE.urgent:
            self._pause = min(2 * self._pause, VOTE.last_pause)
        self._voted = now
        self.votes += 1
        trial = self._trial(timeline, since)
        if not trial.possible:
            return
        found = self._hypotheses(trial, ())
        best = self._best(trial, found)
        if best is None:
            self._close()
            return
        enough = VOTE.gain_with_own if self._own(best.wrong) > VOTE.own else VOTE.gain
        if best.gain < min(VOTE.suspect, enough) or not best.explains:
            self._open(since, trial, found)
            return
        self._pause = VOTE.first_pause
        if best.gain < enough:
            self._open(since, trial, found)
            return
        self._execute(timeline, since, [best, *self._nearly_as_suspect(best, found)], CONTRADICTS)

    def _decide_jump(self, timeline: Timeline, since: int, jumped: list[Suspect]) -> None:
        """Something has jumped: who seems to have, unless another explains more."""
        trial = self._trial(timeline, since)
        own = trial.without(*jumped) if trial.possible else None
        others = [one for one in self._wholes() if one.sensor not in {suspect.sensor for suspect in jumped}]
        found = [] if own is None else [h for h in (trial.without(one) for one in others) if h is not None]
        if own is not None:
            share = VOTE.simpler if len(jumped) > 1 else 1.0  # several that jump at once have one cause
            better = [one for one in found if one.explains and one.total > share * own.total]
            if better:
                self._execute(timeline, since, [max(better, key=lambda one: one.total)], CONTRADICTS)
                return
        for suspect in jumped:
            self._take_out(suspect, since, JUMPED)
            self._undo(timeline, since, suspect)

    def _trial(self, timeline: Timeline, since: int) -> Trial:
        return Trial(timeline, since, self._adapter, self.components, self._by_hand)

    def _wholes(self) -> list[Suspect]:
        """All that is believed: whole sensors, and inputs."""
        wholes = [self._whole(components) for components in self.components.values()]
        return [one for one in (*wholes, *self._inputs.values()) if one is not None and one not in self.out]

    def _whole(self, components: Components) -> Suspect | None:
        """All of a sensor that came of late and is believed."""
        believed = tuple(c for c in components.present if c not in components.left)
        last = components.suspects[-1]
        return replace(last, components=believed) if believed else None

    def _hypotheses(self, trial: Trial, besides: tuple[Suspect, ...]) -> list[Hypothesis]:
        """That each suspect is wrong, besides some; parts of a sensor are tried if something is better without it."""
        found: list[Hypothesis | None] = []
        taken = {suspect.sensor for suspect in besides}
        for whole in self._wholes():
            if whole.input_error is not None:
                if whole.sensor not in taken:
                    found.append(trial.without(*besides, whole))
                continue
            components = self.components[whole.sensor]
            parts = [one for one in components.suspects if set(one.components) <= set(whole.components)]
            if len(parts) > 1:
                loud = components.sums.far()[SHORT, : len(components.words)].max() > VOTE.own
                all_of_it = trial.without(*besides, whole)
                if not loud and (all_of_it is None or all_of_it.gain < VOTE.worth_a_vote):
                    continue
                if not components.inertial:
                    found.append(all_of_it)
                parts = [one for one in parts if one.part_of_many]
            found += [trial.without(*besides, one) for one in parts if one not in besides]
        return [one for one in found if one is not None]

    def _best(self, trial: Trial, found: list[Hypothesis]) -> Hypothesis | None:
        """The hypothesis that most speaks for: of those that explain all the rest, the one of fewest components that is
        nearly as likely as the likeliest; if none does, one of two suspects."""
        if not found:
            return None
        likeliest = max(found, key=lambda one: one.total)
        explaining = [one for one in found if one.explains and one.gain > 0]
        if explaining:
            best = max(explaining, key=lambda one: one.total)
            if best.total >= VOTE.nearly * likeliest.total:
                near = [one for one in explaining if one.total >= VOTE.simpler * best.total]
                return min(near, key=lambda one: (_size(one), -one.total))
        if likeliest.gain > VOTE.gain:
            pairs = self._hypotheses(trial, likeliest.wrong)
            pairs = [one for one in pairs if one.explains and one.gain > likeliest.gain + VOTE.gain]
            if pairs:
                return max(pairs, key=lambda one: one.total)
        return likeliest

    def _own(self, wrong: tuple[Suspect, ...]) -> float:
        """How far the innovations of the last 0.2 s of one component that may be wrong add up [standard deviations]."""
        (first, *others) = wrong
        if others or len(first.components) != 1:
            return 0.0
        return float(self.components[first.sensor].sums.far()[SHORT, first.components[0]])

    def _nearly_as_suspect(self, best: Hypothesis, found: list[Hypothesis]) -> list[Hypothesis]:
        """Who may be the one that is wrong as well: to do without both costs little, to believe one much."""
        taken = {(suspect.sensor, c) for suspect in best.wrong for c in suspect.components or (-1,)}
        return [
            one
            for one in found
            if one.explains
            and one.gain > max(VOTE.suspect, VOTE.nearly * best.gain)
            and one.total > VOTE.simpler * best.total
            and not taken & {(suspect.sensor, c) for suspect in one.wrong for c in suspect.components or (-1,)}
        ]

    def _execute(self, timeline: Timeline, since: int, hypotheses: list[Hypothesis], why: str) -> None:
        """Take out who is wrong, and go back to before."""
        self._alarm = None
        for suspect in dict.fromkeys(suspect for one in hypotheses for suspect in one.wrong):
            self._take_out(suspect, since, why)
            self._undo(timeline, since, suspect)
        self._close()
        self._loud.clear()
        for components in self.components.values():
            components.sums.clear()

    def _open(self, since: int, trial: Trial, found: list[Hypothesis]) -> None:
        """The contradiction stays open; how far hypotheses differ is how wrong the estimate may be."""
        likely = sorted((one for one in found if one.gain > VOTE.suspect), key=lambda one: -one.total)
        mean = self._adapter.mean_in(trial.memory)
        if not likely or mean is None:
            self._close()
            return
        if self.open is not None:
            since = min(since, self.open.since)
        self.open = Contradiction(since, tuple(dict.fromkeys(s for one in likely for s in one.wrong)))
        means = [self._adapter.mean_in(one.memory) for one in likely]
        self._adapter.spread(np.max([np.square(m - mean) for m in means if m is not None], axis=0))

    def _close(self) -> None:
        """Nobody contradicts any more."""
        if self.open is not None:
            self.open = None
            self._adapter.spread(None)

    def _undo(self, timeline: Timeline, since: int, suspect: Suspect, value: float | None = None) -> None:
        """Go on from a time as if a suspect had not been there, or not with this value."""
        ahead = timeline.rewind(since)
        if suspect.input_error is not None:
            self.out[suspect].offset = self._adapter.value_of(suspect.input_error)
            self._widened = since
        places = list(suspect.components)
        for event in ahead:
            if event.sensor == suspect.sensor and (value is None or event.value[places[0]] == value):
                event.value = _without(event.value, places)
                event.whole = None if event.whole is None else _without(event.whole, places)
        if suspect.input_error is not None:
            self._widen_past(timeline, since, ahead, suspect.input_error)

    def _widen_past(self, timeline: Timeline, since: int, ahead: list[Event], element: int) -> None:
        """Put what the error of an input may have changed by where the past is done again."""
        shift, widened = len(timeline.channels) - 1, since
        added: list[Event] = []
        for event in ahead:
            if event.stamp - widened >= VOTE.widened:
                widening = Widening(element, VOTE.input_density * (event.stamp - widened) * 1e-9)
                added.append(Event(shift, event.stamp, np.array(widening), np.zeros(2), counted=True))
                widened = event.stamp
        ahead.extend(added)
        ahead.sort(key=lambda event: event.stamp)
        self._widened = widened


def _without(value: Array, places: list[int]) -> Array:
    """A reading without some of its components; without any where none are named."""
    value = value.copy()
    value[places if places else slice(None)] = np.nan
    return value


def _size(hypothesis: Hypothesis) -> int:
    """How many components are wrong; an input counts as one."""
    return sum(max(len(suspect.components), 1) for suspect in hypothesis.wrong)


def _bounded(whitened: Array) -> Array:
    """Innovations, none of which alone is a contradiction of a whole second."""
    return np.clip(whitened, -(VOTE.largest_square**0.5), VOTE.largest_square**0.5)


def _components(index: int, channel: Channel, adapter: Adapter) -> Components:
    """What of a sensor can be left out."""
    one = adapter.judged()[index]
    whole = Suspect(index, one.judged, channel.name, "")
    parts = tuple(
        Suspect(index, (k,), f"{channel.name} {one.words[k]}", one.words[k], part_of_many=True) for k in one.judged
    )
    suspects = (whole,) if one.together else (*parts, whole)
    return Components(index, channel, one.words, one.judged, one.conditions, one.gate**2, one.inertial, suspects)
