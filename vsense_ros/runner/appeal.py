"""Appeals: an axis that is out was right if all others are predicted better with it.

What an axis is compared with at first is the filter alone, which may be wrong: it expects that drivers go on braking as
they do, and that tyres are those of the vehicle file. Others need tenths of a second to show who was right. What they
have measured since is then filtered again, with the axis believed however far it is from what was expected, and without
it. It is believed again if other sensors are predicted better with it; or after a while, longer each time, if nobody is
predicted much worse and the filter that believes it comes to expect it: without it the filter may have gone astray, so
that a right axis does not agree. What it was accused of is from then on what its sums usually are (`sums`): the same is
not decided twice. But no acquittal lets them be larger than those of a model that is off by a fair share: an axis that
is wrong after all must still be found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.runner.axes import FROZEN, Axes, Out
from vsense_ros.runner.recount import Belief, Recount
from vsense_ros.runner.vote_settings import VOTE


class Appeals:
    """The appeals of all axes that are out, by the places of their sensors; `returned` are those whose biases may have
    changed meanwhile, with how far that may be."""

    def __init__(
        self, axes: Mapping[int, Axes], returned: list[tuple[int, int, float]], report: Callable[[int, str], None]
    ) -> None:
        self._axes, self.returned, self._report = axes, returned, report

    def _waiting(self, now: int) -> Iterator[tuple[Axes, int, Out]]:
        """Axes that may appeal at a time [ns]: soon after they were left out, and then less and less often. Where most
        of a sensor is out, nothing of it may."""
        for axes in self._axes.values():
            if len(axes.out) > VOTE.appealing:
                continue
            for axis, out in axes.out.items():
                since, last = now - out.decided, max(out.heard - out.decided, 0)
                if out.why != FROZEN and since >= max(VOTE.first_pause + last, VOTE.appeals_again * last):
                    yield axes, axis, out

    def due(self, now: int) -> bool:
        """True if an axis may appeal at a time [ns]. It is asked with every message, most often of none that is out."""
        for axes in self._axes.values():
            if axes.out:
                return any(True for _ in self._waiting(now))
        return False

    def hear(self, timeline: Timeline, recount: Callable[[Timeline, int], Recount]) -> None:
        """Believe axes again without which the others are predicted worse; `recount` counts since a time [ns]."""
        now = timeline.stamp
        for axes, axis, out in list(self._waiting(now)):
            out.heard = now
            since = max(out.since, now - VOTE.appealed)
            if self._is_granted(axes, axis, now - out.decided, recount(timeline, since).believing(axes, axis)):
                self._believe(axes, axis, now, timeline.rewind(since))

    def _is_granted(self, axes: Axes, axis: int, time: int, belief: Belief) -> bool:
        """True if an axis that has been out for a time [ns] is to be believed, by what follows from that."""
        if belief.gain > VOTE.gain_with_own:
            return True
        wait = axes.wait.get(axis, VOTE.agreed)
        if (
            time < max(wait // 2, VOTE.agreed)
            or belief.gain < -VOTE.gain_with_own
            or belief.own > VOTE.agrees * axes.sums.usual.item(0, axis)
        ):
            return False
        axes.wait[axis] = min(2 * wait, VOTE.longest)
        self.returned.append((axes.index, axis, 0.0))
        return True

    def _believe(self, axes: Axes, axis: int, now: int, ahead: Iterable[Event]) -> None:
        """Believe an axis again at a time [ns], in what will happen once more as well."""
        usual, far = axes.sums.usual[:, axis], axes.out[axis].far
        axes.believe(axis, now)
        acquitted = np.minimum(usual * (far / VOTE.usual_once_acquitted) ** 2, VOTE.usual_at_most**2)
        np.maximum(usual, acquitted, out=usual)
        self._report(axes.index, "")
        for event in ahead:
            if event.sensor == axes.index and event.whole is not None:
                event.value = event.value.copy()
                event.value[axis] = event.whole[axis]
