"""From candidates that promise much to hypotheses: fits of their sizes together with all other free parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from vsense_ros.identification.least_squares import Fit, fit, fit_each
from vsense_ros.mismatch.candidates import Candidate, shapes
from vsense_ros.mismatch.cross_validation import CrossValidation
from vsense_ros.mismatch.hypothesis import Hypothesis, Signature
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.secants import Secants
from vsense_ros.mismatch.stored_slopes import stored


class Fitting:
    """Fits hypotheses beside a base fit, and fits them further. `whole` is what gains are relative to."""

    def __init__(
        self, secants: Secants, validation: CrossValidation, whole: float, progress: Callable[[], None] = lambda: None
    ) -> None:
        self.secants, self.validation, self.whole, self._progress = secants, validation, whole, progress
        self.residuals, self.start, self.base = secants.residuals, secants.start, secants.base

    def fitted(self, signatures: Sequence[Signature]) -> list[Hypothesis]:
        """The hypotheses that these signatures become when all their parameters are fitted, best first."""
        fits = self._fit_each(s.joint() for s in signatures)
        fitted = [self.hypothesis(s.candidates, f, s.independent_share) for s, f in zip(signatures, fits, strict=True)]
        return sorted(fitted, key=lambda e: e.score, reverse=True)

    def hypothesis(self, candidates: tuple[Candidate, ...], fitted: Fit, independent_share: float) -> Hypothesis:
        """What a fit with these candidates explains beyond the base fit, by itself and in cross-validation."""
        falls = self.base.equations.values() - fitted.equations.values()
        gained, lost = np.sum(falls[falls > 0]), -np.sum(falls[falls < 0])
        folds = self.validation.folds_for(candidates)
        cv_gains = folds.gains(folds.apart(fitted).equations, self.whole)
        kept = replace(fitted, slopes=stored(fitted.slopes))
        return Hypothesis(
            candidates, kept, independent_share, (self.base.value - fitted.value) / self.whole, *cv_gains,
            float(lost / max(gained, 1e-12)), self._deviations(candidates, fitted),
        )  # fmt: skip

    def _deviations(self, candidates: Sequence[Candidate], fitted: Fit) -> dict[str, float]:
        """Standard deviations of the free parameters by name, by a jackknife over the folds: residuals of neighbouring
        instants err together, so that their number says nothing. All folds agree on what the prior says: it draws a
        size towards zero by the prior's share in what is known of it, and that much of a likely size may be missing.
        The level of a profile is known no better than all that shifts with it: sensors with an offset see the same, and
        the prior alone tells the two apart."""
        equations = self.validation.folds_for(candidates).apart(fitted).equations
        n = len(equations.rows)
        changes = np.array([equations.change([i for i in range(n) if i != out]) for out in range(n)])
        spread = np.sqrt((n - 1) / n * np.sum((changes - changes.mean(axis=0)) ** 2, axis=0))
        everywhere = {c.free_parameters[0].name for c in candidates if c.along_road}
        sizes = {parameter.name for c in candidates if not c.along_road for parameter in c.free_parameters}
        level, size = (np.array([p.name in names for p in fitted.free_parameters]) for names in (everywhere, sizes))
        after = equations.spread()  # the prior's share is its square
        spread = np.hypot(spread, np.where(level, after, np.where(size, after**2, 0.0)))
        return {
            parameter.name: float(s * parameter.deviation)
            for parameter, s in zip(fitted.free_parameters, spread, strict=True)
        }

    def refined(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis fitted further with secants of its own. With those of the base fit, whose parameters may be
        far off because they stand in for the effect, it stops short."""
        return self.refined_each([hypothesis])[0]

    def refined_each(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Each hypothesis as `refined` returns it; their simulations run side by side."""

        def few(hypothesis: Hypothesis) -> bool:
            return sum(parameter.place is not None for parameter in hypothesis.fit.free_parameters) <= EFFORT.few_places

        chosen = [e for e in hypotheses if few(e) and e.gain > EFFORT.refined_gain]
        better = self._fitted_further(
            chosen, (replace(e.fit, slopes=self.secants.all_slopes_at(e.fit)) for e in chosen)
        )
        return [self._on_the_road(better.get(e, e)) if few(e) else e for e in hypotheses]

    def refined_by_last(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The hypotheses fitted further with secants of their last effect alone: those of the others and of the base
        parameters are of the hypothesis that it was added to, which is near."""

        def joined(hypothesis: Hypothesis) -> Fit:
            at, new = hypothesis.fit, hypothesis.candidates[-1].free_parameters
            return at.joined(new, self.secants.slopes_at(at, new))

        chosen = [e for e in hypotheses if e.gain > EFFORT.refined_gain and not e.candidates[-1].along_road]
        better = self._fitted_further(chosen, map(joined, chosen))
        return [self._on_the_road(better.get(e, e)) if e in chosen else e for e in hypotheses]

    def _fitted_further(self, hypotheses: Sequence[Hypothesis], joints: Iterable[Fit]) -> dict[Hypothesis, Hypothesis]:
        """Those that get better if they go on from these fits, as they are then."""
        fits = zip(hypotheses, self._fit_each(joints), strict=True)
        return {e: self.hypothesis(e.candidates, f, e.independent_share) for e, f in fits if f.value < e.fit.value}

    def _on_the_road(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis, fitted anew from the parameters of the vehicle file if its car gets lost. There the residuals
        are those of the base fit, so that base parameters would stay where they stand in for the effect."""
        at = hypothesis.fit
        lost = sum(self.residuals.predictor.lost(at.parameter_set))
        if not lost:
            return hypothesis
        begin = np.array([hypothesis.sizes.get(parameter.name, 0.0) for parameter in at.free_parameters])
        refitted = fit(
            self.residuals, self.start, at.free_parameters, begin=begin, instead=self.base.residuals,
            progress=self._progress,
        )  # fmt: skip
        if sum(self.residuals.predictor.lost(refitted.parameter_set)) >= lost:
            return hypothesis
        return self.hypothesis(hypothesis.candidates, replace(refitted, weight=at.weight), hypothesis.independent_share)

    def unshrunk(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with its sizes fitted once more with a wider prior, which hardly shrinks them: the narrow one
        has separated the likely effects from the unlikely. Its gain is counted with the same prior as that of all
        others."""
        at, sizes = hypothesis.fit, hypothesis.sizes
        times = np.array(
            [max(1.0, EFFORT.unshrunk_ratio * abs(sizes.get(p.name, 0.0)) / p.deviation) for p in at.free_parameters]
        )
        free_parameters = tuple(
            replace(parameter, deviation=parameter.deviation * factor)
            for parameter, factor in zip(at.free_parameters, times, strict=True)
        )
        fitted = self.fit(
            replace(at, free_parameters=free_parameters, slopes=[s * np.float32(times) for s in at.slopes])
        )
        with_narrow_prior = replace(fitted, free_parameters=at.free_parameters, slopes=at.slopes)
        return replace(
            self.hypothesis(hypothesis.candidates, with_narrow_prior, hypothesis.independent_share),
            deviations=self._deviations(hypothesis.candidates, fitted),
            evident=hypothesis.evident,
        )

    def shaped(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The hypotheses, the best of them with the shapes of their effects fitted, too."""
        with_shapes = [*map(self.with_shape, hypotheses[: EFFORT.beam]), *hypotheses[EFFORT.beam :]]
        return sorted(with_shapes, key=lambda e: e.score, reverse=True)

    def with_shape(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with the shapes of its last effect fitted, too, if that has some and they can be seen."""
        at, free_parameters = hypothesis.fit, shapes(hypothesis.candidates[-1], self.start.values)
        if not free_parameters or hypothesis.gain < EFFORT.shaped_gain:
            return hypothesis
        fitted = self.fit(at.joined(free_parameters, self.secants.slopes_at(at, free_parameters)))
        return self.hypothesis(hypothesis.candidates, fitted, hypothesis.independent_share)

    def fit(self, joint: Fit) -> Fit:
        """The fit that further steps from this one lead to."""
        (fitted,) = self._fit_each([joint])
        return fitted

    def _fit_each(self, joints: Iterable[Fit]) -> list[Fit]:
        """Each fit carried further; their simulations run side by side."""
        fitted = fit_each(self.residuals, self.start, joints, self.base.residuals)
        self._progress()
        return fitted
