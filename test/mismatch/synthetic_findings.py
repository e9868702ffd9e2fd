"""What `vsense explain` may have found, made up: one answer for each verdict, and curves that go with it."""

from __future__ import annotations

from typing import Any

import numpy as np

from vsense_ros.mismatch.answer_schema import (
    VERSION,
    Answer,
    BaseParameter,
    EffectEntry,
    Errors,
    Force,
    Located,
    NextTest,
    OutOfReach,
    Region,
    Segment,
    SignalErrors,
    SignalMisfit,
    TermSize,
)
from vsense_ros.mismatch.picture import Trace

SIGNALS = {
    "lateral_acceleration": ("m/s²", 0.06, 0.42, 0.075),
    "yaw_rate": ("rad/s", 0.004, 0.019, 0.0045),
    "roll_rate": ("rad/s", 0.006, 0.012, 0.0065),
    "longitudinal_acceleration": ("m/s²", 0.06, 0.071, 0.07),
    "speed": ("m/s", 0.06, 0.066, 0.064),
    "course": ("rad", 0.006, 0.0059, 0.0055),
    "travel_fl": ("m", 0.0012, 0.0016, 0.0013),
}  # unit, what a good model leaves, error before and after


def effect(id: str, gain: float, **more: Any) -> EffectEntry:
    """An effect that explains `gain`, with other values where they are given."""
    return EffectEntry.model_validate(
        {
            "id": id,
            "sentence": f"the physics of {id.replace('_', ' ')}",
            "parameters": [{"name": "angle", "unit": "rad", "value": 0.0123, "interval_90": [0.0110, 0.0136]}],
            "gain_training": gain,
            "gain_left_out": 0.9 * gain,
            "gain_held_out": 0.8 * gain,
            "confidence": max(gain / (gain + 0.03), 0.0),
            "adds_to_best": None,
            "keep": 0.62,
            "objection": "",
            "accepted": False,
            "answer_set": [],
            "would_separate": None,
        }
        | more
    )


NEXT_TEST = NextTest(
    manoeuvre="steady turn on a banked road", id="steady_turn", opposite=False, signal="lateral_acceleration",
    d_prime=6.0, information=18.0, pair=("imu_roll_misalignment", "accelerometer_bias"),
)  # fmt: skip
SENTENCES = {
    "named": "The model leaves out a roll of the inertial sensor in its mounting (0.7°). With it the squared "
    "error falls by 68 %, and by 54 % on recordings it was not fitted to.",
    "ambiguous": "These recordings cannot determine which it is: a roll of the inertial sensor in its mounting, or "
    "a bias of its lateral acceleration.",
    "unknown": "Something is left over that no effect of the library explains: a yaw moment that grows with "
    "the lateral acceleration.",
    "no_mismatch": "Model and recordings agree once mass, tyres and the like are fitted: there is nothing to "
    "find here.",
    "not_assessable": "Nothing can be said: only 4.2 s of driving can be used, 10 s are needed.",
}
FORCE = Force(
    description="a lateral force that follows the side slip, 1.2 m behind the centre of gravity",
    sizes=(TermSize(name="lateral_force_lateral", unit="N/(m/s²)", value=81.2),),
    lever_arm=-1.2, gain_training=0.42, gain_left_out=0.37, gain_held_out=0.39,
)  # fmt: skip
BASE = {
    "mass": ("-", 0.061),
    "centre of gravity, forward over wheelbase": ("-", -0.012),
    "cornering stiffness, front": ("-", -0.13),
    "tyre radius": ("-", 0.0),
    "age of the steering angle": ("s", 0.0071),
}  # unit and offset
SEGMENTS = [
    ("lap 1", 3.0, 24.0, 0.22), ("lap 1", 24.0, 45.0, 0.41), ("lap 1", 45.0, 66.0, 0.05),
    ("slalom $5^", 5.0, 15.0, 0.27), ("slalom $5^", 15.0, 25.0, 0.05),
]  # fmt: skip


def effects_of(verdict: str) -> tuple[EffectEntry, ...]:
    """Ranked, as the answer with a verdict has them."""
    if verdict == "not_assessable":
        return ()
    if verdict not in ("named", "ambiguous"):
        return (effect("brake_drag", 0.013, wheel="fr"),)
    return (
        effect("imu_roll_misalignment", 0.68, accepted=verdict == "named"),
        effect("accelerometer_bias", 0.61, axis="y", adds_to_best=0.001),
        effect("tyre_underinflation", 0.21, wheel="rl", gain_left_out=0.11, gain_held_out=0.001),
        effect("brake_drag", 0.013, wheel="fr"),
    )


