"""From recordings and a vehicle file to what the model leaves out: gate, refit, locate, screen, name, prove.

The answer is one of: `named`, one effect explains what was left over, on recordings it was not fitted to as well;
`ambiguous`, several do about equally; `unknown`, something is left over and nothing in the library explains it;
`no_mismatch`; `not_assessable`, with the reason.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.mismatch.evidence import Evidence, gather
from vsense_ros.mismatch.fit import DivergedError, Fit, Residuals, cost, fit
from vsense_ros.mismatch.gate import hindrance
from vsense_ros.mismatch.knobs import BASE, Candidate, candidates, out_of_reach
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.prediction import Predictor, Setting
from vsense_ros.mismatch.report import shown_value, write_report
from vsense_ros.mismatch.search import Explanation, explain, screen
from vsense_ros.mismatch.signals import SIGNALS, grid
from vsense_ros.model.effects import BY_ID
from vsense_ros.model.effects.base import AXLES, WHEELS
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.recording import Recording
from vsense_ros.vehicle_file import save_vehicle

Array = NDArray[np.float64]

THRESHOLD = 0.03  # relative gain that chance does not give, from a study of the method; not calibrated on this one yet
# Another effect stays in the answer set with this share of the best one's gain, if it leaves no more of the cost than
# this multiple of what the best one leaves; and the best one is not named where another is closer still.
RIVAL, RIVAL_LEFT = 0.85, 1.5
CLOSE, CLOSE_LEFT = 0.9, 1.25
# Root mean square of the residuals, in deviations, that says that something is left over; after an effect has been
# fitted it says that this effect is not what the model lacks, or not all of it.
LEFT_OVER = 2.0
STAGES = len(BASE) * 3 + 70  # steps of the progress, about


@dataclass(frozen=True)
class Answer:
    """The content of explain.json, and what else a report shows."""

    found: dict[str, Any]
    traces: list[Trace] = field(default_factory=list)
    extended: Vehicle | None = None

    def write(self, folder: Path) -> None:
        """explain.json, report.html, and vehicle.extended.yaml where something is named."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "explain.json").write_text(json.dumps(self.found, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        write_report(self.found, self.traces, folder / "report.html")
        if self.extended is not None:
            save_vehicle(folder / "vehicle.extended.yaml", self.extended)


