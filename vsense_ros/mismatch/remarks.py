"""What a reader has to know of an answer besides it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from vsense_ros.identification.least_squares import Fit
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged
from vsense_ros.model.effects import BY_ID, EVERY

NO_PLACE = "its profile along the road is given by the distance driven, as no sensor measures the position"
IN_FILES = "the extended vehicle file has its constant part, and road.csv the profile"  # written where one is named
OWN_ROAD = (
    "the held-out recordings are from another road, whose profile no fit can know: each piece of 50 m of it is "
    "compared with what follows from its neighbours, with the car as it was fitted"
)
ALONE = (
    "all recordings are one stretch of driving: the folds of the cross-validation are parts of it, which were driven "
    "like the others; add another recording, or hold one out"
)
NO_COURSE = "no sensor measures the heading on the map: directions are counted as if each recording set out to the east"


@dataclass(frozen=True)
class Evidence:
    """What an answer rests on.

    `shown` is the fit that it shows, `kinds` are those of the sensors that gave measurements, `beyond` the effects that
    lack a sensor, with the reason. `varying` is the signal that stays off with one size for all of the road, where the
    answer has one all the same.
    """

    validation: Validation
    shown: Fit
    kinds: Collection[str]
    beyond: Mapping[str, str]
    varying: str = ""


def remarks(judged: Judged, evidence: Evidence) -> list[str]:
    """Remarks on an answer, in the order in which they are shown."""
    leader, validation = judged.leader, evidence.validation
    return [
        *validation.comparisons.lost(evidence.shown),
        *_on_validation(judged, evidence),
        *(() if leader is None else _on_leader(leader, judged, evidence)),
        *_on_what_else(judged),
    ]


def _on_validation(judged: Judged, evidence: Evidence) -> Iterator[str]:
    leader, validation = judged.leader, evidence.validation
    if evidence.varying:
        yield (
            f"with one size for all of the road the {evidence.varying.replace('_', ' ')} stays off, with another at "
            "every place it does not; too few places were passed twice to determine the profile"
        )
    if leader is not None and (against := validation.against(leader)):
        yield against
    if judged.verdict == "no_mismatch" and validation.fits_together:
        yield (
            "the held-out recordings are far off for the base parameters that fit the rest best, but not for ones that "
            "fit all of it: that is no sign of missing physics"
        )


def _on_leader(leader: Hypothesis, judged: Judged, evidence: Evidence) -> Iterator[str]:
    if judged.verdict != "unknown":
        # Where wheel torques are unknown the simulated car follows its wheel speeds, whatever resists them: what an
        # accelerometer shows is then no effect that needs wheel torques.
        unlike = {"wheel_torques"} if "imu" in evidence.kinds else set()
        for id, reason in evidence.beyond.items():
            if set(BY_ID[id].mistaken_for) & set(leader.effects) and set(BY_ID[id].needs) - {*evidence.kinds, *unlike}:
                yield f"{BY_ID[id].sentence} may look the same and is not excluded: {reason}"
    if "gnss_velocity" not in evidence.kinds and any(EVERY[id].on_map for id in leader.effects):
        yield NO_COURSE
    if any(c.along_road for c in leader.candidates) and "gnss_position" not in evidence.kinds:
        yield NO_PLACE if judged.verdict == "ambiguous" else f"{NO_PLACE}: {IN_FILES}"
    if evidence.validation.comparisons.by_pieces(leader.fit):
        yield OWN_ROAD


def _on_what_else(judged: Judged) -> Iterator[str]:
    if judged.leader is not None and (elsewhere := judged.other_places()):
        place = judged.leader.candidates[0].where
        yield f"where it is, is not sure: {' or '.join(elsewhere)} explains about as much as {place}"
    if judged.besides:
        choices = " or ".join(BY_ID[id].sentence for id in judged.besides)
        yield f"there is a smaller effect besides, and the recordings cannot distinguish between {choices}"
