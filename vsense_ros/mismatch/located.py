"""Where a fit is off: in which signals and stretches, how that depends on the motion, and what describes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.least_squares import Fit, cost
from vsense_ros.mismatch.answer_schema import (
    ActingPart,
    EffectEntry,
    Force,
    Located,
    Region,
    Remainder,
    Segment,
    SignalMisfit,
    Span,
    TermSize,
)
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged
from vsense_ros.model.effects import EVERY
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]


def located(
    residuals: Residuals, base: Fit, judged: Judged, validation: Validation, effects: Sequence[EffectEntry]
) -> Located:
    """Where the base fit is off."""
    windows = residuals.predictor.dataset.windows
    whole = max(cost(base.residuals), 1e-12)
    segments = [
        Segment(recording=w.name, begin=w.begin, end=w.end, share=float(r @ r) / whole)
        for w, r in zip(windows, base.residuals, strict=True)
    ]
    lost = residuals.predictor.dataset.dropped
    where = _most_off(residuals, base, validation)
    return Located(
        signals=_signals_off(residuals, base, *where[:2]),
        segments=tuple(sorted(segments, key=lambda segment: segment.share, reverse=True)),
        lost=tuple(Span(recording=w.name, begin=w.begin, end=w.end) for w in lost),
        region=_region(*where),
        force=_force(judged, validation),
        parts=_acting_parts(effects),
    )


def _acting_parts(effects: Sequence[EffectEntry]) -> tuple[ActingPart, ...]:
    """On what of the car, its road or its sensors the effects of the answer act, where on it and in which form."""
    return tuple(
        ActingPart(
            effect=effect.id,
            acts_on=EVERY[effect.id].acts_on(),
            wheel=effect.wheel,
            axle=effect.axle,
            sensor=effect.sensor,
            axis=effect.axis,
            form=effect.form,
        )
        for effect in effects
        if effect.answer_set
    )


def _signals_off(residuals: Residuals, base: Fit, there: Residuals, off: list[Array]) -> tuple[SignalMisfit, ...]:
    """Errors of the base fit by signal, and what a good model leaves; the worst first by what is `off` there."""
    by_signal, ranking = residuals.by_signal(base.residuals), there.by_signal(off)
    units = {name: signal.unit for name, signal in compared_signals().items()}
    good = {name: times * residuals.deviation[name] for name, times in residuals.good(base.residuals).items()}
    worst_first = sorted(by_signal, key=lambda name: ranking.get(name, 0.0) / good[name], reverse=True)
    return tuple(
        SignalMisfit(name=name, unit=units[name], before=by_signal[name], null=good[name]) for name in worst_first
    )


def _force(judged: Judged, validation: Validation) -> Force | None:
    """The force, torque, angle or reading that describes the residuals, where that was asked and is proven."""
    if judged.verdict != "unknown" or judged.leader is None:
        return None
    return term_in_words(judged.leader, validation)


def remainder(
    residuals: Residuals, shown: Fit, judged: Judged, term: Hypothesis | None, validation: Validation
) -> Remainder | None:
    """What is left over besides what is named, which a `term` beside it may describe, or besides the first of several
    explanations; None where that is all."""
    if judged.verdict != "ambiguous" and not (judged.partial and judged.verdict == "named"):
        return None
    off = shown.residuals
    good, errors = residuals.good(off), residuals.deviations(off)
    units = {name: signal.unit for name, signal in compared_signals().items()}
    far = sorted(
        (name for name in errors if errors[name] > validation.thresholds.signal_off * good[name]),
        key=lambda name: errors[name] / good[name],
        reverse=True,
    )
    if judged.verdict == "ambiguous" and not far:
        return None
    by_signal = residuals.by_signal(off)
    return Remainder(
        level=residuals.level(off),
        signals=tuple(
            SignalMisfit(
                name=name, unit=units[name], before=by_signal[name], null=good[name] * residuals.deviation[name]
            )
            for name in far
        ),
        region=_region(residuals, off, ""),
        force=None if term is None else term_in_words(term, validation),
    )


def term_in_words(hypothesis: Hypothesis, validation: Validation) -> Force:
    """The term without known physics that is the last part of an explanation."""
    term = hypothesis.candidates[-1]
    sizes = tuple(
        TermSize(name=parameter.name.rsplit(".", 1)[-1], unit=parameter.unit, value=hypothesis.sizes[parameter.name])
        for parameter in term.free_parameters
    )
    return Force(
        description=physics_in_words(hypothesis, term), sizes=sizes, lever_arm=lever_arm(hypothesis),
        gain_training=hypothesis.gain, gain_left_out=hypothesis.cv_share, gain_held_out=validation.gain(hypothesis),
    )  # fmt: skip


def _most_off(residuals: Residuals, base: Fit, validation: Validation) -> tuple[Residuals, list[Array], str]:
    """The residuals of the base fit in training; or held out, with words that say so, where only those are far from
    those of a good model."""
    unseen, off_from = validation.residuals, validation.thresholds.signal_off
    if unseen is not None and residuals.worst(base.residuals) < off_from < unseen.worst(validation.comparisons.before):
        return unseen, validation.comparisons.before, " on what was held out"
    return residuals, base.residuals, ""


def _region(residuals: Residuals, off: list[Array], of: str) -> Region | None:
    """With which measured signal the residual of the worst signal grows or falls most."""
    signal, _ = residuals.furthest(off)
    size: list[Array] = []
    features: dict[str, list[Array]] = {"speed": [], "lateral_acceleration": [], "longitudinal_acceleration": []}
    for measured, rows, names in zip(residuals.predictor.measured, off, residuals.layout, strict=True):
        if signal in names and all(f in measured for f in features):
            size.append(np.abs(np.split(rows, len(names))[names.index(signal)]))
            for feature, parts in features.items():
                parts.append(np.abs(measured[feature]))
    if not size:
        return None
    large = np.concatenate(size)
    correlations = {}
    for feature, parts in features.items():
        value = np.concatenate(parts)
        if value.std() > 0 and large.std() > 0:
            correlations[feature] = float(np.corrcoef(value, large)[0, 1])
    if not correlations:
        return None
    strongest = max(correlations, key=lambda f: abs(correlations[f]))
    way = "grows" if correlations[strongest] > 0 else "falls"
    word = strongest.replace("_", " ")
    text = f"the error of the {signal.replace('_', ' ')}{of} {way} with the {word}"
    if abs(correlations[strongest]) < 0.3:
        text = f"the error of the {signal.replace('_', ' ')}{of} is about the same everywhere"
    return Region(description=text, correlation=correlations)


def physics_in_words(hypothesis: Hypothesis, candidate: Candidate) -> str:
    """The physics of a candidate; of a force with a moment that is proportional to the same, also where it acts."""
    arm = lever_arm(hypothesis)
    if arm is None:
        return candidate.sentence
    return f"{candidate.sentence}, {abs(arm):.1f} m {'ahead of' if arm > 0 else 'behind'} the centre of gravity"


def lever_arm(hypothesis: Hypothesis) -> float | None:
    """How far ahead of the centre of gravity a lateral force acts that has a moment [m]."""
    sizes = {name.rsplit(".", 1)[-1]: size for name, size in hypothesis.sizes.items()}
    for name, force in sizes.items():
        moment = name.replace("lateral_force", "yaw_moment")
        if moment != name and moment in sizes and force:
            return sizes[moment] / force
    return None