def answer(
    recordings: Sequence[Recording],
    vehicle: Vehicle,
    held_out: Sequence[Recording] = (),
    assume: Sequence[str] = (),
    progress: Callable[[], None] = lambda: None,
) -> Answer:
    """What the model of `vehicle` leaves out on `recordings`, proven on `held_out` where there are any.

    With `assume` the effects of these ids are fitted, without a search. Raises `InputError` for an unknown id.
    """
    if unknown := [name for name in assume if name not in BY_ID]:
        raise InputError(f"no effect {', '.join(unknown)}; the library has {', '.join(sorted(BY_ID))}")
    begun = time.process_time()
    evidence, unseen = gather(recordings, vehicle), gather(held_out, vehicle)
    found: dict[str, Any] = {
        "verdict": "not_assessable", "sentence": "", "vehicle": vehicle.name,
        "recordings": [r.name for r in recordings], "held_out": [r.name for r in held_out],
        "remarks": list(evidence.remarks), "located": {"signals": [], "segments": [], "region": None, "force": None},
        "effects": [], "out_of_reach": [], "answer_set": [], "would_separate": None, "fit": {}, "base": {},
        "threshold": THRESHOLD,
    }  # fmt: skip

    def nothing_said(reason: str) -> Answer:
        found["sentence"] = f"Nothing can be said: {reason}."
        found["cpu_s"] = time.process_time() - begun
        return Answer(found)

    if reason := hindrance([*recordings, *held_out], evidence, unseen, vehicle):
        return nothing_said(reason)
    beyond = out_of_reach({evidence.sensors[name].kind for w in evidence.windows for name in w.readings})
    if lacking := [f"{id}: {beyond[id]}" for id in assume if id in beyond]:
        return nothing_said("; ".join(lacking))
    predictor = Predictor(vehicle, evidence)
    residuals = Residuals(predictor)
    try:
        base = fit(residuals, predictor.start, BASE, progress=progress)
    except DivergedError:
        return nothing_said(
            "the car of the vehicle file leaves the road when it is driven with the recorded inputs; is it the file "
            "of this car?"
        )
    offered = (_together(assume),) if assume else tuple(c for c in candidates() if c.effect not in beyond)
    signatures = screen(residuals, base, offered, progress)
    traceless = {c.effect for c in offered} - {s.candidate.effect for s in signatures}
    beyond |= dict.fromkeys(sorted(traceless), "nothing that was recorded depends on it")
    found["out_of_reach"] = [{"id": id, "reason": reason} for id, reason in beyond.items()]
    if not signatures:
        return nothing_said("no effect of the library would leave a trace in these recordings")
    explanations = explain(residuals, predictor.start, base, signatures, progress)
    proof = _Proof(unseen, vehicle, residuals, base)
    found["remarks"] += proof.remarks
    found["held_out"] = proof.recordings
    best = _ranked(explanations)
    seen = {id(e): proof.gain(e) for e in best}
    proven = {id(e): min(e.gain, e.left_out if (g := seen[id(e)]) is None else g) for e in best}
    best.sort(key=lambda e: proven[id(e)], reverse=True)
    level = residuals.level(base.residuals)
    accepted = [
        e
        for e in best
        if min(e.score, proven[id(e)]) > THRESHOLD
        and e.improved > 0.5
        and residuals.level(e.fit.residuals) < LEFT_OVER
        and proof.mends_the_worst(e)
    ]
    if assume:
        accepted = best[:1]
    leader = accepted[0] if accepted else None

    def beside_the_leader(share: float, left: float) -> list[Explanation]:
        if leader is None:
            return []
        most = proven[id(leader)]
        return [e for e in accepted if proven[id(e)] >= share * most and 1 - proven[id(e)] <= left * (1 - most)]

    rivals = beside_the_leader(RIVAL, RIVAL_LEFT)
    close = len(beside_the_leader(CLOSE, CLOSE_LEFT)) > 1
    if leader is not None:
        verdict = "ambiguous" if close else "named"
    else:
        verdict = "unknown" if level > LEFT_OVER else "no_mismatch"
    shown = leader.fit if leader is not None else base
    found |= {
        "verdict": verdict,
        "located": _located(residuals, base),
        "effects": [
            entry for e in best for entry in _entries(e, seen[id(e)], accepted=e is leader and verdict == "named")
        ],
        "answer_set": list(dict.fromkeys(e.candidate.effect for e in rivals)),
        "would_separate": _separating(residuals, rivals) if close else None,
        "fit": _errors(residuals, base, shown, proof),
        "base": {k.name: {"unit": k.unit, "value": float(a)} for k, a in zip(BASE, base.amounts, strict=True)},
        "misfit": level,
    }
    found["sentence"] = _sentence(verdict, found, leader)
    found["cpu_s"] = time.process_time() - begun
    traces = _traces(residuals, base, shown, False) + proof.traces(shown)
    extended = _extended(vehicle, shown.setting) if verdict == "named" else None
    return Answer(found, traces, extended)


