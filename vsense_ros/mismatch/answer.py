"""The entries of explain.json: effects with their sizes and gains, base parameters, errors and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter
from vsense_ros.identification.least_squares import DivergedError, Fit, cost
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch import onset as onsets
from vsense_ros.mismatch.answer_schema import (
    BaseParameter,
    EffectEntry,
    Errors,
    Likely,
    LikelySize,
    Onset,
    ProfilePoint,
    SignalErrors,
    Size,
)
from vsense_ros.mismatch.beforehand import Beforehand
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.confidence import interval
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.located import physics_in_words
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.residuals import RESIDUALS, Residuals
from vsense_ros.mismatch.road import ROAD_SETTINGS
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import AXLES
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]


LEAST_NARROWED = 0.3  # [-] share of a standard deviation that a fit of dependent residuals leaves, at least
CONFIDENCE_BEFOREHAND = 0.99  # [-] in a defect of a sensor that all others of one motion agree with, before any fit


def rivals(judged: Judged, known: Sequence[Beforehand]) -> tuple[tuple[str, ...], ...]:
    """Ids of the effects of each explanation that remains; those `known` before any fit are part of each."""
    sure = tuple(dict.fromkeys(one.effect for one in known))
    explanations = [
        (*hypothesis.effects, *(id for id in sure if id not in hypothesis.effects)) for hypothesis in judged.rivals
    ]
    if not explanations and judged.verdict in ("no_mismatch", "named") and sure:
        explanations = [sure]
    return tuple(dict.fromkeys(explanations))


def answer_set(judged: Judged, known: Sequence[Beforehand] = ()) -> list[str]:
    """Ids of the effects in the answer."""
    return list(dict.fromkeys(id for ids in rivals(judged, known) for id in ids))


def with_known(
    effects: Sequence[EffectEntry], known: Sequence[Beforehand], shown: Fit, residuals: Residuals,
    validation: Validation,
) -> tuple[EffectEntry, ...]:  # fmt: skip
    """The effects with the defects of sensors that were `known` before any fit: of a size larger by so much where the
    fit has found more. What they gain is what is lost without."""
    entries = list(effects)
    for one in known:
        at = next((i for i, entry in enumerate(entries) if entry.accepted and _has_size(entry, one)), None)
        if at is not None:
            entries[at] = entries[at].with_(parameters=tuple(_larger(size, one) for size in entries[at].parameters))
        else:
            fitted = sum(entry.accepted for entry in entries)
            entries.insert(fitted, _known_entry(one, shown, residuals, validation))
    return tuple(entries)


def _has_size(entry: EffectEntry, known: Beforehand) -> bool:
    return entry.id == known.effect and any(size.name == known.field for size in entry.parameters)


def _larger(size: Size, known: Beforehand) -> Size:
    """A size with what was known of it before the fit."""
    if size.name != known.field:
        return size
    low, high = size.interval_90
    return size.with_(value=size.value + known.value, interval_90=(low + known.value, high + known.value))


def _known_entry(known: Beforehand, shown: Fit, residuals: Residuals, validation: Validation) -> EffectEntry:
    """The entry of a defect that was known before the fit, of the size that this has made of it."""
    effect = EVERY[known.effect]
    value, deviation = _refitted(known, shown)
    name = known.parameter
    without = shown.parameter_set.changed({name: shown.parameter_set.values[name] - value})
    trained = _lost(residuals, shown.residuals, without)
    unseen = None
    if validation.residuals is not None:
        unseen = _lost(validation.residuals, validation.comparisons.held_out(shown)[1], without)
    extra = effect.model_fields[known.field].json_schema_extra
    assert isinstance(extra, dict)
    around = interval(value, deviation, residuals.level(shown.residuals))
    return EffectEntry(
        id=known.effect, sentence=effect.sentence, sensor=known.field if effect.delays else None,
        parameters=(Size(name=known.field, unit=str(extra["unit"]), value=value, interval_90=around),),
        gain_training=trained, gain_left_out=trained, gain_held_out=unseen, adds_to_best=None, keep=1.0,
        confidence=CONFIDENCE_BEFOREHAND, objection="", accepted=True, answer_set=(known.effect,), would_separate=None,
    )  # fmt: skip


def _refitted(known: Beforehand, shown: Fit) -> tuple[float, float]:
    """The size of a defect that was known before a fit, and its standard deviation, after the fit."""
    names = [parameter.name for parameter in shown.free_parameters]
    if known.parameter not in names:
        return known.value, known.deviation
    at = names.index(known.parameter)
    share = float(shown.equations.spread()[at])
    return known.value + float(shown.offsets[at]), max(share, LEAST_NARROWED) * known.deviation


def _lost(residuals: Residuals, after: Sequence[Array], without: ParameterSet) -> float:
    """By how much the squared error falls, relative, from that of other parameters."""
    try:
        before = cost(residuals(without, [np.full(len(r), RESIDUALS.outlier / 2) for r in after]))
    except DivergedError:
        return 1.0
    return float(1 - cost(after) / max(before, 1e-12))


def evidence(search: Search) -> tuple[Likely, ...]:
    """What the evidence says of each effect."""
    if (known := search.evidence) is None:
        return ()
    sets, chosen = known
    posterior, probabilities = sets.of(chosen), sets.probabilities()
    sizes: dict[str, list[LikelySize]] = {}
    for i, size in enumerate(sets.sizes):
        if not size.along and not size.plane:
            likely = LikelySize(
                name=size.name.rsplit(".", 1)[-1],
                likeliest=float(posterior.unknowns[size.unknown]),
                deviation=float(np.sqrt(posterior.covariance[size.unknown, size.unknown])),
                prior=1.0 if i in chosen else size.little,
            )
            sizes.setdefault(size.effect, []).append(likely)
    return tuple(
        Likely(effect=id, probability=probabilities.get(id, 0.0), adds=search.adds.get(id), sizes=tuple(of))
        for id, of in sizes.items()
    )


def effect_entries(judged: Judged, dataset: Dataset, validation: Validation) -> list[EffectEntry]:
    """All effects that were fitted, those of the leader first."""
    entries: dict[str, EffectEntry] = {}
    for hypothesis in (*filter(None, [judged.leader]), *judged.rivals, *(one.hypothesis for one in judged.ranked)):
        for candidate in hypothesis.candidates:
            if candidate.effect not in entries:
                entries[candidate.effect] = _entry(judged, hypothesis, candidate, dataset, validation)
    return list(entries.values())


def _entry(
    judged: Judged, hypothesis: Hypothesis, candidate: Candidate, dataset: Dataset, validation: Validation
) -> EffectEntry:
    ids = answer_set(judged)
    rest = judged.without(hypothesis, candidate.effect)
    return EffectEntry(
        id=candidate.effect,
        sentence=physics_in_words(hypothesis, candidate),
        **_place_of(candidate),
        profile=_profile(hypothesis, candidate, dataset) or None,
        parameters=tuple(
            Size(
                name=parameter.name.rsplit(".", 1)[-1],
                unit=parameter.unit,
                value=hypothesis.sizes[parameter.name],
                interval_90=_interval(hypothesis, parameter),
            )
            for parameter in candidate.free_parameters
            if not parameter.place
        ),
        gain_training=hypothesis.gain,
        gain_left_out=hypothesis.cv_share,
        gain_held_out=validation.gain(hypothesis),
        adds_to_best=judged.adds(hypothesis),
        gain_without=None if rest is None else validation.lasting(rest),
        keep=_independent_share(hypothesis, candidate),
        confidence=judged.confidence(hypothesis, candidate.effect),
        objection=judged.objection_to(hypothesis),
        accepted=hypothesis is judged.leader and candidate.effect in judged.sure,
        answer_set=tuple(ids) if candidate.effect in ids else (),
        would_separate=None,
    )


def _independent_share(hypothesis: Hypothesis, candidate: Candidate) -> float:
    """The share of what an effect changes that all other parameters of its explanation cannot imitate."""
    if len(hypothesis.candidates) == 1:
        return hypothesis.independent_share
    return hypothesis.fit.equations.independent_share(candidate.free_parameters)


def _place_of(candidate: Candidate) -> dict[str, str]:
    """The key of explain.json that says where a candidate is, or in which form, with its value."""
    place, effect = candidate.where, EVERY[candidate.effect]
    if place in WHEELS:
        return {"wheel": place}
    if place in AXLES:
        return {"axle": place}
    if form := candidate.free_parameters[0].form:
        return {"form": form}
    return {effect.each: place} if place in effect.model_fields else {}


def _profile(hypothesis: Hypothesis, candidate: Candidate, dataset: Dataset) -> tuple[ProfilePoint, ...]:
    """What a size that is another at every place is where."""
    return tuple(
        ProfilePoint(
            **_point(dataset, parameter.place[1]),
            value=hypothesis.sizes[parameter.name],
            interval_90=_interval(hypothesis, parameter),
        )
        for parameter in candidate.free_parameters
        if parameter.place
    )


def _interval(hypothesis: Hypothesis, parameter: FreeParameter) -> tuple[float, float]:
    left = Residuals.level(hypothesis.fit.residuals)
    return interval(hypothesis.sizes[parameter.name], hypothesis.deviations[parameter.name], left)


def _point(dataset: Dataset, abscissa: float) -> dict[str, float]:
    """Where a place of the road is [m] along its stretch, and on the map, if that is known."""
    position = {
        "stretch": abscissa // ROAD_SETTINGS.stretch,
        "distance": abscissa % ROAD_SETTINGS.stretch - ROAD_SETTINGS.stretch / 2,
    }
    if (at := dataset.road.place(abscissa)) is not None:
        latitude, longitude = dataset.on_map.latitude_longitude(*at[:2])
        position |= {"latitude": latitude, "longitude": longitude, "direction": at[2]}
    return position


def since(onset: onsets.Onset | None) -> Onset | None:
    """What begins within recordings, if that is known."""
    if onset is None:
        return None
    (parameter,) = onset.candidate.free_parameters
    return Onset(
        looks_like=onset.candidate.effect, sentence=onset.candidate.sentence, where=onset.candidate.where,
        value=onset.size, unit=parameter.unit, gain=onset.gain, gain_always=onset.always, begins=onset.begins,
    )  # fmt: skip


def base_parameters(base: Fit, explained: Fit | None) -> dict[str, BaseParameter]:
    """Offsets of the base parameters by name, in the fit without what was found and in that with it."""
    pairs = zip(explained.free_parameters, explained.offsets, strict=True) if explained is not None else ()
    after = {parameter.name: float(offset) for parameter, offset in pairs}
    return {
        parameter.name: BaseParameter(unit=parameter.unit, value=float(offset), explained=after.get(parameter.name))
        for parameter, offset in zip(base.free_parameters, base.offsets, strict=True)
    }


def errors(residuals: Residuals, before: Fit, shown: Fit, validation: Validation) -> dict[str, SignalErrors]:
    """Root mean square errors of each signal in its unit with the fit `before` and with the one that is `shown`, in
    training and on what was held out."""
    units = {name: signal.unit for name, signal in compared_signals().items()}
    training = _before_and_after(residuals, before.residuals, shown.residuals)
    held_out: dict[str, Errors] = {}
    if validation.residuals is not None:
        first, then = validation.comparisons.held_out(shown)
        if before.parameter_set is not validation.base.parameter_set:
            first = validation.residuals(before.parameter_set, first)
        held_out = _before_and_after(validation.residuals, first, then)
    return {
        name: SignalErrors(unit=units[name], training=of_training, held_out=held_out.get(name))
        for name, of_training in training.items()
    }


def _before_and_after(residuals: Residuals, before: list[Array], after: list[Array]) -> dict[str, Errors]:
    """By signal."""
    first, then = residuals.by_signal(before), residuals.by_signal(after)
    return {name: Errors(before=first[name], after=then[name]) for name in first}


def traces(residuals: Residuals, base: Fit, simulated: Sequence[Mapping[str, Array]], held_out: bool) -> list[Trace]:
    """Each signal in each window as it was measured, as simulated with the base fit, and as `simulated`."""
    predictor = residuals.predictor
    units = {name: signal.unit for name, signal in compared_signals().items()}
    pairs = zip(
        predictor.dataset.windows, predictor.measured, predictor.simulated(base.parameter_set), simulated, strict=True
    )
    return [
        Trace(window.name, i, held_out, name, units[name], grid(window), measured[name], before[name], after[name])
        for i, (window, measured, before, after) in enumerate(pairs)
        for name in measured
        if name in before and name in after
    ]
