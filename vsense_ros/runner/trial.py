"""A trial: the recent past is filtered again without each suspect, and all other sensors judge it.

A suspect is wrong if everything else is predicted better without it. Of two hypotheses about one past the likelihood of
all its measurements decides (Schweppe 1965); a measurement that is left out counts as if it were explained. So

    Δ_i = Σ_{k∉i} (w_k² + 2 ln d_k)  with i  -  Σ_{k∉i} (w_k² + 2 ln d_k)  without i  +  Σ_{k∈i} (w_k² - 1)  with i

for each hypothesis i, with w the whitened innovation and d its standard deviation; of the last sum, what is positive of
each component. The first two sums, the *gain*, are
evidence of the others against i; a right sensor helps to predict them, so that its gain is negative. With the last sum
hypotheses can be held against each other: the sensor that is nearest to a faulty one gains by its absence as well, but
it leaves the faulty one unexplained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.runner.adapter import Adapter, Widening
from vsense_ros.runner.components import Components
from vsense_ros.runner.suspects import Suspect
from vsense_ros.runner.vote_settings import VOTE

Array = NDArray[np.float64]


class Hypothesis(NamedTuple):
    """That some suspects are wrong: the `gain` of all others without them, `total` as Δ above, `disagreement`, the
    largest mean of the squares of the whitened innovations of a sensor that is believed, and the filter's memory at the
    end."""

    wrong: tuple[Suspect, ...]
    gain: float
    total: float
    disagreement: float
    memory: Array

    @property
    def explains(self) -> bool:
        """True if all that is believed agrees."""
        return self.disagreement <= VOTE.disagree


class Trial:
    """What has happened on a timeline since a time [ns], filtered again; `components` are those of each sensor that can
    be left out. `by_hand` lets an event act on the filter that is no measurement."""

    def __init__(
        self,
        timeline: Timeline,
        since: int,
        adapter: Adapter,
        components: Mapping[int, Components],
        by_hand: Callable[[Event], None],
    ) -> None:
        self._timeline, self.since, self._adapter = timeline, since, adapter
        self._components, self._by_hand = components, by_hand
        self._with_all = self._filtered(())

    @property
    def possible(self) -> bool:
        """False if the filter could not go all the way."""
        return self._with_all is not None

    @property
    def memory(self) -> Array:
        """The filter's memory at the end, with all."""
        assert self._with_all is not None
        return self._with_all[1]

    def without(self, *wrong: Suspect) -> Hypothesis | None:
        """What speaks for the hypothesis that these are wrong; None if the filter could not go all the way."""
        filtered = self._filtered(wrong)
        if filtered is None or self._with_all is None:
            return None
        (before, _), (after, memory) = self._with_all, filtered
        gain, own, disagreement = 0.0, 0.0, 0.0
        for sensor, score in before.items():
            left = [component for suspect in wrong if suspect.sensor == sensor for component in suspect.components]
            own += float(np.maximum(score[1, left] - score[2, left], 0.0).sum())
            pair = np.delete(np.array([score, after[sensor]]), left, axis=2)
            gain += float((pair[0, 0] - pair[1, 0]).sum())
            _, squares, count = pair[1].sum(axis=1).tolist()
            disagreement = max(disagreement, squares / max(count, 1.0))
        return Hypothesis(wrong, gain, gain + own, disagreement, memory)

    def _filtered(self, wrong: tuple[Suspect, ...]) -> tuple[dict[int, Array], Array] | None:
        """Scores of each sensor (3, m): Σ (w² + 2 ln d), Σ w² and number of each component, as if some suspects had not
        been there; and the filter's memory at the end."""
        scores: dict[int, Array] = {}
        adapter, channels = self._adapter, self._timeline.channels
        left = {suspect.sensor: list(suspect.components) for suspect in wrong if suspect.components}
        for suspect in wrong:
            left[suspect.sensor] = sorted({*left.get(suspect.sensor, ()), *suspect.components})
        errors = [suspect.input_error for suspect in wrong if suspect.input_error is not None]
        widened = self.since

        def act(event: Event) -> None:
            nonlocal widened
            if errors and event.stamp - widened >= VOTE.widened:
                for element in errors:
                    adapter.widen(Widening(element, VOTE.input_density * (event.stamp - widened) * 1e-9))
                widened = event.stamp
            channel = channels[event.sensor]
            if channel.by_hand:
                self._by_hand(event)
            elif channel.first_input is None:
                self._measure(scores, event, left.get(event.sensor))
            elif event.sensor not in left:
                adapter.give(channel, event)

        memory = self._timeline.again(self.since, act)
        return None if memory is None else (scores, memory)

    def _measure(self, scores: dict[int, Array], event: Event, left: list[int] | None) -> None:
        adapter, channel = self._adapter, self._timeline.channels[event.sensor]
        if left or event.whole is not None:
            event = replace(event, value=(event.value if event.whole is None else event.whole).copy())
            event.value[left or []] = np.nan
        components = self._components.get(event.sensor)
        if components is None or not components.inertial:
            _score(scores, event.sensor, adapter.correct(channel, event))
            return
        found = adapter.correct_inertial(channel, event, components.gate)
        if not found.nis > components.gate:
            _score(scores, event.sensor, found)
            return
        for _, alone in adapter.correct_by_axis(channel, event, components.gate):
            _score(scores, event.sensor, alone)


def _score(scores: dict[int, Array], sensor: int, found: Innovation) -> None:
    score = scores.setdefault(sensor, np.zeros((3, len(found.whitened))))
    if found.nis < 0:
        return
    whitened, deviation = found.whitened, found.factor.diagonal()
    there = whitened == whitened
    squares = np.minimum(whitened[there] ** 2, VOTE.largest_square)
    score[0, there] += squares + 2 * np.log(np.maximum(deviation[there], 1e-9))
    score[1, there] += squares
    score[2, there] += 1.0