def segment(recording: str, begin: float, end: float, share: float) -> Segment:
    return Segment(recording=recording, begin=begin, end=end, share=share)


def located(verdict: str) -> Located:
    """Where the answer with a verdict is off."""
    if verdict == "not_assessable":
        return Located(signals=(), segments=(), lost=(), region=None, force=None, parts=())
    return Located(
        signals=tuple(
            SignalMisfit(name=name, unit=unit, before=before if verdict != "no_mismatch" else null, null=null)
            for name, (unit, null, before, _) in SIGNALS.items()
        ),
        segments=tuple(segment(*one) for one in SEGMENTS),
        lost=(),
        region=Region(
            description="the error of the lateral acceleration grows with the lateral acceleration",
            correlation={"lateral_acceleration": 0.8},
        ),
        force=FORCE if verdict == "unknown" else None,
        parts=(),
    )


def errors(verdict: str, *, held_out: bool) -> dict[str, SignalErrors]:
    """Errors of each signal; those held out are a tenth larger."""
    found = {}
    for name, (unit, null, before, after) in SIGNALS.items():
        before = null if verdict == "no_mismatch" else before
        after = after if verdict in ("named", "ambiguous") else before
        found[name] = SignalErrors(
            unit=unit,
            training=Errors(before=before, after=after),
            held_out=Errors(before=1.1 * before, after=1.1 * after) if held_out else None,
        )
    return found


def finding(verdict: str, *, held_out: bool = True, **changes: Any) -> Answer:
    """The answer with a verdict, with other values where they are given."""
    silent = verdict == "not_assessable"
    rivals = {
        "named": [["imu_roll_misalignment"]],
        "ambiguous": [["imu_roll_misalignment"], ["accelerometer_bias"]],
    }.get(verdict, [])
    return Answer(
        version=VERSION,
        verdict=verdict,
        sentence=SENTENCES[verdict],
        vehicle="RAV4 <2007>",
        recordings=("lap 1", "slalom $5^", "coast & brake"),
        held_out=("lap 3",) if held_out else (),
        held_out_unused=(),
        by_pieces=False,
        remarks=("coast & brake: nowhere 6 s of driving above 4 m/s without a gap",),
        located=located(verdict),
        effects=effects_of(verdict),
        out_of_reach=(OutOfReach(id="aero_drag", reason="it needs wheel torques, which these recordings do not have"),),
        answer_set=[id for ids in rivals for id in ids],
        rivals=rivals,
        would_separate=NEXT_TEST if verdict == "ambiguous" else None,
        fit={} if silent else errors(verdict, held_out=held_out),
        base={
            name: BaseParameter(unit=unit, value=value, explained=None)
            for name, (unit, value) in ({} if silent else BASE).items()
        },
        threshold=0.03,
        driven_s=128.0,
        assumed=(),
        ablation="",
        cpu_s=41.7,
    ).with_(**changes)


def traces(verdict: str, *, held_out: bool = True) -> list[Trace]:
    """Curves with the errors of `finding(verdict)`: two windows of a recording that was fitted, one held out."""
    if verdict == "not_assessable":
        return []
    random = np.random.default_rng(1)
    windows = [("lap 1", 0, 3.0, 24.0, False), ("lap 1", 1, 24.0, 45.0, False), ("slalom $5^", 2, 5.0, 15.0, False)]
    if held_out:
        windows.append(("lap 3", 0, 10.0, 32.0, True))
    result = []
    for recording, window, begin, end, held in windows:
        t = np.arange(begin, end, 0.04)
        for name, (unit, null, before, after) in SIGNALS.items():
            before = null if verdict == "no_mismatch" else before
            after = after if verdict in ("named", "ambiguous") else before
            measured = 8 * before * np.sin(0.9 * t + window) * np.sin(0.13 * t) + 0.3 * null * random.normal(
                size=len(t)
            )
            wave = np.sqrt(2) * np.sin(0.9 * t + window + 0.4)
            result.append(
                Trace(
                    recording, window, held, name, unit, t, measured, measured + before * wave, measured + after * wave
                )
            )
    return result
