"""What `vsense explain` may have found, made up: one answer for each verdict, and curves that go with it."""

from __future__ import annotations

from typing import Any

import numpy as np

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


def effect(id: str, gain: float, **more: Any) -> dict[str, Any]:
    return {
        "id": id,
        "sentence": f"the physics of {id.replace('_', ' ')}",
        "parameters": [{"name": "angle", "unit": "rad", "value": 0.0123, "interval_90": [0.0110, 0.0136]}],
        "gain_training": gain,
        "gain_left_out": 0.9 * gain,
        "gain_held_out": 0.8 * gain,
        "confidence": gain / (gain + 0.03),
        "adds_to_best": None,
        "keep": 0.62,
    } | more


EFFECTS = [
    effect("imu_roll_misalignment", 0.68, accepted=True),
    effect("accelerometer_bias", 0.61, axis="y", adds_to_best=0.001),
    effect("tyre_underinflation", 0.21, wheel="rl", gain_left_out=0.11, gain_held_out=0.001),
    effect("brake_drag", 0.013, wheel="fr"),
]


def finding(verdict: str, *, held_out: bool = True) -> dict[str, Any]:
    """The content of explain.json for a verdict."""
    added = verdict in ("named", "ambiguous")
    found: dict[str, Any] = {
        "verdict": verdict,
        "sentence": {
            "named": "The model leaves out a roll of the inertial sensor in its mounting (0.7°); with it the squared "
            "error falls by 68 %, and by 54 % on recordings it was not fitted to.",
            "ambiguous": "These recordings cannot tell which it is: a roll of the inertial sensor in its mounting, or "
            "a bias of its lateral acceleration.",
            "unknown": "Something is left over that no effect of the library explains: a yaw moment that grows with "
            "the lateral acceleration.",
            "no_mismatch": "Model and recordings agree once mass, tyres and the like are fitted: there is nothing to "
            "find here.",
            "not_assessable": "Nothing can be said: only 4.2 s of driving can be used, 10 s are needed.",
        }[verdict],
        "vehicle": "RAV4 <2007>",
        "recordings": ["lap 1", "slalom $5^", "coast & brake"],
        "held_out": ["lap 3"] if held_out else [],
        "remarks": ["coast & brake: nowhere 6 s of driving above 4 m/s without a gap"],
        "located": {
            "signals": [
                {"name": name, "unit": unit, "before": before if verdict != "no_mismatch" else null, "null": null}
                for name, (unit, null, before, _) in SIGNALS.items()
            ],
            "segments": [
                {"recording": "lap 1", "begin": 3.0, "end": 24.0, "share": 0.22},
                {"recording": "lap 1", "begin": 24.0, "end": 45.0, "share": 0.41},
                {"recording": "lap 1", "begin": 45.0, "end": 66.0, "share": 0.05},
                {"recording": "slalom $5^", "begin": 5.0, "end": 15.0, "share": 0.27},
                {"recording": "slalom $5^", "begin": 15.0, "end": 25.0, "share": 0.05},
            ],
            "region": {"description": "the error of the lateral acceleration grows with the lateral acceleration"},
            "force": {
                "description": "a lateral force that follows the side slip, 1.2 m behind the centre of gravity",
                "sizes": [{"name": "lateral_force_lateral", "unit": "N/(m/s²)", "value": 81.2}],
                "gain_training": 0.42,
                "gain_left_out": 0.37,
                "gain_held_out": 0.39,
            }
            if verdict == "unknown"
            else None,
        },
        "out_of_reach": [{"id": "aero_drag", "reason": "it needs wheel torques, which these recordings do not have"}],
        "effects": list(EFFECTS) if added else [effect("brake_drag", 0.013, wheel="fr")],
        "answer_set": {
            "named": ["imu_roll_misalignment"],
            "ambiguous": ["imu_roll_misalignment", "accelerometer_bias y"],
        }.get(verdict, []),
        "would_separate": {"manoeuvre": "steady turn on a banked road", "signal": "lateral_acceleration"}
        if verdict == "ambiguous"
        else None,
        "fit": {},
        "base": {
            "mass": {"unit": "-", "value": 0.061},
            "centre of gravity, forward over wheelbase": {"unit": "-", "value": -0.012},
            "cornering stiffness, front": {"unit": "-", "value": -0.13},
            "tyre radius": {"unit": "-", "value": 0.0},
            "age of the steering angle": {"unit": "s", "value": 0.0071},
        },
        "threshold": 0.03,
        "driven_s": 128.0,
        "cpu_s": 41.7,
    }  # fmt: skip
    for name, (unit, null, before, after) in SIGNALS.items():
        before = null if verdict == "no_mismatch" else before
        errors = {"before": before, "after": after if added else before}
        found["fit"][name] = {"unit": unit, "training": errors}
        if held_out:
            found["fit"][name]["held_out"] = {key: 1.1 * value for key, value in errors.items()}
    if verdict == "not_assessable":
        found["located"] = {"signals": [], "segments": [], "region": None, "force": None}
        found |= {"effects": [], "fit": {}, "base": {}}
    return found


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