class _Proof:
    """Recordings that no fit has seen."""

    def __init__(self, evidence: Evidence, vehicle: Vehicle, residuals: Residuals, base: Fit) -> None:
        self.residuals: Residuals | None = None
        self.base, self.fitted = base, residuals
        self.remarks = evidence.remarks
        self.recordings = [windows[0].name for windows in evidence.by_recording()]  # that prove something
        self._after: dict[int, list[Array] | None] = {}
        if evidence.windows:
            self.residuals = Residuals(Predictor(vehicle, evidence))
            self.residuals.deviation |= residuals.deviation
            self.before = self.residuals(base.setting)

    def _with(self, explanation: Explanation) -> list[Array] | None:
        """Residuals with an effect, simulated once; None where it leaves all bounds."""
        assert self.residuals is not None
        if id(explanation) not in self._after:
            try:
                self._after[id(explanation)] = self.residuals(explanation.fit.setting)
            except DivergedError:
                self._after[id(explanation)] = None
        return self._after[id(explanation)]

    def gain(self, explanation: Explanation) -> float | None:
        """Relative fall of the cost, -1 where the simulation leaves all bounds; None without held-out recordings."""
        if self.residuals is None:
            return None
        after = self._with(explanation)
        return -1.0 if after is None else 1 - cost(after) / cost(self.before)

    def mends_the_worst(self, explanation: Explanation) -> bool:
        """Whether the signal that is furthest from a good model comes closer, on what the fit has not seen if there is
        any."""
        residuals, before = self.fitted, self.base.residuals
        after: list[Array] | None = explanation.fit.residuals
        if self.residuals is not None:
            residuals, before, after = self.residuals, self.before, self._with(explanation)
        if after is None:
            return False
        errors, left = residuals.by_signal(before), residuals.by_signal(after)
        worst = max(errors, key=lambda name: errors[name] / residuals.deviation[name])
        return left[worst] < errors[worst]

    def traces(self, shown: Fit) -> list[Trace]:
        return [] if self.residuals is None else _traces(self.residuals, self.base, shown, True)


def _together(ids: Sequence[str]) -> Candidate:
    every = {c.name: c for c in candidates()}
    knobs = {k.name: k for c in every.values() if c.effect in ids for k in c.knobs}
    return Candidate("+".join(ids), "", tuple(knobs.values()))


def _ranked(explanations: Sequence[Explanation]) -> list[Explanation]:
    """The best place of each effect, best effect first."""
    best: dict[str, Explanation] = {}
    for explanation in explanations:
        best.setdefault(explanation.candidate.effect, explanation)
    return list(best.values())


def _entries(explanation: Explanation, held_out: float | None, accepted: bool) -> list[dict[str, Any]]:
    """One entry of `effects` for each effect of an explanation: one, unless several were assumed."""
    result = []
    for id in explanation.candidate.effect.split("+"):
        parameters = []
        for (dotted, value), deviation in zip(explanation.sizes.items(), explanation.deviations, strict=True):
            _, effect, name = dotted.split(".")
            if effect != id:
                continue
            knob = next(k for k in explanation.candidate.knobs if k.name == dotted)
            interval = [value - 1.645 * deviation, value + 1.645 * deviation]
            parameters.append({"name": name, "unit": knob.unit, "value": value, "interval_90": interval})
        entry: dict[str, Any] = {"id": id, "sentence": BY_ID[id].sentence}
        place = explanation.candidate.where
        kinds = {**dict.fromkeys(WHEELS, "wheel"), **dict.fromkeys(AXLES, "axle")}
        if place in kinds:
            entry[kinds[place]] = place
        elif place and " and " not in place:
            entry["sensor" if id == "sensor_delay" else "axis"] = place
        entry |= {
            "parameters": parameters, "gain_training": explanation.gain, "gain_left_out": explanation.left_out,
            "gain_held_out": held_out, "keep": explanation.keep, "accepted": accepted,
            "confidence": max(0.0, explanation.score) / (max(0.0, explanation.score) + THRESHOLD),
        }  # fmt: skip
        result.append(entry)
    return result


