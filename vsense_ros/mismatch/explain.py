"""From recordings and a vehicle file to what the model leaves out.

The recordings are checked, the base parameters fitted, and the effects of the library fitted besides: alone, then
several at once. The verdict rests on what was left out of the fit.

The answer is one of: `named`, an effect, or several at once, explain what was left over, on recordings they were not
fitted to as well; `ambiguous`, several explain it about equally well; `unknown`, something is left over and nothing in
the library explains it; `no_mismatch`; `not_assessable`, with the reason.
"""

from __future__ import annotations

import csv
import itertools
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from vsense_ros.checks.correcting import mended
from vsense_ros.errors import InputError
from vsense_ros.evaluate.printable import Printable
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.identification.least_squares import DivergedError, Fit
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch import answer as entries
from vsense_ros.mismatch.answer_schema import VERSION, Answer, EffectEntry, Located, OutOfReach
from vsense_ros.mismatch.answer_sentence import conditions, sentence
from vsense_ros.mismatch.beforehand import Beforehand, not_proven
from vsense_ros.mismatch.candidates import BASE, Candidate, base_parameters, candidates, out_of_reach
from vsense_ros.mismatch.comparable import NotAssessableError, comparable
from vsense_ros.mismatch.data_quality import faults_in_words, faults_of, misfit, steps_in_words
from vsense_ros.mismatch.design import NEXT
from vsense_ros.mismatch.extension import extended
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.judging import describing, judged_with_further, with_final_sizes
from vsense_ros.mismatch.located import located, remainder
from vsense_ros.mismatch.observed import comparison
from vsense_ros.mismatch.onset import Onset, onset
from vsense_ros.mismatch.page import PAGE, write_report
from vsense_ros.mismatch.picture import Trace
from vsense_ros.mismatch.remarks import ALONE, Evidence, remarks
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.selection import most_telling
from vsense_ros.mismatch.short_windows import Restarts
from vsense_ros.mismatch.stand_ins import what_looks_alike
from vsense_ros.mismatch.terminal import printed
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged, judge
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.mismatch.words import ended
from vsense_ros.model.effects import BY_ID
from vsense_ros.model.vehicle import Vehicle

if TYPE_CHECKING:
    from rich.console import Console

ABLATIONS = ("no_refit", "no_projection", "chi2_thresholds")
# [s] of driving that is fitted at most, and as much that it is proven on: more of it takes hours and shows little more.
LONGEST_FITTED = 900.0
STAGES = len(BASE) * 3 + 70  # steps of the progress that take about half of the time
EXTENDED, ROAD = "vehicle.extended.yaml", "road.csv"
TRACELESS = "nothing that was recorded depends on it"
# Of a place on the road: number of its stretch, metres along it, degrees, radians counter-clockwise from east.
PLACE = ("stretch", "distance", "latitude", "longitude", "direction")
NOWHERE = Located(signals=(), segments=(), lost=(), region=None, force=None, parts=())


@dataclass(frozen=True, repr=False)
class Explanation(Printable):
    """An answer, and what else a report shows."""

    answer: Answer
    traces: list[Trace] = field(default_factory=list)
    extended: Vehicle | None = None

    @property
    def title(self) -> str:
        """The answer in words."""
        return f"{self.answer.vehicle}: {self.answer.sentence}"

    def show(self, out: Console) -> None:
        """Print the answer, what was tried, and how well the model fits before and after."""
        printed(self.answer, out)

    def write(self, folder: Path) -> None:
        """explain.json, report.html, where something is named vehicle.extended.yaml, and road.csv where that changes
        along the road."""
        folder.mkdir(parents=True, exist_ok=True)
        for earlier in (EXTENDED, ROAD, NEXT):
            (folder / earlier).unlink(missing_ok=True)
        self.answer.write(folder)
        write_report(self.answer, self.traces, folder / PAGE)
        if self.extended is not None:
            save_vehicle(folder / EXTENDED, self.extended)
            self._write_road(folder / ROAD)

    def _write_road(self, path: Path) -> None:
        """A row for each place and effect of the road that was named."""
        rows = [
            (effect.id, size.unit, *(getattr(point, key) for key in PLACE), size.value + point.value)
            for effect in self.answer.accepted
            for size in effect.parameters[:1]
            for point in effect.profile or ()
        ]
        if rows:
            with atomic_write(path) as file:
                csv.writer(file).writerows([("effect", "unit", *PLACE, "value"), *rows])


