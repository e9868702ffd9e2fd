"""From recordings and a vehicle file to what the model leaves out: gate, refit, locate, screen, name, prove.

The answer is one of: `named`, one effect explains what was left over, on recordings it was not fitted to as well;
`ambiguous`, several do about equally; `unknown`, something is left over and nothing in the library explains it;
`no_mismatch`; `not_assessable`, with the reason.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from vsense_ros.errors import InputError
from vsense_ros.mismatch.design import ANSWER, NEXT
from vsense_ros.mismatch.evidence import Evidence, gather
from vsense_ros.mismatch.fit import DivergedError, Fit, Residuals, cost, fit
from vsense_ros.mismatch.gate import hindrance, misfit
from vsense_ros.mismatch.judge import ASTRAY, SUSPICIOUS, THRESHOLD, Judged, Proof, interval, judge
from vsense_ros.mismatch.knobs import BASE, Candidate, Knob, base_knobs, candidates, out_of_reach
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.prediction import LOST, Predictor, Setting, abscissae
from vsense_ros.mismatch.report import PAGE, PLACES, in_words, write_report
from vsense_ros.mismatch.road import STRETCH, place_of, points, profile
from vsense_ros.mismatch.search import Explanation, Search
from vsense_ros.mismatch.selection import most_telling
from vsense_ros.mismatch.signals import SIGNALS, grid
from vsense_ros.model.effects import BY_ID, EVERY
from vsense_ros.model.effects.base import AXLES, WHEELS
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.recording import Recording
from vsense_ros.vehicle_file import save_vehicle

Array = NDArray[np.float64]

ABLATIONS = ("no_refit", "no_projection", "chi2_thresholds")
# Of driving that is fitted, and of as much that it is proven on: more of the same takes hours and says little more.
LOOKED_AT = 900.0  # [s]
STAGES = len(BASE) * 3 + 70  # steps of the progress, about
ALONE = (
    "all of it is one stretch of driving: nothing can be left out of the fit, and gains are those of the fit itself; "
    "add another recording, or hold one out"
)
NO_COURSE = (
    "nothing tells where the car heads on the map: directions are counted as if each recording set out to the east"
)
EXTENDED, ROAD = "vehicle.extended.yaml", "road.csv"

# Of a profile: a number for what hangs together, metres along it, degrees, radians counter-clockwise from east.
PLACE = ("stretch", "distance", "latitude", "longitude", "direction")


@dataclass(frozen=True)
class Answer:
    """The content of explain.json, and what else a report shows."""

    found: dict[str, Any]
    traces: list[Trace] = field(default_factory=list)
    extended: Vehicle | None = None

    def write(self, folder: Path) -> None:
        """explain.json, report.html, where something is named vehicle.extended.yaml, and road.csv where that changes
        along the road."""
        folder.mkdir(parents=True, exist_ok=True)
        for earlier in (EXTENDED, ROAD, NEXT):
            (folder / earlier).unlink(missing_ok=True)
        (folder / ANSWER).write_text(json.dumps(self.found, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        write_report(self.found, self.traces, folder / PAGE)
        if self.extended is not None:
            save_vehicle(folder / EXTENDED, self.extended)
            self._write_road(folder / ROAD)

    def _write_road(self, path: Path) -> None:
        """A row for each place and effect of the road that was named."""
        rows = [
            [effect["id"], effect["parameters"][0]["unit"], *(place.get(key, "") for key in PLACE),
             effect["parameters"][0]["value"] + place["value"]]
            for effect in self.found["effects"] if effect["accepted"]
            for place in effect.get("profile", ())
        ]  # fmt: skip
        if rows:
            with path.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file).writerows([["effect", "unit", *PLACE, "value"], *rows])


def answer(
    recordings: Sequence[Recording],
    vehicle: Vehicle,
    held_out: Sequence[Recording] = (),
    assume: Sequence[str] = (),
    ablation: str = "",
    progress: Callable[[], None] = lambda: None,
) -> Answer:
    """What the model of `vehicle` leaves out on `recordings`, proven on `held_out` where there are any.

    With `assume` the effects of these ids are fitted, without a search; with one of `ABLATIONS` a part of the method is
    left out, to see what it is worth. Which test would tell an ambiguous answer apart, `design` finds. Raises
    `InputError` for an unknown id or ablation.
    """
    if unknown := [name for name in assume if name not in BY_ID]:
        raise InputError(f"no effect {', '.join(unknown)}; the library has {', '.join(sorted(BY_ID))}")
    if ablation not in ("", *ABLATIONS):
        raise InputError(f"no ablation {ablation}; there are {', '.join(ABLATIONS)}")
    begun, assume = time.process_time(), tuple(dict.fromkeys(assume))
    evidence = gather(recordings, vehicle)
    unseen = gather(held_out, vehicle, evidence)
    found: dict[str, Any] = {
        "verdict": "not_assessable", "sentence": "", "vehicle": vehicle.name,
        "recordings": [r.name for r in recordings], "held_out": [r.name for r in held_out],
        "remarks": list(evidence.remarks),
        "located": {"signals": [], "segments": [], "lost": [], "region": None, "force": None, "parts": []},
        "effects": [], "out_of_reach": [], "answer_set": [], "rivals": [], "would_separate": None, "fit": {},
        "base": {}, "threshold": THRESHOLD, "driven_s": evidence.driven + unseen.driven,
    }  # fmt: skip

    def nothing_said(reason: str) -> Answer:
        found["sentence"] = f"Nothing can be said: {reason}."
        found["cpu_s"] = time.process_time() - begun
        return Answer(found)

    if reason := hindrance([*recordings, *held_out], evidence, unseen, vehicle):
        return nothing_said(reason)
    evidence, unseen = most_telling(evidence, LOOKED_AT), most_telling(unseen, LOOKED_AT)
    kinds = {evidence.sensors[name].kind for w in evidence.windows for name in w.readings}
    beyond = out_of_reach(kinds)
    if lacking := [f"{id}: {beyond[id]}" for id in assume if id in beyond]:
        return nothing_said("; ".join(lacking))
    try:
        knobs = () if ablation == "no_refit" else base_knobs(vehicle, beyond, kinds)
        evidence, residuals, base = _refitted(vehicle, evidence, knobs, progress)
    except DivergedError:
        return nothing_said(
            "the car of the vehicle file leaves the road when it is driven with the recorded inputs; is it the file "
            "of this car?"
        )
    places = points([w.place.value[:, 0] for w in evidence.windows])
    start = residuals.predictor.start
    library = candidates(places, start.values)
    offered = tuple(c for c in library if c.effect not in beyond and (not assume or c.effect in assume))
    if ablation == "no_projection":
        base = replace(base, knobs=(), amounts=np.zeros(0), slopes=[np.zeros((len(r), 0)) for r in base.residuals])
        start = base.setting
    search = Search(residuals, start, base, offered, progress)

    def fitted() -> list[Explanation]:
        if assume:
            return [search.polished(e) for e in search.together([_all_of(id, library) for id in assume])]
        return search.singles()

    explanations = fitted()
    if (better := search.better_base(explanations)) is not None:
        base, search = better, Search(residuals, start, better, offered, progress)
        explanations = fitted()
    strange = misfit(base, residuals)  # unless what the model leaves out is the reason
    traceless = {c.effect for c in offered} - search.visible
    beyond |= dict.fromkeys(sorted(traceless), "nothing that was recorded depends on it")
    found["out_of_reach"] = [{"id": id, "reason": reason} for id, reason in beyond.items()]
    if not search.visible:
        return nothing_said("no effect of the library would leave a trace in these recordings")
    proof = Proof(unseen, vehicle, residuals, base, progress)
    found["remarks"] = [*evidence.remarks, *proof.remarks]
    if proof.residuals is None and len(search.groups) == 1:
        found["remarks"].append(ALONE)
    found["held_out"] = proof.recordings
    described: list[Explanation] = []
    if not assume:
        found_last = explanations
        while found_last := search.further(found_last, THRESHOLD, proof.proven, bool(proof.recordings)):
            explanations = [*explanations, *found_last]
        if min(residuals.level(f.residuals) for f in (base, *(e.fit for e in explanations))) > SUSPICIOUS:
            described = search.described()
    threshold = THRESHOLD
    if ablation == "chi2_thresholds":
        found["threshold"] = threshold = float(chi2.isf(0.05 / len(offered), 1)) / search.whole  # Bonferroni
    judged = judge(explanations, described, proof, search.along_the_road, threshold)
    if judged.verdict == "no_mismatch" and not assume and not described:
        judged = judge(explanations, search.described(), proof, search.along_the_road, threshold)
    if judged.in_doubt and not assume:
        united = search.united(judged.in_doubt)
        judged = judge([*explanations, *united], described, proof, search.along_the_road, threshold)
    if assume and explanations:
        judged = replace(judged, verdict="named", leader=explanations[0], rivals=(explanations[0],))
    off, freed = "", None
    if judged.leader is not None:
        if off := proof.unmended(judged.leader):
            freed = search.along_the_road(judged.leader)
        judged = judged.led_by(search.settled(judged.leader), proof)
        if freed is not None and judged.leader is not None and proof.lasting(freed) > proof.lasting(judged.leader):
            judged = judged.led_by(freed, proof)
    leader, verdict = judged.leader, judged.verdict
    if strange and (leader is None or misfit(leader.fit, residuals)):
        return nothing_said(strange)
    shown = leader.fit if leader is not None else base
    found["remarks"] += proof.lost(shown)
    if leader is not None and freed not in (None, leader):
        found["remarks"].append(
            f"with one size for all of the road the {off.replace('_', ' ')} stays off, with another at every place it "
            "does not; too few places were passed twice to say what it is where"
        )
    if leader is not None and (against := proof.against(leader)):
        found["remarks"].append(against)
    if verdict == "no_mismatch" and proof.fits_together:
        found["remarks"].append(
            "what was held out is far off for the base parameters that fit the rest best, but not for ones that fit "
            "all of it: that tells of no missing physics"
        )
    if leader is not None and verdict != "unknown":
        found["remarks"] += [
            f"{BY_ID[id].sentence} may look the same and is not excluded: {reason}"
            for id, reason in beyond.items()
            if id not in traceless and set(BY_ID[id].mistaken_for) & set(leader.effects)
        ]
    if leader is not None and "gnss_velocity" not in kinds and any(EVERY[id].on_map for id in leader.effects):
        found["remarks"].append(NO_COURSE)
    if leader is not None and (elsewhere := judged.other_places()):
        place = leader.candidates[0].where
        found["remarks"].append(f"where it is, is not sure: {' or '.join(elsewhere)} explains about as much as {place}")
    if judged.besides:
        found["remarks"].append(
            f"something smaller is there besides, and the recordings cannot tell whether it is "
            f"{' or '.join(BY_ID[id].sentence for id in judged.besides)}"
        )
    effects = _effects(judged, evidence, proof)
    answer_set = list(dict.fromkeys(id for e in judged.rivals for id in e.effects))
    for effect in effects:
        effect |= {"answer_set": answer_set if effect["id"] in answer_set else [], "would_separate": None}
    found |= {
        "verdict": verdict,
        "located": _located(residuals, base, proof) | {"force": _force(judged), "parts": _parts(effects, answer_set)},
        "effects": effects,
        "answer_set": answer_set,
        "rivals": [list(effects) for effects in dict.fromkeys(e.effects for e in judged.rivals)],
        "fit": _errors(residuals, base, shown, proof),
        "base": _base(base, leader.fit if leader is not None else None),
        "misfit": residuals.level(base.residuals),
    }
    found["sentence"] = _sentence(found, [e.effects for e in judged.rivals])
    found["cpu_s"] = time.process_time() - begun
    traces = _traces(residuals, base, shown, False)
    if proof.residuals is not None:
        traces += _traces(proof.residuals, base, shown, True)
    extended = _extended(vehicle, evidence, shown.setting) if leader is not None and verdict != "ambiguous" else None
    return Answer(found, traces, extended)


def _refitted(
    vehicle: Vehicle, evidence: Evidence, knobs: Sequence[Knob], progress: Callable[[], None]
) -> tuple[Evidence, Residuals, Fit]:
    """The base parameters fitted to the evidence; to the rest of it where the simulated car is lost in some windows
    even when it is fitted to the others. Where it is lost in most of them, to all."""
    residuals = Residuals(Predictor(vehicle, evidence))
    base = fit(residuals, residuals.predictor.start, knobs, progress=progress)
    lost = residuals.predictor.lost(base.setting)
    if not any(lost) or 2 * sum(lost) > len(lost):
        return evidence, residuals, base
    rest = evidence.without(lost, LOST)
    residuals_of_rest = Residuals(Predictor(vehicle, rest))
    fitted = fit(residuals_of_rest, residuals.predictor.start, knobs, begin=base.amounts, progress=progress)
    if not any(residuals.predictor.lost(fitted.setting)):
        base = fit(residuals, residuals.predictor.start, knobs, begin=fitted.amounts, progress=progress)
        if not any(residuals.predictor.lost(base.setting)):
            return evidence, residuals, base
    return rest, residuals_of_rest, fitted


def _all_of(id: str, library: Sequence[Candidate]) -> Candidate:
    """An effect with all its sizes free."""
    single = (c for c in library if c.effect == id and not c.along_road)
    knobs = {knob.name: knob for c in single for knob in c.knobs if not knob.form}
    return Candidate(id, "", tuple(knobs.values()), BY_ID[id].sentence)


def _in_words(explanation: Explanation, candidate: Candidate) -> str:
    """The physics of a candidate; of a force with a moment that follows the same, where it acts."""
    arm = _lever_arm(explanation)
    if arm is None:
        return candidate.sentence
    return f"{candidate.sentence}, {abs(arm):.1f} m {'ahead of' if arm > 0 else 'behind'} the centre of gravity"


def _lever_arm(explanation: Explanation) -> float | None:
    """How far ahead of the centre of gravity a lateral force acts that has a moment [m]."""
    sizes = {name.rsplit(".", 1)[-1]: size for name, size in explanation.sizes.items()}
    for name, force in sizes.items():
        moment = name.replace("lateral_force", "yaw_moment")
        if moment != name and moment in sizes and force:
            return sizes[moment] / force
    return None


def _effects(judged: Judged, evidence: Evidence, proof: Proof) -> list[dict[str, Any]]:
    """Entries of all effects that were fitted, those of the leader first."""
    entries: list[dict[str, Any]] = []
    told: set[str] = set()
    for explanation in (*filter(None, [judged.leader]), *judged.rivals, *judged.ranked):
        for candidate in explanation.candidates:
            if candidate.effect not in told:
                told.add(candidate.effect)
                accepted = explanation is judged.leader and judged.verdict == "named"
                entry = _entry(judged, explanation, candidate, evidence, proof)
                entries.append(entry | {"accepted": accepted})
    return entries


def _parts(effects: Sequence[Mapping[str, Any]], answer_set: Sequence[str]) -> list[dict[str, str]]:
    """What of the car, its road or its sensors the effects of the answer act on, where on it and in which form."""
    return [
        {"effect": e["id"], "acts_on": EVERY[e["id"]].acts_on(), **{key: e[key] for key in PLACES if key in e}}
        for e in effects
        if e["id"] in answer_set
    ]


def _entry(
    judged: Judged, explanation: Explanation, candidate: Candidate, evidence: Evidence, proof: Proof
) -> dict[str, Any]:
    parameters, along = [], []
    for knob in candidate.knobs:
        value = explanation.sizes[knob.name]
        size = {"value": value, "interval_90": list(interval(value, explanation.deviations[knob.name]))}
        if knob.place:
            along.append(_place(evidence, knob.place[1]) | size)
        else:
            parameters.append({"name": knob.name.rsplit(".", 1)[-1], "unit": knob.unit} | size)
    entry: dict[str, Any] = {"id": candidate.effect, "sentence": _in_words(explanation, candidate)}
    place = candidate.where
    kinds = {**dict.fromkeys(WHEELS, "wheel"), **dict.fromkeys(AXLES, "axle")}
    if place in kinds:
        entry[kinds[place]] = place
    elif candidate.knobs[0].form:
        entry["form"] = candidate.knobs[0].form
    elif place in EVERY[candidate.effect].model_fields:
        entry[EVERY[candidate.effect].each] = place
    if along:
        entry["profile"] = along
    return entry | {
        "parameters": parameters, "gain_training": explanation.gain, "gain_left_out": explanation.left_out_share,
        "gain_held_out": proof.gain(explanation), "adds_to_best": judged.adds(explanation), "keep": explanation.keep,
        "confidence": judged.confidence(explanation, candidate.effect),
        "objection": judged.refused.get(id(explanation), ""),
    }  # fmt: skip


def _place(evidence: Evidence, abscissa: float) -> dict[str, Any]:
    """Distance along a stretch of road [m], and where that is, if it is known."""
    where = [abscissa // STRETCH, abscissa % STRETCH - STRETCH / 2]
    if (at := evidence.road.place(abscissa)) is not None:
        where += [*evidence.on_map.latitude_longitude(*at[:2]), at[2]]
    return dict(zip(PLACE, where, strict=False))


def _located(residuals: Residuals, base: Fit, proof: Proof) -> dict[str, Any]:
    by_signal = residuals.by_signal(base.residuals)
    units = {signal.name: signal.unit for signal in SIGNALS}
    worst = sorted(by_signal, key=lambda name: by_signal[name] / residuals.deviation[name], reverse=True)
    whole = max(cost(base.residuals), 1e-12)
    windows = residuals.predictor.evidence.windows
    segments = [
        {"recording": w.name, "begin": w.begin, "end": w.end, "share": float(r @ r) / whole}
        for w, r in zip(windows, base.residuals, strict=True)
    ]
    return {
        "signals": [
            {"name": n, "unit": units[n], "before": by_signal[n], "null": residuals.deviation[n]} for n in worst
        ],
        "segments": sorted(segments, key=lambda s: s["share"], reverse=True),
        "lost": [{"recording": w.name, "begin": w.begin, "end": w.end} for w in residuals.predictor.evidence.left_out],
        "region": _region(*_most_off(residuals, base, proof)),
    }


def _force(judged: Judged) -> dict[str, Any] | None:
    """The force that describes what is left over, where that was asked and is proven."""
    if judged.verdict != "unknown" or judged.leader is None:
        return None
    (term,) = judged.leader.candidates
    sizes = [
        {"name": knob.name.rsplit(".", 1)[-1], "unit": knob.unit, "value": judged.leader.sizes[knob.name]}
        for knob in term.knobs
    ]
    return {
        "description": _in_words(judged.leader, term), "sizes": sizes, "lever_arm": _lever_arm(judged.leader),
        "gain": judged.leader.gain,
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


def _base(base: Fit, explained: Fit | None) -> dict[str, Any]:
    """Amounts of the base parameters, in the fit without what was found and in that with it."""
    pairs = zip(explained.knobs, explained.amounts, strict=True) if explained is not None else ()
    after = {knob.name: float(amount) for knob, amount in pairs}
    return {
        knob.name: {"unit": knob.unit, "value": float(amount), "explained": after.get(knob.name)}
        for knob, amount in zip(base.knobs, base.amounts, strict=True)
    }


def _errors(residuals: Residuals, base: Fit, shown: Fit, proof: Proof) -> dict[str, Any]:
    units = {signal.name: signal.unit for signal in SIGNALS}
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


def _sentence(found: Mapping[str, Any], rivals: Sequence[Sequence[str]]) -> str:
    """The answer in words; `rivals` are the ids of what cannot be told apart."""
    if found["verdict"] == "no_mismatch":
        return "Model and recordings agree once mass, tyres and the like are fitted: there is nothing to find here."
    if found["verdict"] == "unknown":
        where = found["located"]["region"]
        if force := found["located"]["force"]:
            described = (
                f". It is described by {force['description']}, with which the squared error falls by "
                f"{100 * force['gain']:.0f} %"
            )
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
    said = (
        f"The model leaves out {named}; with it the squared error falls by {100 * accepted[0]['gain_training']:.0f} %"
    )
    if ALONE in found["remarks"]:
        return f"{said}; nothing was left out of the fit to prove it on."
    proven, on = accepted[0]["gain_held_out"], "on recordings it was not fitted to"
    if proven is None:
        proven, on = accepted[0]["gain_left_out"], "where it was left out of the fit"
    return f"{said}, and by {100 * proven:.0f} % {on}."


def _traces(residuals: Residuals, base: Fit, shown: Fit, held_out: bool) -> list[Trace]:
    predictor = residuals.predictor
    units = {signal.name: signal.unit for signal in SIGNALS}
    pairs = zip(
        predictor.evidence.windows, predictor.measured, predictor.simulated(base.setting),
        predictor.simulated(shown.setting), strict=True,
    )  # fmt: skip
    return [
        Trace(window.name, i, held_out, name, units[name], grid(window), measured[name], before[name], after[name])
        for i, (window, measured, before, after) in enumerate(pairs)
        for name in measured
        if name in before and name in after
    ]


def _extended(vehicle: Vehicle, evidence: Evidence, setting: Setting) -> Vehicle:
    """The vehicle with what was fitted: base parameters, and the effects that have a size."""
    effects: dict[str, dict[str, Any]] = {}
    for id, kind in EVERY.items():
        names = {name: f"effects.{id}.{name}" for name in kind.model_fields}
        values: dict[str, Any] = {name: setting.values[d] for name, d in names.items() if d in setting.values}
        if profile := _profile(vehicle, evidence, setting, id):
            values["profile"] = profile
        if any(value != kind.model_fields[name].default for name, value in values.items()):
            effects[id] = values
    known = vehicle.values()
    changes = {name: value for name, value in setting.values.items() if name in known}
    physics = vehicle.with_parameters(changes).physics.model_dump()
    physics["effects"] = effects
    return vehicle.model_copy(
        update={
            "name": f"{vehicle.name}, extended",
            "physics": type(vehicle.physics).model_validate(physics),
        }
    )


def _profile(vehicle: Vehicle, evidence: Evidence, setting: Setting, id: str) -> tuple[tuple[float, ...], ...]:
    """Rows of `RoadEffect.profile`: what the file has, and what was fitted beyond it."""
    fitted = {}
    for name, value in setting.values.items():
        size, abscissa = place_of(name) or ("", 0.0)
        if size.startswith(f"effects.{id}."):
            fitted[abscissa] = value
    rows = getattr(getattr(vehicle.physics.effects, id), "profile", ())
    if not fitted:
        return rows
    known = list(zip(rows, abscissae(rows, evidence), strict=True))
    surveyed = {at: row[-1] for row, at in known if at is not None}
    found = [(*row[:3], row[3] + (_at(fitted, at) if at is not None else 0.0)) for row, at in known]
    for abscissa, value in fitted.items():
        if (at := evidence.road.place(abscissa)) is not None:
            place = *evidence.on_map.latitude_longitude(*at[:2]), at[2]
            found.append((*place, value + _at(surveyed, abscissa)))
    return tuple(found)


def _at(points: Mapping[float, float], abscissa: float) -> float:
    return float(profile(points, np.array([abscissa]))[0]) if points else 0.0