def _separating(residuals: Residuals, rivals: Sequence[Explanation]) -> dict[str, str]:
    """A manoeuvre that shows the first answer rather than the second, and the signal in which the two differ most in
    the present recordings."""
    first, second = rivals[0], next(e for e in rivals if e.candidate.effect != rivals[0].candidate.effect)
    ways = [
        w for w in BY_ID[first.candidate.effect].excited_by if w not in BY_ID[second.candidate.effect].excited_by
    ] or list(BY_ID[first.candidate.effect].excited_by)
    apart = residuals.by_signal([a - b for a, b in zip(first.fit.residuals, second.fit.residuals, strict=True)])
    return {"manoeuvre": ways[0], "signal": max(apart, key=lambda name: apart[name] / residuals.deviation[name])}


def _located(residuals: Residuals, base: Fit) -> dict[str, Any]:
    by_signal = residuals.by_signal(base.residuals)
    units = {signal.name: signal.unit for signal in SIGNALS}
    worst = sorted(by_signal, key=lambda name: by_signal[name] / residuals.deviation[name], reverse=True)
    whole = max(base.cost, 1e-12)
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
        "region": _region(residuals, base, worst[0]) if worst else None,
        "force": None,
    }


def _region(residuals: Residuals, base: Fit, signal: str) -> dict[str, Any] | None:
    """Where the residual of a signal is large: what it goes along with, of what is measured itself."""
    size: list[Array] = []
    features: dict[str, list[Array]] = {"speed": [], "lateral_acceleration": [], "longitudinal_acceleration": []}
    for measured, rows, names in zip(residuals.predictor.measured, base.residuals, residuals.layout, strict=True):
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
    text = f"the error of the {signal.replace('_', ' ')} {way} with the {word}"
    if abs(found[strongest]) < 0.3:
        text = f"the error of the {signal.replace('_', ' ')} is about the same everywhere"
    return {"description": text, "correlation": found}


def _errors(residuals: Residuals, base: Fit, shown: Fit, proof: _Proof) -> dict[str, Any]:
    units = {signal.name: signal.unit for signal in SIGNALS}
    before, after = residuals.by_signal(base.residuals), residuals.by_signal(shown.residuals)
    result: dict[str, Any] = {
        name: {"unit": units[name], "training": {"before": before[name], "after": after[name]}} for name in before
    }
    if proof.residuals is not None:
        before, after = (proof.residuals.by_signal(r) for r in (proof.before, proof.residuals(shown.setting)))
        for name in before:
            if name in result:
                result[name]["held_out"] = {"before": before[name], "after": after[name]}
    return result


def _sentence(verdict: str, found: Mapping[str, Any], leader: Explanation | None) -> str:
    if verdict == "no_mismatch":
        return "Model and recordings agree once mass, tyres and the like are fitted: there is nothing to find here."
    if verdict == "unknown":
        where = found["located"]["region"]
        described = f": {where['description']}" if where else ""
        return f"Something is left over that no effect of the library explains{described}."
    assert leader is not None
    effect = found["effects"][0]
    size = ", ".join(f"{p['name']} {shown_value(p['value'], p['unit'])}" for p in effect["parameters"])
    if verdict == "ambiguous":
        names = " or ".join(BY_ID[id].sentence for id in found["answer_set"])
        return f"These recordings cannot tell which it is: {names}."
    proven, on = effect["gain_held_out"], "on recordings it was not fitted to"
    if proven is None:
        proven, on = effect["gain_left_out"], "where it was left out of the fit"
    return (
        f"The model leaves out {effect['sentence']} ({size}); with it the squared error falls by "
        f"{100 * effect['gain_training']:.0f} %, and by {100 * proven:.0f} % {on}."
    )


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


def _extended(vehicle: Vehicle, setting: Setting) -> Vehicle:
    """The vehicle with what was fitted: base parameters, and the effects that have a size."""
    effects: dict[str, dict[str, float]] = {}
    for id, kind in BY_ID.items():
        values = {name: setting.values[f"effects.{id}.{name}"] for name in kind.model_fields}
        if any(
            value != field.default for value, field in zip(values.values(), kind.model_fields.values(), strict=True)
        ):
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