def stepwise(progress: Callable[[float], None]) -> Callable[[], None]:
    """A function that is called at each step, and tells `progress` the share that is done. How many steps there will be
    is not known: the share comes near 1 and does not reach it."""
    steps = itertools.count(1)

    def step() -> None:
        done = next(steps)
        progress(done / (done + STAGES))

    return step


def explain_recordings(
    recordings: Sequence[Recording],
    vehicle: Vehicle,
    held_out: Sequence[Recording] = (),
    assume: Sequence[str] = (),
    ablation: str = "",
    progress: Callable[[], None] = lambda: None,
    *,
    mend: bool = False,
    observe: bool = False,
) -> Explanation:
    """What the model of `vehicle` leaves out on `recordings`, proven on `held_out` where there are any.

    With `assume` the effects of these ids are fitted, without a search; with one of `ABLATIONS` a part of the method is
    switched off, to see what it is worth. With `mend` signs, axes and units that cannot be right are mended; without it
    the answer says what would mend them. A signal that contradicts the others is left out of the comparison. With
    `observe` the observer is run with what was found, which determines whether it is better with it, and gives the
    extended vehicle noise levels that fit it. Which test would tell an ambiguous answer apart, `design` finds. Raises
    `InputError` for an unknown id or ablation.
    """
    if unknown := [name for name in assume if name not in BY_ID]:
        raise InputError(f"no effect {', '.join(unknown)}; the library has {', '.join(sorted(BY_ID))}")
    if ablation not in ("", *ABLATIONS):
        raise InputError(f"no ablation {ablation}; there are {', '.join(ABLATIONS)}")
    begun = time.process_time()
    faults = [faults_of(one, vehicle) for one in (*recordings, *held_out)]
    if mend:
        every = [mended(one, todo) for one, todo in zip((*recordings, *held_out), faults, strict=True)]
        recordings, held_out = every[: len(recordings)], every[len(recordings) :]
    mending = faults_in_words([*recordings, *held_out], faults)
    if not mend:
        mending = [f"{said} (--mend does it)" for said in mending]
    compared = comparable(recordings, held_out, vehicle)
    fitted, unseen = compared.fitted, compared.unseen
    in_steps = steps_in_words([*recordings, *held_out], vehicle)
    explainer = _Explainer(
        Answer(
            version=VERSION, verdict="not_assessable", sentence="", vehicle=vehicle.name,
            recordings=_names(recordings), held_out=_names(held_out), held_out_unused=(), by_pieces=False,
            remarks=(*mending, *in_steps, *fitted.remarks), located=NOWHERE, effects=(), out_of_reach=(),
            answer_set=(), rivals=(), would_separate=None, fit={}, base={}, threshold=THRESHOLDS.least_gain,
            driven_s=fitted.driven + unseen.driven, assumed=tuple(assume), ablation=ablation, cpu_s=0.0,
            recording_defects=(*mending, *in_steps),
        ),
        compared.vehicle,
        progress,
        compared.known,
        (compared.recordings, compared.held_out),
    )  # fmt: skip
    try:
        if reason := compared.refused:
            raise NotAssessableError("; ".join((reason, *mending)) if not mend else reason)
        explanation = explainer.explanation(most_telling(fitted, LONGEST_FITTED), most_telling(unseen, LONGEST_FITTED))
    except NotAssessableError as error:
        explanation = Explanation(explainer.answer.with_(sentence=_nothing_said(str(error))))
    if not compared.refused:
        beside = conditions(explanation.answer, compared.known, compared.left_out)
        answer = explanation.answer.with_(sentence=explanation.answer.sentence + beside)
        explanation = replace(explanation, answer=answer)
    if observe and explanation.extended is not None:
        explanation = _observed(explanation, compared.recordings, compared.held_out, fitted, vehicle, progress)
    return replace(explanation, answer=explanation.answer.with_(cpu_s=time.process_time() - begun))


