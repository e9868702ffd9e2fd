"""How fits compare on recordings that no fit has seen, and whether signals and recordings agree in what they say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import with_offsets
from vsense_ros.identification.least_squares import DivergedError, Fit, Settings, cost, fit
from vsense_ros.mismatch.comparisons import Comparisons
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import LOST, Predictor
from vsense_ros.mismatch.thresholds import THRESHOLDS, Thresholds
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

JOINT_ITERATIONS = 3  # of a fit to all recordings, which begins where the base fit is


@dataclass(frozen=True)
class ValidationGains:
    """Relative fall of the cost on held-out recordings."""

    whole: float  # of all windows
    without_each: Array  # (windows,) of all windows but each; empty where they are few

    @property
    def of_most(self) -> float:
        """Without the one window of many that speaks most against the explanation: at its limit a car goes another way
        for a small difference."""
        return max(self.whole, float(np.max(self.without_each, initial=-np.inf)))


class Validation:
    """Held-out recordings, which no fit has seen, and how explanations fare there."""

    def __init__(
        self,
        dataset: Dataset,
        vehicle: Vehicle,
        residuals: Residuals,
        base: Fit,
        progress: Callable[[], None] = lambda: None,
        thresholds: Thresholds = THRESHOLDS,
    ) -> None:
        """`dataset` is what was held out; `residuals` and `base` are those of the fit."""
        self.thresholds, self._progress = thresholds, progress
        self.base, self.fitted = base, residuals
        self._traces: dict[Hypothesis, bool] = {}  # True where an explanation changes held-out recordings
        if dataset.windows:
            dataset = dataset.without(Predictor(vehicle, dataset).lost(base.parameter_set), LOST)
        self.remarks = dataset.remarks
        self.recordings = [windows[0].name for windows in dataset.by_recording()]  # of which something can be compared
        self.residuals: Residuals | None = None
        if dataset.windows:
            self.residuals = Residuals(Predictor(vehicle, dataset))
            self.residuals.deviation |= residuals.deviation
        self.comparisons = Comparisons(residuals, self.residuals, base, thresholds.least_compared)

    def gains(self, hypothesis: Hypothesis) -> ValidationGains | None:
        """What an explanation gains on held-out recordings. None without any, and where its effects would leave no
        trace in them, which says nothing for or against it."""
        gains = self._gains(hypothesis)
        if gains is None or gains.of_most >= self.thresholds.lasting_share * hypothesis.gain:
            return gains
        promising = hypothesis.score > self.thresholds.least_gain
        return None if promising and not self.leaves_a_trace(hypothesis) else gains

    def leaves_a_trace(self, hypothesis: Hypothesis) -> bool:
        """True if held-out recordings would be others without the effects of an explanation, its base parameters as
        they are."""
        if hypothesis not in self._traces:
            assert self.residuals is not None
            at = hypothesis.fit
            sizes = [parameter.name in hypothesis.sizes for parameter in at.free_parameters]
            start = self.fitted.predictor.start
            without = with_offsets(start, at.free_parameters, np.where(sizes, 0.0, at.offsets))
            both = (self.residuals(one, self.comparisons.before) for one in (at.parameter_set, without))
            change = self.residuals.deviations([one - other for one, other in zip(*both, strict=True)])
            self._traces[hypothesis] = max(change.values(), default=0.0) > self.thresholds.unnoticed_change
        return self._traces[hypothesis]

    def _gains(self, hypothesis: Hypothesis) -> ValidationGains | None:
        """The gains of an explanation on held-out recordings, whether or not it changes them. None without any."""
        if self.residuals is None:
            return None
        before, after = self.comparisons.held_out(hypothesis.fit)
        rows = np.array([len(r) for r in after])
        share = rows / sum(len(r) for r in self.base.residuals)  # of what was fitted
        value = np.array([cost([r]) for r in before]) + share * self.base.prior_cost
        left = np.array([cost([r]) for r in after]) + share * hypothesis.fit.prior_cost
        windows = np.array([value, left, rows])
        sums = np.sum(windows, axis=1, keepdims=True)
        if np.sum(rows > 0) >= self.thresholds.many_windows:
            sums = np.hstack([sums, sums - windows])
        whole, *rest = (sums[0] - sums[1]) / np.maximum(np.maximum(sums[0], sums[2]), 1.0)
        return ValidationGains(float(whole), np.array(rest))

    def gain(self, hypothesis: Hypothesis) -> float | None:
        """What an explanation gains on all held-out windows. None without any."""
        gains = self.gains(hypothesis)
        return None if gains is None else gains.whole

    def lasting(self, hypothesis: Hypothesis) -> float:
        """What an explanation gains where it was not fitted: on all held-out windows, or without any on what is left
        out of the fit in turn."""
        unseen = self.gain(hypothesis)
        return hypothesis.cv_gain if unseen is None else unseen

    def proven(self, hypothesis: Hypothesis) -> float:
        """The smaller of what an explanation gains where it was fitted and where it was not."""
        gains = self.gains(hypothesis)
        return min(hypothesis.gain, hypothesis.cv_gain if gains is None else gains.of_most)

    def proven_beyond(self, hypothesis: Hypothesis, known: Hypothesis) -> float:
        """What an explanation is proven to gain beyond a known one, both on the same held-out windows: on all, or on
        all but the one of many that speaks most against the known one."""
        gains, others = self.gains(hypothesis), self.gains(known)
        if gains is None or others is None:
            return self.proven(hypothesis) - self.proven(known)
        compared = [(gains.whole, others.whole)]
        if others.without_each.size:
            without = int(np.argmax(others.without_each))
            compared.append((float(gains.without_each[without]), float(others.without_each[without])))
        return max(min(hypothesis.gain, one) - min(known.gain, other) for one, other in compared)

    def against(self, hypothesis: Hypothesis) -> str:
        """A remark on the window without which the gain is clearly higher, if there is one."""
        gains = self.gains(hypothesis)
        if self.residuals is None or gains is None or gains.of_most < gains.whole + self.thresholds.remarkable_gain:
            return ""
        window = self.residuals.predictor.dataset.windows[int(np.argmax(gains.without_each))]
        return (
            f"{window.name}: from {window.begin:.0f} to {window.end:.0f} s speaks most against what was found (a car "
            f"at its limit goes other ways for a small difference); without that stretch {100 * gains.of_most:.0f} % "
            "of what was held out would be explained"
        )

    def disagreement(self, hypothesis: Hypothesis, known: Hypothesis | None = None) -> float:
        """How little windows and signals agree in what an explanation changes in the base fit, or in that of a `known`
        one: what would be gained besides if each signal of each window had its own multiple of the change, over what is
        gained. What a car has is the same everywhere; what looks like it is not.

        Of many windows the one that agrees least does not count: at its limit a car goes another way for a small
        difference. That free parameters cost less, because they need no longer stand in for what is missing, counts as
        gained. Beside a known explanation signals do not count that hardly change: what they leave over is of others.
        """
        at = self.base if known is None else known.fit
        of_others = 0.0 if known is None else self.thresholds.least_telling
        changes = self._resized(at.residuals, hypothesis.fit.residuals, self.fitted.layout, of_others)
        compared = 1.0  # residuals that are compared, over those that were fitted
        if self.residuals is not None:
            before, after = self.comparisons.held_out(hypothesis.fit)
            before = before if known is None else self.comparisons.held_out(known.fit)[1]
            changes += self._resized(before, after, self.residuals.layout, of_others)
            compared += sum(map(len, after)) / sum(map(len, hypothesis.fit.residuals))
        windows = np.array(changes).reshape(-1, 2)
        whole = windows.sum(axis=0) + np.array([0.0, compared * (at.prior_cost - hypothesis.fit.prior_cost)])
        dropped = windows if len(windows) >= self.thresholds.many_windows else np.zeros((1, 2))
        besides, gained = (whole - dropped).T
        return float(np.min(besides / np.maximum(gained, 1e-12)))

    def _resized(
        self, before: Sequence[Array], after: Sequence[Array], layout: Sequence[Sequence[str]], of_others: float
    ) -> list[tuple[float, float]]:
        """Gains of each window in squared deviations: what the best multiple of a change in each of its signals would
        gain besides, and what the change gains. Windows that are not compared over the same time do not count, nor do
        signals of less than a share `of_others` of the largest squared change of a signal."""
        costs = []
        for old, new, names in zip(before, after, layout, strict=True):
            if len(old) != len(new) or not len(new):
                continue
            was, rest = (rows.reshape(len(names), -1) for rows in (old, new))
            change = rest - was
            size = np.sum(change**2, axis=1)
            known = size > max(self.thresholds.unnoticed_change**2 * change.shape[1], of_others * float(size.max()))
            besides = float(np.sum(np.sum(rest[known] * change[known], axis=1) ** 2 / size[known]))
            costs.append((besides, cost([old]) - cost([new])))
        return costs

    def something_unexplained(self) -> bool:
        """True if the base fit leaves more than a good model does, or its car gets lost on its own recordings."""
        return self.worst > self.thresholds.signal_off or bool(self.fitted.predictor.dataset.dropped)

    @cached_property
    def worst(self) -> float:
        """How far the signal of the base fit that is furthest off is from a good model, in training or held out, in
        deviations.

        Where only held-out recordings are far off, that of a fit to all, if it is better: at its limit a car goes
        another way with base parameters that are a little different, and where some fit both, no physics is missing.
        """
        here = self.fitted.worst(self.base.residuals)
        there = self.residuals.worst(self.comparisons.before) if self.residuals is not None else 0.0
        return max(here, there) if self._worst_of_both is None else min(there, self._worst_of_both)

    def worst_after(self, hypothesis: Hypothesis) -> float:
        """How far the signal that an explanation leaves furthest off is from a good model, in training or held out, in
        deviations."""
        here = self.fitted.worst(self.comparisons.training(hypothesis.fit)[1])
        if self.residuals is None:
            return here
        return max(here, self.residuals.worst(self.comparisons.held_out(hypothesis.fit)[1]))

    @property
    def fits_together(self) -> bool:
        """True if held-out recordings are far off for the base fit, but not for base parameters fitted to all."""
        return self._worst_of_both is not None and self._worst_of_both <= self.thresholds.signal_off

    @cached_property
    def _worst_of_both(self) -> float | None:
        """`worst` of base parameters fitted to all recordings; None unless only held-out recordings are off."""
        off = self.thresholds.signal_off
        if self.residuals is None or not (
            self.residuals.worst(self.comparisons.before) > off >= self.fitted.worst(self.base.residuals)
        ):
            return None
        dataset = self.fitted.predictor.dataset
        whole = dataset.joined(self.residuals.predictor.dataset)
        residuals = Residuals(Predictor(self.fitted.predictor.vehicle, whole))
        residuals.deviation |= self.fitted.deviation
        start = self.fitted.predictor.start
        try:
            refitted = fit(
                residuals,
                start,
                self.base.free_parameters,
                begin=self.base.offsets,
                settings=Settings(iterations=JOINT_ITERATIONS),
                progress=self._progress,
            ).residuals
        except DivergedError:
            return np.inf
        count = len(dataset.windows)
        return max(self.fitted.worst(refitted[:count]), self.residuals.worst(refitted[count:]))

    def unmended(self, hypothesis: Hypothesis) -> str:
        """The signal that is furthest from a good model, where an explanation neither brings it near one nor at least
        much closer; in training or held out, wherever it is further off. Empty where every signal is near: there the
        effect gains by what base parameters need no longer stand in for."""
        off_from = self.thresholds.signal_off
        if self.worst <= off_from:
            return ""
        residuals = self.fitted
        before, after = self.comparisons.training(hypothesis.fit)
        if self.residuals is not None:
            unseen = self.comparisons.held_out(hypothesis.fit)
            if self.residuals.worst(unseen[0]) > residuals.worst(before):
                residuals, (before, after) = self.residuals, unseen
        worst, off = residuals.furthest(before)
        left = residuals.deviations(after)[worst] / residuals.deviations(before)[worst]
        return "" if left < max(min(1.0, off_from / off), self.thresholds.mended) else worst

    def nearer(self, one: Hypothesis, other: Hypothesis) -> list[tuple[float, float]]:
        """How much less of each signal's squared error one explanation leaves than another, as a share of what that
        leaves or a good model would, summed over the signals in which it leaves less; and the same the other way round.
        In training and held out; empty where the two cannot be compared over the same time."""
        compared = self.comparisons
        parts = [(self.fitted, compared.training(one.fit)[1], compared.training(other.fit)[1])]
        if self.residuals is not None:
            parts.append((self.residuals, compared.held_out(one.fit)[1], compared.held_out(other.fit)[1]))
        distances = []
        for residuals, mine, its in parts:
            if not all(map(_alike, mine, its)):
                return []
            left, there, good = residuals.deviations(mine), residuals.deviations(its), residuals.good(its)
            less, more = (
                sum(max(0.0, b[name] ** 2 - a[name] ** 2) / max(b[name], good[name]) ** 2 for name in good)
                for a, b in ((left, there), (there, left))
            )
            distances.append((less, more))
        return distances

    def own_unmended(self, hypothesis: Hypothesis, known: Hypothesis | None) -> str:
        """The signal that an explanation changes most against a `known` one, or the base fit, if it comes neither near
        that of a good model nor much closer to it, in training or held out; empty where it does."""
        compared = self.comparisons
        known_training = None if known is None else compared.training(known.fit)
        parts = [(self.fitted, compared.training(hypothesis.fit), known_training)]
        if self.residuals is not None:
            known_unseen = None if known is None else compared.held_out(known.fit)
            parts.append((self.residuals, compared.held_out(hypothesis.fit), known_unseen))
        for residuals, (before, after), of_known in parts:
            if of_known is not None and all(map(_alike, of_known[1], after)):
                before = of_known[1]
            changed = residuals.deviations(
                [b - a if len(a) == len(b) else np.zeros(0) for a, b in zip(after, before, strict=True)]
            )
            if not changed:
                continue
            most = max(changed, key=changed.__getitem__)
            good, was = residuals.good(before)[most], residuals.deviations(before)[most]
            left = residuals.deviations(after)[most]
            near = self.thresholds.signal_off * good
            if left >= max(near, self.thresholds.mended * was):
                return most
        return ""


def _alike(one: Array, other: Array) -> bool:
    return len(one) == len(other)
