"""A CAN mapping as `config/can/*.yaml` has them, written from what was recognized, with what is to be looked at."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from vsense_ros.bag.can_names import WHEEL_SIDES
from vsense_ros.bag.can_roles import ROLES, Recognized, Roles
from vsense_ros.bag.can_survey import CanSurvey, HeardSignal
from vsense_ros.checks.noise import white_noise
from vsense_ros.errors import InputError
from vsense_ros.messages import units


@dataclass(frozen=True)
class ProposalSettings:
    """Numbers that a proposal states where the log has none."""

    rate_noise: float = 0.002  # [rad/s] least standard deviation of a yaw rate
    force_noise: float = 0.05  # [m/s²] and of an acceleration
    silent_periods: float = 10.0  # [-] periods of silence after which a message counts as lost
    least_timeout: float = 0.1  # [s]


PROPOSAL = ProposalSettings()
_YAML_WORDS = ("y", "n", "yes", "no", "on", "off", "true", "false", "null")  # that are no text without quotes
_AXES = {
    "yaw_rate": "angular_velocity_z",
    "longitudinal_acceleration": "linear_acceleration_x",
    "lateral_acceleration": "linear_acceleration_y",
}
# Plausible values [unit], where the range of a database is not that of its values.
_RANGES: Mapping[str, tuple[float, float]] = {
    "km/h": (-50.0, 400.0), "m/s": (-15.0, 110.0), "mph": (-30.0, 250.0), "rad/s": (-50.0, 400.0),
    "rpm": (-400.0, 3500.0),
    "deg": (-1000.0, 1000.0), "rad": (-17.5, 17.5), "deg/s": (-180.0, 180.0), "m/s²": (-30.0, 30.0), "g": (-3.0, 3.0),
}  # fmt: skip


def proposal(survey: CanSurvey, roles: Roles) -> str:
    """The mapping as YAML with comments, which `vsense import LOG OUT --dbc … --mapping …` takes as it is.

    Raises `InputError` if nothing was recognized that a mapping can have.
    """
    outputs = [*_joints(roles), *_axes(roles), *_receiver(roles)]
    if not outputs:
        heard = ", ".join(dict.fromkeys(signal.label for signal in survey.signals))
        raise InputError(
            f"{survey.name}: no signal looks like wheel speeds, a steering angle, a yaw rate or an acceleration; a "
            f"mapping can be written by hand, as in config/can; heard were: {heard[:600] or 'no signals'}"
        )
    used = {one.signal.message: one.signal for one in _recognized(roles)}
    for receiver in roles.gnss_outputs:
        used.setdefault(receiver.message, next(iter(receiver.signals.values()))[0])
    lines = [
        f"# A proposal for {_plain(survey.name)}, made by `vsense can`: look at every line.",
        "# What is positive is so in the axes of ISO 8855: forward, left, turning left.",
        *(f"# {line}" for line in _doubts(roles)),
        f"name: {_quoted(survey.name)}",
        "",
        "messages:",
        *(line for signal in used.values() for line in _message(signal)),
        "",
        "outputs:",
    ]
    for output in outputs:
        lines += output
    if roles.speed is not None:
        lines += [
            "",
            f"# The speed of the car is in {_plain(roles.speed.signal.label)} [{roles.speed.unit}], too.",
        ]
    used_signals = {id(one) for output in roles.gnss_outputs for one, _ in output.signals.values()}
    further = [signal for signal in roles.gnss if id(signal) not in used_signals]
    if further:
        lines.append(
            f"# Further signals of a satellite receiver: {', '.join(_plain(signal.label) for signal in further[:8])}."
        )
    return "\n".join(lines) + "\n"


def _recognized(roles: Roles) -> list[Recognized]:
    """All that the mapping uses."""
    single = (roles.steering_wheel, *(getattr(roles, role) for role in _AXES))
    return [*roles.wheels.values(), *(one for one in single if one is not None)]


def _doubts(roles: Roles) -> list[str]:
    """What was not found, in words."""
    missing = [
        *([] if roles.wheels else ["four wheel speeds"]),
        *([] if roles.steering_wheel else ["a steering angle"]),
        *(role.replace("_", " ") for role in _AXES if getattr(roles, role) is None),
    ]
    return [f"Nothing was recognized as {', '.join(missing)}."] if missing else []


def _message(signal: HeardSignal) -> list[str]:
    timeout = max(PROPOSAL.least_timeout, PROPOSAL.silent_periods / signal.rate) if signal.rate else 1.0
    rate = f"rate: {_number(signal.rate)}, " if signal.rate else ""
    return [f"  {_quoted(signal.message)}: {{{rate}timeout: {_number(timeout)}}}"]


def _joints(roles: Roles) -> list[list[str]]:
    """Outputs of wheel speeds and of the steering angle, one for each message."""
    outputs = []
    by_message: dict[str, list[str]] = {}
    for side in WHEEL_SIDES:
        if side in roles.wheels:
            by_message.setdefault(roles.wheels[side].signal.message, []).append(side)
    for message, sides in by_message.items():
        first = roles.wheels[sides[0]]
        outputs.append(
            [
                *_comments(first),
                "  - kind: joint_state",
                "    topic: vehicle/wheel_speeds",
                f"    message: {_quoted(message)}",
                "    field: velocity",
                "    joints:",
                *(f"      wheel_{side}: {_signal(roles.wheels[side], radius=True)}" for side in sides),
            ]
        )
    if roles.steering_wheel is not None:
        outputs.append(
            [
                *_comments(roles.steering_wheel, roles.others.get("steering_wheel", ())),
                "  - kind: joint_state",
                "    topic: vehicle/steering",
                f"    message: {_quoted(roles.steering_wheel.signal.message)}",
                "    field: position",
                "    joints:",
                f"      steering_wheel: {_signal(roles.steering_wheel)}",
            ]
        )
    return outputs


def _axes(roles: Roles) -> list[list[str]]:
    """Outputs of yaw rate and accelerations, one for each message."""
    by_message: dict[str, list[str]] = {}
    for role in _AXES:
        role_signal: Recognized | None = getattr(roles, role)
        if role_signal is not None:
            by_message.setdefault(role_signal.signal.message, []).append(role)
    outputs = []
    for message, names in by_message.items():
        comments, lines = [], []
        for role in names:
            role_signal = getattr(roles, role)
            comments += _comments(role_signal, roles.others.get(role, ()))
            lines.append(f"      {_AXES[role]}: {_signal(role_signal, noise=True)}")
        outputs.append(
            [
                *comments,
                "  - kind: imu",
                "    topic: imu/data",
                "    frame_id: imu_link",
                f"    message: {_quoted(message)}",
                "    axes:",
                *lines,
            ]
        )
    return outputs


def _receiver(roles: Roles) -> list[list[str]]:
    """Outputs of a satellite receiver: its position and its velocity."""
    return [
        [
            "",
            f"  - kind: {output.kind}",
            f"    message: {_quoted(output.message)}",
            *(
                f"    {quantity}: {{signals: {_quoted(signal.name)}, unit: {_quoted(unit)}"
                + (", ignore_stated_unit: true" if _contradicts(signal, unit) else "")
                + "}"
                for quantity, (signal, unit) in output.signals.items()
            ),
        ]
        for output in roles.gnss_outputs
    ]


def _contradicts(signal: HeardSignal, unit: str) -> bool:
    stated = units.canonical(signal.unit) if signal.unit else None
    return stated is not None and stated != unit


def _comments(recognized: Recognized, others: tuple[HeardSignal, ...] = ()) -> list[str]:
    """Rate, range, agreement and doubts of a signal."""
    signal = recognized.signal
    stated = f" {_plain(signal.unit)}" if signal.unit else ""
    facts = f"{_plain(signal.label)}: {signal.rate:.3g} Hz, {_number(signal.low)} to {_number(signal.high)}{stated}"
    if math.isfinite(recognized.correlation):
        facts += f"; correlation with what the other signals say {recognized.correlation:.2f}"
    lines = [f"  # {facts}.", *(f"  # {_plain(reason)}." for reason in recognized.reasons)]
    if others:
        lines.append(f"  # It could also be {', '.join(_plain(one.label) for one in others)}.")
    return ["", *lines]


def _signal(recognized: Recognized, *, radius: bool = False, noise: bool = False) -> str:
    """One signal as a line of the mapping."""
    signal = recognized.signal
    parts = [f"signals: {_quoted(signal.name)}", f"unit: {_quoted(recognized.unit)}"]
    if recognized.factor != 1.0:
        parts.append(f"factor: {_number(recognized.factor)}")
    if recognized.contradicts_stated_unit:
        parts.append("ignore_stated_unit: true")
    if recognized.sign is not None:
        negative = "" if recognized.negative == 1 else f", negative: {recognized.negative}"
        parts.append(f"sign: {{signal: {_quoted(recognized.sign.name)}{negative}}}")
    if radius and units.quantity_of(recognized.unit) == "velocity":
        parts.append(f"rolling_radius: {ROLES.radius}")
    if _leaves_range(signal):
        low, high = _RANGES[recognized.unit]
        parts.append(f"range: [{_number(low)}, {_number(high)}]")
    if noise:
        parts.append(f"standard_deviation: {_number(_noise(recognized))}")
    return f"{{{', '.join(parts)}}}"


def _leaves_range(signal: HeardSignal) -> bool:
    """True if values in the log are outside of the range that the database gives."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return False
    return signal.low < signal.minimum or signal.high > signal.maximum


def _noise(recognized: Recognized) -> float:
    """Standard deviation of the noise [SI]: that of the logged values, at least of a step and what sensors have."""
    signal = recognized.signal
    scale = abs(recognized.factor) * units.to_si(recognized.unit)
    is_rate = units.quantity_of(recognized.unit) == "angular velocity"
    least = PROPOSAL.rate_noise if is_rate else PROPOSAL.force_noise
    return float(f"{max(white_noise(signal.value) * scale, signal.step * scale / math.sqrt(12.0), least):.2g}")


def _number(value: float) -> str:
    text = f"{value:.4g}"
    return text if re.fullmatch(r"-?\d+(\.\d+)?", text) else repr(float(text))


def _plain(text: str) -> str:
    """A text of somebody else in one line of a comment."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _quoted(text: str) -> str:
    """A text of somebody else as YAML, which takes what JSON takes; without quotes where it is a plain word."""
    if re.fullmatch(r"[A-Za-z_]\w*", text) and text.lower() not in _YAML_WORDS:
        return text
    return json.dumps(text, ensure_ascii=False)
