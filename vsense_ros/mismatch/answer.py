"""What was found, in the entries of explain.json and in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identify.least_squares import Fit, cost
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.page import PLACES, in_words
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.road import STRETCH
from vsense_ros.mismatch.search import Hypothesis
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.simulation import LOST
from vsense_ros.mismatch.verdict import ASTRAY, Judged, Proof, interval
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.effects import BY_ID, EVERY
from vsense_ros.model.effects.base import AXLES
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]

NO_PLACE = "what it is along the road is told by the distance driven, as no sensor knows the place"
IN_FILES = "the extended vehicle has of it what it is everywhere, and road.csv all"  # written where one is named
OWN_ROAD = (
    "what was held out is of another road, which nothing that was fitted can know: each second piece of 50 m of it is "
    "held against what follows from its neighbours, with the car as it was fitted"
)
ALONE = (
    "all of it is one stretch of driving: what is left out of the fit in turn are parts of it, in which the same was "
    "driven as in the others; add another recording, or hold one out"
)
NO_COURSE = (
    "nothing tells where the car heads on the map: directions are counted as if each recording set out to the east"
)
# Of a profile: a number for what hangs together, metres along it, degrees, radians counter-clockwise from east.
PLACE = ("stretch", "distance", "latitude", "longitude", "direction")


def remarks(
    judged: Judged, proof: Proof, shown: Fit, kinds: Collection[str], beyond: Mapping[str, str], varying: str
) -> list[str]:
    """What a reader has to know of an answer. `shown` is the fit that is told, `kinds` those of the sensors that were
    heard, `beyond` effects that lack a sensor, with the reason; `varying` is the signal that tells of an effect of the
    road that is another at every place, where one size is told all the same."""
    leader, said = judged.leader, proof.lost(shown)
    if varying:
        said.append(
            f"with one size for all of the road the {varying.replace('_', ' ')} stays off, with another at every place "
            "it does not; too few places were passed twice to say what it is where"
        )
    if leader is not None and (against := proof.against(leader)):
        said.append(against)
    if judged.verdict == "no_mismatch" and proof.fits_together:
        said.append(
            "what was held out is far off for the base parameters that fit the rest best, but not for ones that fit "
            "all of it: that tells of no missing physics"
        )
    if leader is not None and judged.verdict != "unknown":
        # Where wheel torques are unknown the car follows its wheels, whatever resists them: what an accelerometer tells
        # of the car is something else.
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
    if leader is not None and proof.surveyed(leader.fit):
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
    """The physics of a candidate; of a force with a moment that follows the same, where it acts."""
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


def effect_entries(judged: Judged, dataset: Dataset, proof: Proof) -> list[dict[str, Any]]:
    """Entries of all effects that were fitted, those of the leader first."""
    entries: list[dict[str, Any]] = []
    told: set[str] = set()
    for hypothesis in (*filter(None, [judged.leader]), *judged.rivals, *judged.ranked):
        for candidate in hypothesis.candidates:
            if candidate.effect not in told:
                told.add(candidate.effect)
                accepted = hypothesis is judged.leader and judged.verdict == "named"
                entry = _entry(judged, hypothesis, candidate, dataset, proof)
                entries.append(entry | {"accepted": accepted})
    return entries


def parts(effects: Sequence[Mapping[str, Any]], answer_set: Sequence[str]) -> list[dict[str, str]]:
    """What of the car, its road or its sensors the effects of the answer act on, where on it and in which form."""
    return [
        {"effect": e["id"], "acts_on": EVERY[e["id"]].acts_on(), **{key: e[key] for key in PLACES if key in e}}
        for e in effects
        if e["id"] in answer_set
    ]


def _entry(
    judged: Judged, hypothesis: Hypothesis, candidate: Candidate, dataset: Dataset, proof: Proof
) -> dict[str, Any]:
    parameters, along = [], []
    for parameter in candidate.free_parameters:
        value = hypothesis.sizes[parameter.name]
        size = {"value": value, "interval_90": list(interval(value, hypothesis.deviations[parameter.name]))}
        if parameter.place:
            along.append(_place(dataset, parameter.place[1]) | size)
        else:
            parameters.append({"name": parameter.name.rsplit(".", 1)[-1], "unit": parameter.unit} | size)
    entry: dict[str, Any] = {"id": candidate.effect, "sentence": _in_words(hypothesis, candidate)}
    place = candidate.where
    kinds = {**dict.fromkeys(WHEELS, "wheel"), **dict.fromkeys(AXLES, "axle")}
    if place in kinds:
        entry[kinds[place]] = place
    elif candidate.free_parameters[0].form:
        entry["form"] = candidate.free_parameters[0].form
    elif place in EVERY[candidate.effect].model_fields:
        entry[EVERY[candidate.effect].each] = place
    if along:
        entry["profile"] = along
    return entry | {
        "parameters": parameters, "gain_training": hypothesis.gain, "gain_left_out": hypothesis.cv_share,
        "gain_held_out": proof.gain(hypothesis), "adds_to_best": judged.adds(hypothesis),
        "keep": hypothesis.independent_share,
        "confidence": judged.confidence(hypothesis, candidate.effect),
        "objection": judged.refused.get(id(hypothesis), ""),
    }  # fmt: skip


def _place(dataset: Dataset, abscissa: float) -> dict[str, Any]:
    """Distance along a stretch of road [m], and where that is, if it is known."""
    where = [abscissa // STRETCH, abscissa % STRETCH - STRETCH / 2]
    if (at := dataset.road.place(abscissa)) is not None:
        where += [*dataset.on_map.latitude_longitude(*at[:2]), at[2]]
    return dict(zip(PLACE, where, strict=False))


def located(residuals: Residuals, base: Fit, proof: Proof) -> dict[str, Any]:
    """Where the base fit is off: signals with their errors, and what a good model leaves, in their units, the worst
    first, on what was held out if only that is off; windows [s] with their shares of the squared error, those in which
    the car got lost, and the region."""
    by_signal = residuals.by_signal(base.residuals)
    units = {name: signal.unit for name, signal in compared_signals().items()}
    good = {name: off * residuals.deviation[name] for name, off in residuals.good(base.residuals).items()}
    there, off, _ = where = _most_off(residuals, base, proof)
    ranking = there.by_signal(off)
    worst = sorted(by_signal, key=lambda name: ranking.get(name, 0.0) / good[name], reverse=True)
    whole = max(cost(base.residuals), 1e-12)
    windows = residuals.predictor.dataset.windows
    segments = [
        {"recording": w.name, "begin": w.begin, "end": w.end, "share": float(r @ r) / whole}
        for w, r in zip(windows, base.residuals, strict=True)
    ]
    return {
        "signals": [{"name": n, "unit": units[n], "before": by_signal[n], "null": good[n]} for n in worst],
        "segments": sorted(segments, key=lambda s: s["share"], reverse=True),
        "lost": [{"recording": w.name, "begin": w.begin, "end": w.end} for w in residuals.predictor.dataset.dropped],
        "region": _region(*where),
    }


def force(judged: Judged, proof: Proof) -> dict[str, Any] | None:
    """The force, torque, angle or reading that describes what is left over, where that was asked and is proven."""
    if judged.verdict != "unknown" or judged.leader is None:
        return None
    (term,) = judged.leader.candidates
    sizes = [
        {
            "name": parameter.name.rsplit(".", 1)[-1],
            "unit": parameter.unit,
            "value": judged.leader.sizes[parameter.name],
        }
        for parameter in term.free_parameters
    ]
    return {
        "description": _in_words(judged.leader, term), "sizes": sizes, "lever_arm": _lever_arm(judged.leader),
        "gain_training": judged.leader.gain, "gain_left_out": judged.leader.cv_share,
        "gain_held_out": proof.gain(judged.leader),
    }  # fmt: skip


def _most_off(residuals: Residuals, base: Fit, proof: Proof) -> tuple[Residuals, list[Array], str]:
    """The residuals of the base fit, and the words for what they are of if they are not of what it was fitted to: of
    what was held out, where they are far from those of a good model there alone."""
    unseen = proof.residuals
    if unseen is not None and residuals.worst(base.residuals) < ASTRAY < unseen.worst(proof.before):
        return unseen, proof.before, " on what was held out"
    return residuals, base.residuals, ""


def _region(residuals: Residuals, off: list[Array], of: str) -> dict[str, Any] | None:
    """Where the residual of the worst signal is large: what it goes along with, of what is measured itself."""
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
    return {"description": text, "correlation": found}


def base_parameters(base: Fit, explained: Fit | None) -> dict[str, Any]:
    """Amounts of the base parameters, in the fit without what was found and in that with it."""
    pairs = zip(explained.free_parameters, explained.offsets, strict=True) if explained is not None else ()
    after = {parameter.name: float(offset) for parameter, offset in pairs}
    return {
        parameter.name: {"unit": parameter.unit, "value": float(offset), "explained": after.get(parameter.name)}
        for parameter, offset in zip(base.free_parameters, base.offsets, strict=True)
    }


def errors(residuals: Residuals, base: Fit, shown: Fit, proof: Proof) -> dict[str, Any]:
    """Root mean square errors of each signal in its unit with the base fit and with what is told, in training and on
    what was held out."""
    units = {name: signal.unit for name, signal in compared_signals().items()}
    before, after = residuals.by_signal(base.residuals), residuals.by_signal(shown.residuals)
    result: dict[str, Any] = {
        name: {"unit": units[name], "training": {"before": before[name], "after": after[name]}} for name in before
    }
    if proof.residuals is not None:
        before, after = (proof.residuals.by_signal(r) for r in proof.compared(shown))
        for name in before:
            if name in result:
                result[name]["held_out"] = {"before": before[name], "after": after[name]}
    return result


def sentence(found: Mapping[str, Any], rivals: Sequence[Sequence[str]]) -> str:
    """The answer in words; `rivals` are the ids of what cannot be told apart."""
    if found["verdict"] == "no_mismatch":
        return "Model and recordings agree once mass, tyres and the like are fitted: there is nothing to find here."
    if found["verdict"] == "unknown":
        where = found["located"]["region"]
        if force := found["located"]["force"]:
            described = f". It is described by {force['description']}, with which {_falls(force, found)}"
        elif lost := found["located"]["lost"]:
            names = dict.fromkeys(window["recording"] for window in lost)
            described = f": in {' and '.join(names)} {LOST}"
        else:
            described = f": {where['description']}" if where else ""
        return f"Something is left over that no effect of the library explains{described}."
    if found["verdict"] == "ambiguous":
        shared = [id for id in found["answer_set"] if all(id in effects for effects in rivals)]
        others = [[id for id in effects if id not in shared] for effects in rivals]
        choices = [" with ".join(BY_ID[id].sentence for id in effects) for effects in others if effects]
        doubt = f"these recordings cannot tell which it is: {', or '.join(dict.fromkeys(choices))}."
        if not shared:
            return doubt[0].upper() + doubt[1:]
        return f"The model leaves out {' and '.join(BY_ID[id].sentence for id in shared)}; what besides, {doubt}"
    accepted = [effect for effect in found["effects"] if effect["accepted"]]
    named = " and ".join(map(in_words, accepted))
    if found.get("assumed"):
        return f"Assumed, not searched for: {named}; with it {_falls(accepted[0], found)}."
    return f"The model leaves out {named}; with it {_falls(accepted[0], found)}."


def _falls(gains: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """By how much the error falls with what was found, and where that is proven."""
    proven, on = gains["gain_held_out"], "on recordings it was not fitted to"
    if found["by_pieces"]:
        on = "on another road, where neighbouring pieces foretell each other"
    if proven is None:
        proven, on = gains["gain_left_out"], "where it was left out of the fit"
    trained = gains["gain_training"]
    ways = ["grows" if gain < 0 else "falls" for gain in (trained, proven)]
    again = "" if ways[0] == ways[1] else f"{ways[1]} "
    return f"the squared error {ways[0]} by {100 * abs(trained):.0f} %, and {again}by {100 * abs(proven):.0f} % {on}"


def traces(residuals: Residuals, base: Fit, simulated: Sequence[Mapping[str, Array]], held_out: bool) -> list[Trace]:
    """Each signal in each window as it was measured, as simulated with the base fit, and with what is told."""
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
