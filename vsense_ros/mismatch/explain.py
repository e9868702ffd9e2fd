"""From recordings and a vehicle file to what the model leaves out: gate, refit, locate, screen, name, prove.

The answer is one of: `named`, one effect explains what was left over, on recordings it was not fitted to as well;
`ambiguous`, several do about equally; `unknown`, something is left over and nothing in the library explains it;
`no_mismatch`; `not_assessable`, with the reason.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.identify.free_parameter import FreeParameter
from vsense_ros.identify.least_squares import DivergedError, Fit, fit
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch import answer as entries
from vsense_ros.mismatch.candidates import BASE, Candidate, base_parameters, candidates, out_of_reach
from vsense_ros.mismatch.data_quality import hindrance, misfit
from vsense_ros.mismatch.design import ANSWER, NEXT
from vsense_ros.mismatch.extension import extended
from vsense_ros.mismatch.page import PAGE, write_report
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search import Hypothesis, Search
from vsense_ros.mismatch.selection import most_telling
from vsense_ros.mismatch.simulation import LOST, Predictor
from vsense_ros.mismatch.verdict import THRESHOLD, Judged, Proof, judge, least_gain
from vsense_ros.mismatch.windows import Dataset, build_dataset
from vsense_ros.model.effects import BY_ID
from vsense_ros.model.vehicle import Vehicle

ABLATIONS = ("no_refit", "no_projection", "chi2_thresholds")
# Of driving that is fitted, and of as much that it is proven on: more of the same takes hours and says little more.
LOOKED_AT = 900.0  # [s]
STAGES = len(BASE) * 3 + 70  # steps of the progress, about
EXTENDED, ROAD = "vehicle.extended.yaml", "road.csv"
NOTHING_TO_COMPARE = (
    "where the car drives and its inputs are known, nothing is measured that the model foretells; expected readings of "
    "an inertial sensor, wheel speeds or GNSS velocities throughout"
)
TRACELESS = "nothing that was recorded depends on it"


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
        with atomic_write(folder / ANSWER) as file:
            file.write(json.dumps(self.found, indent=1, allow_nan=False) + "\n")
        write_report(self.found, self.traces, folder / PAGE)
        if self.extended is not None:
            save_vehicle(folder / EXTENDED, self.extended)
            self._write_road(folder / ROAD)

    def _write_road(self, path: Path) -> None:
        """A row for each place and effect of the road that was named."""
        rows = [
            [effect["id"], effect["parameters"][0]["unit"], *(place.get(key, "") for key in entries.PLACE),
             effect["parameters"][0]["value"] + place["value"]]
            for effect in self.found["effects"] if effect["accepted"]
            for place in effect.get("profile", ())
        ]  # fmt: skip
        if rows:
            with atomic_write(path) as file:
                csv.writer(file).writerows([["effect", "unit", *entries.PLACE, "value"], *rows])


class NotAssessableError(Exception):
    """Nothing can be said of the recordings; the message tells why."""


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
    begun = time.process_time()
    dataset = build_dataset(recordings, vehicle)
    unseen = build_dataset(held_out, vehicle, dataset)
    found: dict[str, Any] = {
        "verdict": "not_assessable", "sentence": "", "vehicle": vehicle.name,
        "recordings": _names(recordings), "held_out": _names(held_out), "held_out_unused": [], "by_pieces": False,
        "remarks": list(dataset.remarks),
        "located": {"signals": [], "segments": [], "lost": [], "region": None, "force": None, "parts": []},
        "effects": [], "out_of_reach": [], "answer_set": [], "rivals": [], "would_separate": None, "fit": {},
        "base": {}, "threshold": THRESHOLD, "driven_s": dataset.driven + unseen.driven,
        "assumed": list(assume), "ablation": ablation,
    }  # fmt: skip
    try:
        if reason := hindrance([*recordings, *held_out], dataset, unseen, vehicle):
            raise NotAssessableError(reason)
        dataset, unseen = most_telling(dataset, LOOKED_AT), most_telling(unseen, LOOKED_AT)
        answered = _explained(found, vehicle, dataset, unseen, tuple(dict.fromkeys(assume)), ablation, progress)
    except NotAssessableError as error:
        found["sentence"] = f"Nothing can be said: {error}."
        answered = Answer(found)
    found["cpu_s"] = time.process_time() - begun
    return answered


def _names(recordings: Sequence[Recording]) -> list[str]:
    """What remarks call them."""
    return [recording.name or f"recording {i}" for i, recording in enumerate(recordings, start=1)]


def _explained(
    found: dict[str, Any], vehicle: Vehicle, dataset: Dataset, unseen: Dataset, assume: Sequence[str], ablation: str,
    progress: Callable[[], None],
) -> Answer:  # fmt: skip
    """The answer about data set that can be assessed, if it can; what is known of it by then is written to `found`."""
    kinds = {dataset.sensors[name].kind for w in dataset.windows for name in w.readings}
    beyond = out_of_reach(kinds)
    if lacking := [f"{id}: {beyond[id]}" for id in assume if id in beyond]:
        raise NotAssessableError("; ".join(lacking))
    search, hypotheses = _searched(vehicle, dataset, assume, ablation, beyond, kinds, progress)
    residuals, base = search.residuals, search.base
    strange = misfit(base, residuals)  # unless what the model leaves out is the reason
    traceless = {c.effect for c in search.offered} - search.visible
    found["out_of_reach"] = [
        {"id": id, "reason": reason}
        for id, reason in {**beyond, **dict.fromkeys(sorted(traceless), TRACELESS)}.items()
    ]  # fmt: skip
    if not search.visible:
        raise NotAssessableError("no effect of the library would leave a trace in these recordings")
    proof = Proof(unseen, vehicle, residuals, base, progress)
    found["remarks"] = [*residuals.predictor.dataset.remarks, *proof.remarks]
    if proof.residuals is None and len(residuals.layout) == 1:
        found["remarks"].append(entries.ALONE)
    found["held_out_unused"] = [name for name in found["held_out"] if name not in proof.recordings]
    found["held_out"] = proof.recordings
    proving = proof.residuals.predictor.dataset.driven if proof.residuals is not None else 0.0
    threshold = least_gain(residuals.predictor.dataset.driven + proving)
    if ablation == "chi2_thresholds":
        threshold = float(chi2.isf(0.05 / len(search.offered), 1)) / search.whole  # Bonferroni
    found["threshold"] = threshold
    if assume:
        judged = judge(hypotheses, (), proof, search.with_profile, threshold)
        if hypotheses:
            judged = replace(judged, verdict="named", leader=hypotheses[0], rivals=(hypotheses[0],))
    else:
        judged = _judged(search, hypotheses, proof, threshold)
    judged, varying = _with_final_sizes(search, judged, proof)
    leader, verdict = judged.leader, judged.verdict
    if strange and (leader is None or misfit(leader.fit, residuals)):
        raise NotAssessableError(strange)
    shown = leader.fit if leader is not None else base
    found["remarks"] += entries.remarks(judged, proof, shown, kinds, beyond, varying)
    dataset = residuals.predictor.dataset
    effects = entries.effect_entries(judged, dataset, proof)
    answer_set = list(dict.fromkeys(id for e in judged.rivals for id in e.effects))
    for effect in effects:
        effect |= {"answer_set": answer_set if effect["id"] in answer_set else [], "would_separate": None}
    found |= {
        "verdict": verdict,
        "by_pieces": leader is not None and proof.surveyed(leader.fit),
        "located": entries.located(residuals, base, proof)
        | {"force": entries.force(judged, proof), "parts": entries.parts(effects, answer_set)},
        "effects": effects,
        "answer_set": answer_set,
        "rivals": [list(effects) for effects in dict.fromkeys(e.effects for e in judged.rivals)],
        "fit": entries.errors(residuals, base, shown, proof),
        "base": entries.base_parameters(base, leader.fit if leader is not None else None),
        "misfit": residuals.level(base.residuals),
    }
    found["sentence"] = entries.sentence(found, [e.effects for e in judged.rivals])
    traces = entries.traces(residuals, base, residuals.predictor.simulated(shown.parameter_set), False)
    if proof.residuals is not None:
        traces += entries.traces(proof.residuals, base, proof.simulated(shown), True)
    sure = leader is not None and verdict != "ambiguous"
    return Answer(found, traces, extended(vehicle, dataset, shown.parameter_set) if sure else None)


def _searched(
    vehicle: Vehicle, dataset: Dataset, assume: Sequence[str], ablation: str, beyond: Collection[str],
    kinds: Collection[str], progress: Callable[[], None],
) -> tuple[Search, list[Hypothesis]]:  # fmt: skip
    """The base parameters fitted, and single effects, or those to `assume` together, fitted besides; once more from
    other base parameters if an effect has shown that their fit had stopped short."""
    try:
        free_parameters = () if ablation == "no_refit" else base_parameters(vehicle, beyond, kinds)
        dataset, residuals, base = _refitted(vehicle, dataset, free_parameters, progress)
    except DivergedError:
        raise NotAssessableError(
            "the car of the vehicle file leaves the road when it is driven with the recorded inputs; is it the file "
            "of this car?"
        ) from None
    start = residuals.predictor.start
    library = candidates(dataset.points, start.values)
    offered = tuple(c for c in library if c.effect not in beyond and (not assume or c.effect in assume))
    if ablation == "no_projection":
        base = replace(
            base, free_parameters=(), offsets=np.zeros(0), slopes=[np.zeros((len(r), 0)) for r in base.residuals]
        )
        start = base.parameter_set

    def fitted(search: Search) -> list[Hypothesis]:
        if assume:
            return [search.refined(e) for e in search.together([_all_of(id, library) for id in assume])]
        return search.single()

    search = Search(residuals, start, base, offered, progress)
    hypotheses = fitted(search)
    if (better := search.better_base(hypotheses)) is not None:
        search = Search(residuals, start, better, offered, progress)
        hypotheses = fitted(search)
    return search, hypotheses


def _judged(search: Search, hypotheses: list[Hypothesis], proof: Proof, threshold: float) -> Judged:
    """Single effects, and what explains more with further ones, judged beside terms without known physics."""
    found_last = hypotheses
    while found_last := search.further(found_last, max(threshold, THRESHOLD), proof.proven, bool(proof.recordings)):
        hypotheses = [*hypotheses, *found_last]
    described = search.described()
    judged = judge(hypotheses, described, proof, search.with_profile, threshold)
    if judged.in_doubt:
        united = search.joint(judged.in_doubt)
        judged = judge([*hypotheses, *united], described, proof, search.with_profile, threshold)
    return judged


def _with_final_sizes(search: Search, judged: Judged, proof: Proof) -> tuple[Judged, str]:
    """The same with the sizes of the leader hardly drawn to zero any longer, if it is then still proven, or another at
    every place of the road, if that lasts better; if it does not, but mends a signal, the name of that."""
    if judged.leader is None:
        return judged, ""
    off = proof.unmended(judged.leader)
    freed = search.with_profile(judged.leader) if off else None
    settled = search.unshrunk(judged.leader)
    if proof.lasting(settled) > 0:
        judged = judged.led_by(settled, proof)
    if freed is None or judged.leader is None:
        return judged, ""
    if proof.lasting(freed) > proof.lasting(judged.leader):
        return judged.led_by(freed, proof), ""
    return judged, off


def _refitted(
    vehicle: Vehicle, dataset: Dataset, free_parameters: Sequence[FreeParameter], progress: Callable[[], None]
) -> tuple[Dataset, Residuals, Fit]:
    """The base parameters fitted to the data set; to the rest of it where the simulated car is lost in some windows
    even when it is fitted to the others. Where it is lost in most of them, to all."""
    residuals = Residuals(Predictor(vehicle, dataset))
    if not any(residuals.layout):
        raise NotAssessableError(NOTHING_TO_COMPARE)
    base = fit(residuals, residuals.predictor.start, free_parameters, progress=progress)
    lost = residuals.predictor.lost(base.parameter_set)
    if not any(lost) or 2 * sum(lost) > len(lost):
        return dataset, residuals, base
    rest = dataset.without(lost, LOST)
    residuals_of_rest = Residuals(Predictor(vehicle, rest))
    fitted = fit(residuals_of_rest, residuals.predictor.start, free_parameters, begin=base.offsets, progress=progress)
    if not any(residuals.predictor.lost(fitted.parameter_set)):
        base = fit(residuals, residuals.predictor.start, free_parameters, begin=fitted.offsets, progress=progress)
        if not any(residuals.predictor.lost(base.parameter_set)):
            return dataset, residuals, base
    return rest, residuals_of_rest, fitted


def _all_of(id: str, library: Sequence[Candidate]) -> Candidate:
    """An effect with all its sizes free."""
    single = (c for c in library if c.effect == id and not c.along_road)
    free_parameters = {
        parameter.name: parameter for c in single for parameter in c.free_parameters if not parameter.form
    }
    return Candidate(id, "", tuple(free_parameters.values()), BY_ID[id].sentence)
