"""What was found, as the objects of explain.json and in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identify.free_parameter import FreeParameter
from vsense_ros.identify.least_squares import DivergedError, Fit, cost
from vsense_ros.identify.parameter_set import ParameterSet
from vsense_ros.mismatch import onset as onsets
from vsense_ros.mismatch.ages import DELAY
from vsense_ros.mismatch.answer_schema import (
    ActingPart,
    Answer,
    BaseParameter,
    Begin,
    EffectEntry,
    Errors,
    Force,
    Located,
    Onset,
    ProfilePoint,
    Region,
    Remainder,
    Segment,
    SignalErrors,
    SignalMisfit,
    Size,
    Span,
    TermSize,
)
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.confidence import interval
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.residuals import RESIDUALS, Residuals
from vsense_ros.mismatch.road import ROAD_SETTINGS
from vsense_ros.mismatch.search import Hypothesis
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.simulation import LOST
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.mismatch.words import in_words, label, percent
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.effects import BY_ID, EVERY
from vsense_ros.model.effects.base import AXLES
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]

NO_PLACE = "what it is along the road is told by the distance driven, as no sensor knows the place"
IN_FILES = "the extended vehicle has of it what it is everywhere, and road.csv all"  # written where one is named
OWN_ROAD = (
    "what was held out is of another road, of which no fit can know: each piece of 50 m of it is compared with what "
    "follows from its neighbours, with the car as it was fitted"
)


@dataclass(frozen=True)
class LatencySettings:
    """How sure latencies count that correlation of signals determines: decisions of this project."""

    lag_deviation: float = 0.1  # [s] by which a lag from correlation may be wrong
    confidence: float = 0.99  # [-] confidence in a lag that all other sensors agree with


LATENCY = LatencySettings()

ALONE = (
    "all of it is one stretch of driving: what is left out of the fit in turn are parts of it, in which the same was "
    "driven as in the others; add another recording, or hold one out"
)
NO_COURSE = (
    "nothing tells where the car heads on the map: directions are counted as if each recording set out to the east"
)


def remarks(
    judged: Judged, validation: Validation, shown: Fit, kinds: Collection[str], beyond: Mapping[str, str], varying: str
) -> list[str]:
    """What a reader has to know of an answer. `shown` is the fit that it shows, `kinds` are those of the sensors that
    gave measurements, `beyond` the effects that lack a sensor, with the reason. `varying` is the signal that stays off
    with one size for all of the road, where that is told all the same."""
    leader, said = judged.leader, validation.lost(shown)
    if varying:
        said.append(
            f"with one size for all of the road the {varying.replace('_', ' ')} stays off, with another at every place "
            "it does not; too few places were passed twice to say what it is where"
        )
    if leader is not None and (against := validation.against(leader)):
        said.append(against)
    if judged.verdict == "no_mismatch" and validation.fits_together:
        said.append(
            "what was held out is far off for the base parameters that fit the rest best, but not for ones that fit "
            "all of it: that tells of no missing physics"
        )
    if leader is not None and judged.verdict != "unknown":
        # Where wheel torques are unknown the simulated car follows its wheel speeds, whatever resists them: what an
        # accelerometer tells of is then no effect that needs wheel torques.
        unlike = {"wheel_torques"} if "imu" in kinds else set()
        said += [
            f"{BY_ID[id].sentence} may look the same and is not excluded: {reason}"
            for id, reason in beyond.items()
            if set(BY_ID[id].mistaken_for) & set(leader.effects) and set(BY_ID[id].needs) - set(kinds) - unlike
        ]
    if leader is not None and "gnss_velocity" not in kinds and any(EVERY[id].on_map for id in leader.effects):
        said.append(NO_COURSE)
    if leader is not None and any(c.along_road for c in leader.candidates) and "gnss_position" not in kinds:
        said.append(NO_PLACE if judged.verdict == "ambiguous" else f"{NO_PLACE}: {IN_FILES}")
    if leader is not None and validation.by_pieces(leader.fit):
        said.append(OWN_ROAD)
    if leader is not None and (elsewhere := judged.other_places()):
        place = leader.candidates[0].where
        said.append(f"where it is, is not sure: {' or '.join(elsewhere)} explains about as much as {place}")
    if judged.besides:
        said.append(
            f"something smaller is there besides, and the recordings cannot tell whether it is "
            f"{' or '.join(BY_ID[id].sentence for id in judged.besides)}"
        )
    return said


def _in_words(hypothesis: Hypothesis, candidate: Candidate) -> str:
    """The physics of a candidate; of a force with a moment that is proportional to the same, also where it acts."""
    arm = _lever_arm(hypothesis)
    if arm is None:
        return candidate.sentence
    return f"{candidate.sentence}, {abs(arm):.1f} m {'ahead of' if arm > 0 else 'behind'} the centre of gravity"


def _lever_arm(hypothesis: Hypothesis) -> float | None:
    """How far ahead of the centre of gravity a lateral force acts that has a moment [m]."""
    sizes = {name.rsplit(".", 1)[-1]: size for name, size in hypothesis.sizes.items()}
    for name, force in sizes.items():
        moment = name.replace("lateral_force", "yaw_moment")
        if moment != name and moment in sizes and force:
            return sizes[moment] / force
    return None


def rivals(judged: Judged, late: Mapping[str, float]) -> tuple[tuple[str, ...], ...]:
    """Ids of the effects of each explanation that remains; sensors that are `late` are part of each."""
    delays = (DELAY.id,) if late else ()
    found = [
        (*hypothesis.effects, *(id for id in delays if id not in hypothesis.effects)) for hypothesis in judged.rivals
    ]
    if not found and judged.verdict == "no_mismatch" and delays:
        found = [delays]
    return tuple(dict.fromkeys(found))


def answer_set(judged: Judged, late: Mapping[str, float] = MappingProxyType({})) -> list[str]:
    """Ids of the effects in the answer."""
    return list(dict.fromkeys(id for ids in rivals(judged, late) for id in ids))


def with_ages(
    effects: Sequence[EffectEntry], late: Mapping[str, float], shown: Fit, residuals: Residuals, validation: Validation
) -> tuple[EffectEntry, ...]:
    """The effects with the sensors that were found to be `late` before any fit, by size of that effect [s]: by so
    much more where the fit has found more. What they gain is what is lost without."""
    found = list(effects)
    for field, age in late.items():
        at = next(
            (
                i
                for i, one in enumerate(found)
                if one.id == DELAY.id and one.parameters[0].name == field and one.accepted
            ),
            None,
        )
        if at is not None:
            size = found[at].parameters[0]
            low, high = size.interval_90
            whole = size.with_(value=size.value + age, interval_90=(low + age, high + age))
            found[at] = found[at].with_(parameters=(whole, *found[at].parameters[1:]))
            continue
        name = f"effects.{DELAY.id}.{field}"
        without = shown.parameter_set.changed({name: shown.parameter_set.values[name] - age})
        trained = _lost(residuals, shown.residuals, without)
        unseen = None
        if validation.residuals is not None:
            unseen = _lost(validation.residuals, validation.held_out(shown)[1], without)
        around = (age - LATENCY.lag_deviation, age + LATENCY.lag_deviation)
        found.insert(
            0,
            EffectEntry(
                id=DELAY.id, sentence=DELAY.sentence, sensor=field,
                parameters=(Size(name=field, unit="s", value=age, interval_90=around),),
                gain_training=trained, gain_left_out=trained, gain_held_out=unseen, adds_to_best=None, keep=1.0,
                confidence=LATENCY.confidence, objection="", accepted=True, answer_set=(DELAY.id,), would_separate=None,
            ),
        )  # fmt: skip
    return tuple(found)


def _lost(residuals: Residuals, after: Sequence[Array], without: ParameterSet) -> float:
    """By how much the squared error falls, relative, from that of other parameters."""
    try:
        before = cost(residuals(without, [np.full(len(r), RESIDUALS.outlier / 2) for r in after]))
    except DivergedError:
        return 1.0
    return float(1 - cost(after) / max(before, 1e-12))


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
    return EffectEntry(
        id=candidate.effect,
        sentence=_in_words(hypothesis, candidate),
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
        keep=hypothesis.independent_share,
        confidence=judged.confidence(hypothesis, candidate.effect),
        objection=judged.objection_to(hypothesis),
        accepted=hypothesis is judged.leader and candidate.effect in judged.sure,
        answer_set=tuple(ids) if candidate.effect in ids else (),
        would_separate=None,
    )


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
    return interval(hypothesis.sizes[parameter.name], hypothesis.deviations[parameter.name])


def _point(dataset: Dataset, abscissa: float) -> dict[str, float]:
    """Where a place of the road is [m] along its stretch, and on the map, if that is known."""
    found = {
        "stretch": abscissa // ROAD_SETTINGS.stretch,
        "distance": abscissa % ROAD_SETTINGS.stretch - ROAD_SETTINGS.stretch / 2,
    }
    if (at := dataset.road.place(abscissa)) is not None:
        latitude, longitude = dataset.on_map.latitude_longitude(*at[:2])
        found |= {"latitude": latitude, "longitude": longitude, "direction": at[2]}
    return found


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
    """The force, torque, angle or reading that describes what is left over, where that was asked and is proven."""
    if judged.verdict != "unknown" or judged.leader is None:
        return None
    return _term_in_words(judged.leader, validation)


def _term_in_words(hypothesis: Hypothesis, validation: Validation) -> Force:
    """The term without known physics that is the last part of an explanation."""
    term = hypothesis.candidates[-1]
    sizes = tuple(
        TermSize(name=parameter.name.rsplit(".", 1)[-1], unit=parameter.unit, value=hypothesis.sizes[parameter.name])
        for parameter in term.free_parameters
    )
    return Force(
        description=_in_words(hypothesis, term), sizes=sizes, lever_arm=_lever_arm(hypothesis),
        gain_training=hypothesis.gain, gain_left_out=hypothesis.cv_share, gain_held_out=validation.gain(hypothesis),
    )  # fmt: skip


def remainder(
    residuals: Residuals, shown: Fit, judged: Judged, term: Hypothesis | None, validation: Validation
) -> Remainder | None:
    """What is left over besides what is named, which a `term` beside it may describe; None where that is all."""
    if not judged.partial or judged.verdict != "named":
        return None
    off = shown.residuals
    good, errors = residuals.good(off), residuals.deviations(off)
    units = {name: signal.unit for name, signal in compared_signals().items()}
    far = sorted(
        (name for name in errors if errors[name] > validation.thresholds.signal_off * good[name]),
        key=lambda name: errors[name] / good[name],
        reverse=True,
    )
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
        force=None if term is None else _term_in_words(term, validation),
    )


def since(found: onsets.Onset | None) -> Onset | None:
    """What begins within recordings, if that is known."""
    if found is None:
        return None
    (parameter,) = found.candidate.free_parameters
    return Onset(
        looks_like=found.candidate.effect, sentence=found.candidate.sentence, where=found.candidate.where,
        value=found.size, unit=parameter.unit, gain=found.gain, gain_always=found.always,
        begins=tuple(
            Begin(recording=one.recording, at=one.at, interval_90=(one.earliest, one.latest)) for one in found.begins
        ),
    )  # fmt: skip


def _most_off(residuals: Residuals, base: Fit, validation: Validation) -> tuple[Residuals, list[Array], str]:
    """The residuals of the base fit in training; or held out, with words that say so, where only those are far from
    those of a good model."""
    unseen, off_from = validation.residuals, validation.thresholds.signal_off
    if unseen is not None and residuals.worst(base.residuals) < off_from < unseen.worst(validation.before):
        return unseen, validation.before, " on what was held out"
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
    found = {}
    for feature, parts in features.items():
        value = np.concatenate(parts)
        if value.std() > 0 and large.std() > 0:
            found[feature] = float(np.corrcoef(value, large)[0, 1])
    if not found:
        return None
    strongest = max(found, key=lambda f: abs(found[f]))
    way = "grows" if found[strongest] > 0 else "falls"
    word = strongest.replace("_", " ")
    text = f"the error of the {signal.replace('_', ' ')}{of} {way} with the {word}"
    if abs(found[strongest]) < 0.3:
        text = f"the error of the {signal.replace('_', ' ')}{of} is about the same everywhere"
    return Region(description=text, correlation=found)


def base_parameters(base: Fit, explained: Fit | None) -> dict[str, BaseParameter]:
    """Offsets of the base parameters by name, in the fit without what was found and in that with it."""
    pairs = zip(explained.free_parameters, explained.offsets, strict=True) if explained is not None else ()
    after = {parameter.name: float(offset) for parameter, offset in pairs}
    return {
        parameter.name: BaseParameter(unit=parameter.unit, value=float(offset), explained=after.get(parameter.name))
        for parameter, offset in zip(base.free_parameters, base.offsets, strict=True)
    }


def errors(residuals: Residuals, base: Fit, shown: Fit, validation: Validation) -> dict[str, SignalErrors]:
    """Root mean square errors of each signal in its unit with the base fit and with the one that is `shown`, in
    training and on what was held out."""
    units = {name: signal.unit for name, signal in compared_signals().items()}
    training = _before_and_after(residuals, base.residuals, shown.residuals)
    held_out: dict[str, Errors] = {}
    if validation.residuals is not None:
        held_out = _before_and_after(validation.residuals, *validation.held_out(shown))
    return {
        name: SignalErrors(unit=units[name], training=found, held_out=held_out.get(name))
        for name, found in training.items()
    }


def _before_and_after(residuals: Residuals, before: list[Array], after: list[Array]) -> dict[str, Errors]:
    """By signal."""
    first, then = residuals.by_signal(before), residuals.by_signal(after)
    return {name: Errors(before=first[name], after=then[name]) for name in first}


def sentence(answer: Answer) -> str:
    """The answer in words."""
    if answer.verdict == "no_mismatch":
        return "Model and recordings agree once mass, tyres and the like are fitted: there is nothing to find here."
    if answer.verdict == "unknown":
        return f"Something is left over that no effect of the library explains{_left_over(answer)}.{_began(answer)}"
    if answer.verdict == "ambiguous":
        return _in_doubt(answer)
    accepted = answer.accepted
    named = " and ".join(map(in_words, accepted))
    if answer.assumed:
        return f"Assumed, not searched for: {named}; with it {_falls(accepted[0], answer)}."
    rest = "" if answer.remainder is None else f". Something more is left over{_rest_in_words(answer.remainder)}"
    return f"The model leaves out {named}; with it {_falls(accepted[0], answer)}{rest}.{_began(answer)}"


def _began(answer: Answer) -> str:
    """Since when it is there, as a sentence behind others; empty where that is not known."""
    if answer.onset is None:
        return ""
    when = " and ".join(
        f"at {one.at:.1f} s ({one.interval_90[0]:.1f} to {one.interval_90[1]:.1f} s) in {one.recording}"
        for one in answer.onset.begins
    )
    like = f"{answer.onset.sentence}{f' ({label(answer.onset.where)})' if answer.onset.where else ''}"
    return (
        f" It was not there from the beginning: it begins {when}. It looks like {like}, which explains "
        f"{percent(answer.onset.gain)} if it begins then and {percent(answer.onset.gain_always)} if it is always there."
    )


def _rest_in_words(rest: Remainder) -> str:
    """What else is left over, as the end of a sentence."""
    if rest.force is not None:
        return f", which {rest.force.description} describes"
    return "" if rest.region is None else f": {rest.region.description}"


def _left_over(answer: Answer) -> str:
    """What is known of unknown physics, as the end of a sentence."""
    if force := answer.located.force:
        return f". It is described by {force.description}, with which {_falls(force, answer)}"
    if lost := answer.located.lost:
        return f": in {' and '.join(dict.fromkeys(window.recording for window in lost))} {LOST}"
    return f": {answer.located.region.description}" if answer.located.region else ""


def _in_doubt(answer: Answer) -> str:
    """Which effects the recordings cannot tell apart, and which are sure besides."""
    shared = [id for id in answer.answer_set if all(id in effects for effects in answer.rivals)]
    others = [[id for id in effects if id not in shared] for effects in answer.rivals]
    choices = [" with ".join(BY_ID[id].sentence for id in effects) for effects in others if effects]
    doubt = f"these recordings cannot tell which it is: {', or '.join(dict.fromkeys(choices))}."
    if not shared:
        return doubt[0].upper() + doubt[1:]
    return f"The model leaves out {' and '.join(BY_ID[id].sentence for id in shared)}; what besides, {doubt}"


def _falls(found: EffectEntry | Force, answer: Answer) -> str:
    """By how much the error falls with what was found, and where that is proven."""
    trained, proven, on = found.gain_training, found.gain_held_out, "on recordings it was not fitted to"
    if answer.by_pieces:
        on = "on another road, where neighbouring pieces predict each other"
    if proven is None:
        proven, on = found.gain_left_out, "where it was left out of the fit"
    ways = ["grows" if gain < 0 else "falls" for gain in (trained, proven)]
    again = "" if ways[0] == ways[1] else f"{ways[1]} "
    return f"the squared error {ways[0]} by {100 * abs(trained):.0f} %, and {again}by {100 * abs(proven):.0f} % {on}"


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