def _nothing_said(reason: str) -> str:
    return ended(f"Nothing can be said: {reason}")


def _observed(
    explanation: Explanation, recordings: Sequence[Recording], held_out: Sequence[Recording], fitted: Dataset,
    vehicle: Vehicle, progress: Callable[[], None],
) -> Explanation:  # fmt: skip
    """What was found, with how the observer fares with it, and the noise levels that fit it."""
    assert explanation.extended is not None
    try:
        compared, tuned = comparison(recordings, held_out, fitted, vehicle, explanation.extended, progress)
    except (InputError, FloatingPointError) as error:
        remark = f"whether the observer is better with what was found is not known: {error}"
        return replace(explanation, answer=explanation.answer.with_(remarks=(*explanation.answer.remarks, remark)))
    return replace(explanation, answer=explanation.answer.with_(observer=compared), extended=tuned)


def _names(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """What remarks call them."""
    return tuple(recording.name or f"recording {i}" for i, recording in enumerate(recordings, start=1))


class _Explainer:
    """The way to an answer. `answer` holds what is known so far, and stands if it turns out on the way that nothing
    can be said."""

    def __init__(
        self, unanswered: Answer, vehicle: Vehicle, progress: Callable[[], None], known: Sequence[Beforehand],
        recordings: Sequence[Sequence[Recording]],
    ) -> None:  # fmt: skip
        """`vehicle` has the defects of its sensors that are `known` before any fit; `recordings` are those to fit to,
        and those that are held out."""
        self.answer, self.vehicle, self.progress, self.known = unanswered, vehicle, progress, known
        self.fitted_restarts, self.unseen_restarts = (Restarts(some, vehicle) for some in recordings)

    def explanation(self, dataset: Dataset, unseen: Dataset) -> Explanation:
        """The answer about recordings that can be assessed. Raises `NotAssessableError` where they cannot."""
        kinds = {dataset.sensors[name].kind for w in dataset.windows for name in w.readings}
        beyond = self._out_of_reach(kinds)
        search, hypotheses = self._searched(dataset, beyond, kinds)
        self._note_traceless(search, beyond)
        strange = misfit(search.base, search.residuals)  # unless what the model leaves out is the reason
        unseen = self.unseen_restarts.near_the_car(unseen, search.base.parameter_set)
        validation = Validation(unseen, self.vehicle, search.residuals, search.base, self.progress)
        self._note_validation(search.residuals, validation)
        judged, varying = with_final_sizes(search, self._judged(search, hypotheses, validation), validation)
        leader = judged.leader
        if strange and (leader is None or misfit(leader.fit, search.residuals)):
            return self._refused(strange, search, judged, validation)
        shown = leader.fit if leader is not None else search.base
        said = [*remarks(judged, Evidence(validation, shown, kinds, beyond, varying)), *not_proven(self.known)]
        alike, drive_next = what_looks_alike(search, judged)
        self.answer = self.answer.with_(remarks=(*self.answer.remarks, *said, *alike), drive_next=drive_next)
        before = self._before(search)
        self._answered(search, judged, validation, before, shown)
        traces = _traces(search, before, shown, validation)
        return Explanation(self.answer, traces, self._extended(search, judged, shown))

    def _before(self, search: Search) -> Fit:
        """The base fit as the vehicle file has the sensors, without the defects that were known beforehand; with them
        where a car that is driven by such sensors gets lost."""
        values, start = search.base.parameter_set.values, search.residuals.predictor.start.values
        of_file = {one.parameter: start[one.parameter] - one.value for one in self.known if one.parameter in values}
        if not of_file:
            return search.base
        without = search.base.parameter_set.changed(of_file)
        try:
            return replace(search.base, parameter_set=without, residuals=search.residuals(without))
        except DivergedError:
            return search.base

    def _refused(self, reason: str, search: Search, judged: Judged, validation: Validation) -> Explanation:
        """That nothing can be said, for a reason that the fit of the base parameters shows, with that fit."""
        residuals, base = search.residuals, search.base
        nothing = replace(judged, verdict="not_assessable", leader=None, rivals=())
        self.answer = self.answer.with_(
            sentence=_nothing_said(reason),
            located=located(residuals, base, nothing, validation, ()),
            fit=entries.errors(residuals, base, base, validation),
            base=entries.base_parameters(base, None),
            misfit=residuals.level(base.residuals),
        )
        return Explanation(self.answer, _traces(search, base, base, validation))

    def _out_of_reach(self, kinds: Collection[str]) -> dict[str, str]:
        """Effects that these kinds of sensors say nothing of, with the reason."""
        beyond = out_of_reach(kinds)
        if lacking := [f"{id}: {beyond[id]}" for id in self._assume if id in beyond]:
            raise NotAssessableError("; ".join(lacking))
        return beyond

    @property
    def _assume(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self.answer.assumed))

    def _note_traceless(self, search: Search, beyond: Mapping[str, str]) -> None:
        """Write down which effects cannot be assessed, for want of a sensor or because nothing depends on them."""
        traceless = {c.effect for c in search.offered} - search.visible
        reasons = {**beyond, **dict.fromkeys(sorted(traceless), TRACELESS)}
        self.answer = self.answer.with_(
            out_of_reach=tuple(OutOfReach(id=id, reason=reason) for id, reason in reasons.items())
        )
        if not search.visible:
            raise NotAssessableError("no effect of the library would leave a trace in these recordings")

    def _note_validation(self, residuals: Residuals, validation: Validation) -> None:
        """Write down on which recordings the answer is proven."""
        every = (*self.answer.remarks, *residuals.predictor.dataset.remarks, *validation.remarks)
        said = list(dict.fromkeys(every))
        if validation.residuals is None and len(residuals.layout) == 1:
            said.append(ALONE)
        self.answer = self.answer.with_(
            remarks=said,
            held_out_unused=tuple(name for name in self.answer.held_out if name not in validation.recordings),
            held_out=validation.recordings,
        )

    def _threshold(self, search: Search, validation: Validation) -> float:
        """The least gain of an effect on as much driving as there is."""
        if self.answer.ablation == "chi2_thresholds":
            return float(chi2.isf(0.05 / len(search.offered), 1)) / search.whole  # Bonferroni
        proving = validation.residuals.predictor.dataset.driven if validation.residuals is not None else 0.0
        return THRESHOLDS.least_gain_on(search.residuals.predictor.dataset.driven + proving)

    def _judged(self, search: Search, hypotheses: list[Hypothesis], validation: Validation) -> Judged:
        """The verdict; where effects are assumed, that they are there."""
        threshold = self._threshold(search, validation)
        self.answer = self.answer.with_(threshold=threshold)
        if not self._assume:
            return judged_with_further(search, hypotheses, validation, threshold)
        judged = judge(hypotheses, (), validation, search.with_profile, threshold)
        if not hypotheses:
            return judged
        return replace(judged, verdict="named", leader=hypotheses[0], rivals=(hypotheses[0],))

    def _answered(self, search: Search, judged: Judged, validation: Validation, before: Fit, shown: Fit) -> None:
        residuals, base, leader = search.residuals, search.base, judged.leader
        effects = tuple(entries.effect_entries(judged, residuals.predictor.dataset, validation))
        effects = entries.with_known(effects, self.known, shown, residuals, validation)
        begins = self._onset(search, judged)
        term = None  # without known physics, for the residual that defects known before any fit do not explain
        if judged.verdict == "unknown" and self._known_explains(effects):
            term, judged = leader, replace(judged, verdict="named", partial=True)
        answer = self.answer.with_(
            verdict="named" if self.known and judged.verdict == "no_mismatch" else judged.verdict,
            by_pieces=leader is not None and validation.comparisons.by_pieces(leader.fit),
            located=located(residuals, before, judged, validation, effects),
            effects=effects,
            answer_set=entries.answer_set(judged, self.known),
            rivals=entries.rivals(judged, self.known),
            evidence=entries.evidence(search),
            fit=entries.errors(residuals, before, shown, validation),
            base=entries.base_parameters(base, leader.fit if leader is not None else None),
            misfit=residuals.level(base.residuals),
            onset=entries.since(begins),
            remainder=remainder(residuals, shown, judged, term or describing(search, judged, validation), validation),
        )
        self.answer = answer.with_(sentence=sentence(answer))

    def _known_explains(self, effects: Sequence[EffectEntry]) -> bool:
        """True if defects of sensors that were known before any fit explain enough to be named where something more is
        left over."""
        known = {one.effect for one in self.known}
        return any(e.id in known and e.gain_training > THRESHOLDS.partial_gain for e in effects)

    def _onset(self, search: Search, judged: Judged) -> Onset | None:
        """What begins within recordings, where something is left over that nothing explains."""
        leader = judged.leader
        if judged.verdict == "unknown":
            return onset(search.residuals, search.base, search.trials(), 0.0 if leader is None else leader.gain)
        if judged.verdict == "named" and judged.partial and leader is not None:
            return onset(search.residuals, leader.fit, search.trials())
        return None

    def _extended(self, search: Search, judged: Judged, shown: Fit) -> Vehicle | None:
        """The vehicle file with what was found, where that is sure."""
        if (judged.leader is None and not self.known) or judged.verdict == "ambiguous":
            return None
        return extended(self.vehicle, search.residuals.predictor.dataset, shown.parameter_set)

    def _searched(
        self, dataset: Dataset, beyond: Collection[str], kinds: Collection[str]
    ) -> tuple[Search, list[Hypothesis]]:
        """The base parameters fitted, and single effects, or those to assume together, fitted besides; once more from
        other base parameters if an effect has shown that their fit had stopped short."""
        known = {(one.effect, one.field): one.deviation for one in self.known}
        free_parameters = (
            () if self.answer.ablation == "no_refit" else base_parameters(self.vehicle, beyond, kinds, known)
        )
        try:
            dataset, residuals, base = self.fitted_restarts.refitted(dataset, free_parameters, self.progress)
        except DivergedError:
            raise NotAssessableError(
                "the car of the vehicle file leaves the road when it is driven with the recorded inputs; is it the "
                "file of this car?"
            ) from None
        start = residuals.predictor.start
        library = candidates(dataset.points, start.values)
        assume = self._assume
        offered = tuple(c for c in library if c.effect not in beyond and (not assume or c.effect in assume))
        if self.answer.ablation == "no_projection":
            base, start = _without_parameters(base), base.parameter_set

        def fitted(search: Search) -> list[Hypothesis]:
            if assume:
                return [search.fitting.refined(e) for e in search.together([_all_of(id, library) for id in assume])]
            return search.proposed()

        search = Search(residuals, start, base, offered, self.progress)
        hypotheses = fitted(search)
        if (better := search.better_base(hypotheses)) is not None:
            search = Search(residuals, start, better, offered, self.progress)
            hypotheses = fitted(search)
        return search, hypotheses


def _without_parameters(base: Fit) -> Fit:
    """The fit with no parameter free any longer."""
    slopes = [np.zeros((len(rows), 0), np.float32) for rows in base.residuals]
    return replace(base, free_parameters=(), offsets=np.zeros(0), slopes=slopes)


def _traces(search: Search, before: Fit, shown: Fit, validation: Validation) -> list[Trace]:
    """The curves of all windows, held out or not."""
    residuals = search.residuals
    traces = entries.traces(residuals, before, residuals.predictor.simulated(shown.parameter_set), False)
    if validation.residuals is not None:
        traces += entries.traces(validation.residuals, before, validation.comparisons.simulated(shown), True)
    return traces


def _all_of(id: str, library: Sequence[Candidate]) -> Candidate:
    """An effect with all its sizes free, wherever on the car they are."""
    single = (c for c in library if c.effect == id and not c.along_road)
    free_parameters = {
        parameter.name: parameter for c in single for parameter in c.free_parameters if not parameter.form
    }
    return Candidate(id, "", tuple(free_parameters.values()), BY_ID[id].sentence)
