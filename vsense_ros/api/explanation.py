"""What the model of a car leaves out: what the command `vsense explain` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from vsense_ros.api.recording import Sources, read_all
from vsense_ros.api.vehicle import load_vehicle
from vsense_ros.messages.laps import laps
from vsense_ros.mismatch.explain import Explanation, explain_recordings, stepwise
from vsense_ros.model.vehicle import Vehicle


def explain(
    recordings: Sources,
    vehicle: str | Path | Vehicle,
    *,
    hold_out: Sources = (),
    assume: Sequence[str] = (),
    ablation: str = "",
    by_lap: bool = False,
    mend: bool = False,
    observe: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Explanation:
    """Name the physics that the model of a car leaves out on recordings.

        answer = vs.explain(["lap_1", "lap_2@0:120"], "genesis", hold_out=["lap_3"]).answer
        answer.verdict  # named, ambiguous, unknown, no_mismatch or not_assessable

    Args:
        recordings: a recording or path, as `read` takes it, or several.
        vehicle: the car as far as it is known; its uncertain parameters are fitted first.
        hold_out: one or several, on which the answer is proven.
        assume: effects to be fitted in place of a search.
        ablation: a part of the method to be left out for comparison: no_refit, no_projection, chi2_thresholds.
        by_lap: cut each recording into its laps, which are found by position.
        mend: correct signs, axes and units that cannot be right.
        observe: run the observer with the explained model, and fit its noise levels.
        progress: is called with the share done, 0 to 1.

    `extended` of the explanation is the vehicle with what was named, or None; `write(folder)` writes the report. Raises
    `InputError` as `read` and `load_vehicle` do, and for effects that are not known.
    """
    car = load_vehicle(vehicle)
    train, proof = read_all(recordings, hold_out)
    if by_lap:
        train, proof = (
            [lap for recording in recordings_of_kind for lap in laps(recording)]
            for recordings_of_kind in (train, proof)
        )
    return explain_recordings(
        train,
        car,
        proof,
        assume,
        ablation,
        stepwise(progress or (lambda share: None)),
        mend=mend,
        observe=observe,
    )
