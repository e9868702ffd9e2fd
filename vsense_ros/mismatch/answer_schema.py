"""What explain.json holds: every key with its unit and meaning, written from objects and read back into them.

`python -m vsense_ros.mismatch.answer_schema > docs/explain.schema.json` writes the published JSON schema anew.

A key that is always in the file has no default here; one with a default is absent where there is nothing to say. Keys
of an answer about which nothing could be said are there as well, empty.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write

VERSION: Literal[1] = (
    1  # of the content of explain.json; another one whenever a key is renamed, removed or means something else
)
ANSWER = "explain.json"
AGAIN = "run vsense explain again on the same recordings to write it anew"

VerdictName = Literal["named", "ambiguous", "unknown", "no_mismatch", "not_assessable"]
Interval = tuple[float, float]


def _field(meaning: str, unit: str = "", **more: Any) -> Any:
    """A key with its meaning, and its unit where it is a quantity ("-" where that has none)."""
    return Field(description=meaning, json_schema_extra={"unit": unit} if unit else None, **more)


class _Part(BaseModel):
    """A part of the answer: it cannot be changed, and knows no other keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def with_(self, **changes: Any) -> Self:
        """A copy with other values, which are checked."""
        return type(self).model_validate({name: getattr(self, name) for name in type(self).model_fields} | changes)

    def as_json(self) -> dict[str, Any]:
        """The content of a file, without the keys of which there is nothing to say."""
        return self.model_dump(exclude_defaults=True)


def _at(what: str) -> Any:
    return _field(f"Where the effect is, if at one {what}", default=None)


_WHEEL, _AXLE = _at("wheel: fl, fr, rl or rr."), _at("axle: front or rear.")
_SENSOR, _AXIS = _at("sensor: its kind."), _at("axis of the car, along or about which it acts.")
_FORM = _field("In words: the form of an effect that has several.", default=None)


class Size(_Part):
    """A parameter of an effect with its fitted value."""

    name: str = _field("Name of the parameter in `physics.effects` of a vehicle file.")
    unit: str = _field('Unit of `value`; "-" where it has none.')
    value: float = _field("Fitted value.", "as `unit` says")
    interval_90: Interval = _field("Limits of its 90 % interval.", "as `unit` says")


class ProfilePoint(_Part):
    """What the size of an effect of the road is at one place, besides what it is everywhere."""

    stretch: float = _field("Number of the stretch of road that hangs together with others by no recording.", "-")
    distance: float = _field("Distance along that stretch.", "m")
    latitude: float | None = _field("Latitude of the place, where GNSS has it.", "°", default=None)
    longitude: float | None = _field("Longitude of the place, where GNSS has it.", "°", default=None)
    direction: float | None = _field("Direction of the road there, counter-clockwise from east.", "rad", default=None)
    value: float = _field("Added to the first of `parameters`.", "as the unit of that parameter")
    interval_90: Interval = _field("Limits of its 90 % interval.", "as the unit of that parameter")


class Errors(_Part):
    """Root mean square of measured minus simulated."""

    before: float = _field("With the base parameters fitted.", "as the unit of the signal")
    after: float = _field("With what was found, and the base parameters fitted again.", "as the unit of the signal")


class SignalErrors(_Part):
    """Errors of one signal."""

    unit: str = _field("Unit of the signal.")
    training: Errors = _field("On the recordings that were fitted.")
    held_out: Errors | None = _field("On recordings that no fit has seen.", default=None)


class SignalMisfit(_Part):
    """How far one signal is off with the base parameters fitted."""

    name: str = _field("Name of the signal.")
    unit: str = _field("Unit of the signal.")
    before: float = _field("Root mean square of its error in training.", "as `unit` says")
    null: float = _field("Root mean square of the error that a good model leaves.", "as `unit` says")


class Span(_Part):
    """A stretch of a recording."""

    recording: str = _field("Name of the recording.")
    begin: float = _field("Begin, since the first stamp of the recording.", "s")
    end: float = _field("End, since the first stamp of the recording.", "s")


class Segment(Span):
    """A window that was fitted."""

    share: float = _field("Its share of the squared error of all windows, with the base parameters fitted.", "-")

    @property
    def density(self) -> float:
        """The share per time [1/s]."""
        return self.share / max(self.end - self.begin, 1e-9)


class Region(_Part):
    """With what the error of the worst signal grows or falls."""

    description: str = _field("In words.")
    correlation: dict[str, float] = _field("Correlation of the error's size with that of measured signals.", "-")


class TermSize(_Part):
    """A coefficient of a term without known physics."""

    name: str = _field("Name of the coefficient.")
    unit: str = _field("Unit of `value`.")
    value: float = _field("Fitted value.", "as `unit` says")


class Force(_Part):
    """A force, torque, angle or reading without known physics that describes the residuals."""

    description: str = _field("In words.")
    sizes: tuple[TermSize, ...] = _field("Its coefficients.")
    lever_arm: float | None = _field(
        "How far ahead of the centre of gravity a lateral force acts; null for any other term.", "m"
    )
    gain_training: float = _field("Relative fall of the squared error where it was fitted.", "-")
    gain_left_out: float = _field("The same where it was left out of the fit in turn.", "-")
    gain_held_out: float | None = _field("The same on held-out recordings; null without any.", "-")


class ActingPart(_Part):
    """On what an effect of the answer acts."""

    effect: str = _field("Id of the effect.")
    acts_on: str = _field("chassis, suspension, steering, wheel, tyre, road or sensor.")
    wheel: str | None = _WHEEL
    axle: str | None = _AXLE
    sensor: str | None = _SENSOR
    axis: str | None = _AXIS
    form: str | None = _FORM


class Located(_Part):
    """Where model and recordings differ."""

    signals: tuple[SignalMisfit, ...] = _field("The signals that were compared, the furthest off first.")
    segments: tuple[Segment, ...] = _field("The windows that were fitted, the largest share of the error first.")
    lost: tuple[Span, ...] = _field("Windows that were not fitted, because the simulated car leaves the road there.")
    region: Region | None = _field("With what the error grows; null where that is not known.")
    force: Force | None = _field("What describes an unknown physics; null where nothing does.")
    parts: tuple[ActingPart, ...] = _field("On what the effects of the answer act.")


class NextTest(_Part):
    """A manoeuvre that would tell apart what an ambiguous answer leaves open."""

    manoeuvre: str = _field("Title of the manoeuvre.")
    id: str = _field("Name of the manoeuvre for `vsense simulate`.")
    opposite: bool = _field("Whether it is to be driven on the road of the recordings the other way.")
    signal: str = _field("The signal that would show most.")
    d_prime: float = _field("Predicted distance of the two effects that are told apart worst.", "standard deviations")
    information: float = _field("Expected log-likelihood ratio of these two.", "nat")
    pair: tuple[str, str] = _field("These two.")


class EffectEntry(_Part):
    """An effect that was fitted, at the place and in the form in which it explains most."""

    id: str = _field("Id of the effect.")
    sentence: str = _field("Its physics in words.")
    wheel: str | None = _WHEEL
    axle: str | None = _AXLE
    sensor: str | None = _SENSOR
    axis: str | None = _AXIS
    form: str | None = _FORM
    profile: tuple[ProfilePoint, ...] | None = _field(
        "Of an effect of the road whose size is another at every place: what it is where.", default=None
    )
    parameters: tuple[Size, ...] = _field("Its sizes.")
    gain_training: float = _field("Relative fall of the squared error of all signals where it was fitted.", "-")
    gain_left_out: float = _field("The same where it was left out of the fit in turn.", "-")
    gain_held_out: float | None = _field(
        "The same on held-out recordings; null without any, or where the simulation broke down there.", "-"
    )
    adds_to_best: float | None = _field(
        "What it explains besides the answer, as a share of the squared error; null where the two were not fitted "
        "together.",
        "-",
    )
    gain_without: float | None = _field(
        "What the other effects of its explanation explain without it on held-out recordings, or without any where "
        "they were left out of the fit; null where it was fitted alone.",
        "-",
        default=None,
    )
    keep: float = _field(
        "Share of what it changes that fitting all other parameters cannot imitate (independent share).", "-"
    )
    confidence: float = _field("How probable it is that the effect is there.", "-")
    objection: str = _field("Why it is refused, in words; empty where nothing speaks against it.")
    accepted: bool = _field("Whether it is named: every explanation that remains has it.")
    answer_set: tuple[str, ...] = _field("The answer set, if the effect is part of it; else empty.")
    would_separate: NextTest | None = _field("The next test, if the effect is part of the answer set; else null.")

    @property
    def place(self) -> str:
        """Where it is, and in which form, as in the file; empty where it has no place."""
        return ", ".join(places(self))


def places(of: EffectEntry | ActingPart) -> list[str]:
    """Where an effect is, and in which form."""
    return [place for place in (of.wheel, of.axle, of.sensor, of.axis, of.form) if place]


class LikelySize(_Part):
    """A size of an effect where the set of effects is likeliest, all other unknowns free."""

    name: str = _field("Its name.")
    likeliest: float = _field("Its likeliest value, over a typical one.", "-")
    deviation: float = _field("Its standard deviation, over a typical value.", "-")
    prior: float = _field("The same beforehand: 1 if it is in the set, and what every car has of it if not.", "-")


class Likely(_Part):
    """What the evidence says of an effect, before anything is proven."""

    effect: str = _field("Id of the effect.")
    probability: float = _field("Share of the evidence of all sets that those with the effect have.", "-")
    adds: float | None = _field(
        "What it explains of the squared error that the others of the likeliest set with it leave, in training or "
        "where it was not fitted, whichever is less; absent of effects of no set that was proven without it.",
        "-",
        default=None,
    )
    sizes: tuple[LikelySize, ...] = _field("Its sizes.")


class OutOfReach(_Part):
    """An effect of which these recordings say nothing."""

    id: str = _field("Id of the effect.")
    reason: str = _field("Why, in words.")


class BaseParameter(_Part):
    """A parameter that is fitted before any effect is sought, because no vehicle file is sure of it."""

    unit: str = _field('Unit of its offset; "-" where it is relative to the value of the vehicle file.')
    value: float = _field("Offset from the vehicle file, fitted without what was found.", "as `unit` says")
    explained: float | None = _field(
        "Offset fitted together with what was found; null where nothing was, or where it is now part of an effect.",
        "as `unit` says",
    )


class Remainder(_Part):
    """What is left over that nothing explains, where what was named is not all."""

    level: float = _field(
        "Root mean square of all residuals in training, in multiples of what a good model leaves.", "-"
    )
    signals: tuple[SignalMisfit, ...] = _field(
        "Signals that stay far off, the furthest first; `before` is the error that remains."
    )
    region: Region | None = _field("With what that error grows; null where that is not known.")
    force: Force | None = _field("What describes it, besides what was named; null where nothing does.")


class Begin(_Part):
    """When something begins in a recording."""

    recording: str = _field("Name of the recording.")
    at: float = _field("Time since the first stamp of the recording.", "s")
    interval_90: Interval = _field("Limits of its 90 % interval.", "s")


class Onset(_Part):
    """What was not there when a recording began, and what it looks like."""

    looks_like: str = _field("Id of the effect that explains most of it, if that begins then; it is not named.")
    sentence: str = _field("The physics of that effect in words.")
    where: str = _field("Wheel, axle, axis, sensor or form of that effect; empty where it has none.")
    value: float = _field("Its size.", "as `unit` says")
    unit: str = _field('Unit of `value`; "-" where it has none.')
    gain: float = _field("Relative fall of the squared error in training, by the linear model.", "-")
    gain_always: float = _field("The same of that effect if it is there all the time.", "-")
    begins: tuple[Begin, ...] = _field("When it begins, in the recordings within which it does.")


class SensorFigures(_Part):
    """How one sensor agrees with what an observer expects of it."""

    messages: int = _field("Number of messages that are no outliers.", "-")
    log_likelihood: float = _field("Log-likelihood per message, given all before it.", "nat")
    innovation: float = _field(
        "Size of the innovations, over that with the vehicle file as it was (root mean squares of the components, "
        "averaged by their logarithms).",
        "-",
    )
    nis: float = _field("Normalized innovation squared per component; 1 for an observer that is right.", "-")


class ObserverError(_Part):
    """Root mean square error of an estimate against the reference of a recording."""

    unit: str = _field("Unit of the signal.")
    rmse: float = _field("With the reference mounted as the vehicle file says.", "as `unit` says")
    without_constant: float = _field(
        "With the reference mounted as the recording says (see `reference`), and without the mean of roll and pitch.",
        "as `unit` says",
    )


class ReferencePlace(_Part):
    """Where the reference is mounted, fitted to its velocity and the estimated one."""

    x: float = _field("Ahead of the centre of gravity.", "m")
    y: float = _field("To the left of the centre of gravity.", "m")
    yaw: float = _field("Its forward axis is turned to the left by so much.", "rad")


class ObserverFigures(_Part):
    """How the observer fares with one vehicle file."""

    log_likelihood: float = _field("Log-likelihood of the measurements per message.", "nat")
    sensors: dict[str, SensorFigures] = _field("By sensor.")
    errors: dict[str, ObserverError] = _field("Errors by signal; empty without a reference.")
    reference: ReferencePlace | None = _field("The mounting of the reference; null where it is unknown.")


class ObserverComparison(_Part):
    """Comparison of the observer with the nominal and with the extended model."""

    recordings: tuple[str, ...] = _field("The recordings that it was judged on.")
    held_out: bool = _field("Whether these were held out of all fits.")
    messages: int = _field("Number of messages that were judged.", "-")
    improved: bool = _field(
        "Whether measurements are likelier with the extended file, not by other noise levels alone (with these alone "
        "they are less likely, or the side slip is further off a reference), and neither side slip nor lateral "
        "velocity is worse against a reference."
    )
    sentence: str = _field("The comparison in words.")
    as_it_was: ObserverFigures = _field("With the vehicle file as it was.")
    retuned: ObserverFigures = _field("With the noise levels alone fitted to the recordings.")
    extended: ObserverFigures = _field(
        "With the extended vehicle file, whose noise levels were fitted as well if that brings no estimate further off."
    )


class Answer(_Part):
    """What `vsense explain` found about a car and its recordings."""

    version: Literal[1] = _field("Version of this content.")
    verdict: VerdictName = _field(
        "named: the effects marked as accepted explain what the model leaves out. ambiguous: one of `rivals` does. "
        "unknown: something is left over that no effect of the library explains. no_mismatch: model and recordings "
        "agree. not_assessable: nothing can be said."
    )
    sentence: str = _field("The answer in words.")
    vehicle: str = _field("Name of the vehicle.")
    recordings: tuple[str, ...] = _field("The recordings to fit to.")
    held_out: tuple[str, ...] = _field("Held-out recordings that were used.")
    held_out_unused: tuple[str, ...] = _field("Held-out recordings of which nothing could be used.")
    by_pieces: bool = _field(
        "Whether what was held out is of another road, on which each piece is predicted from its neighbours."
    )
    remarks: tuple[str, ...] = _field("What else a reader has to know.")
    located: Located = _field("Where model and recordings differ.")
    effects: tuple[EffectEntry, ...] = _field("All effects that were fitted, those of the answer first.")
    out_of_reach: tuple[OutOfReach, ...] = _field("Effects of which these recordings say nothing.")
    answer_set: tuple[str, ...] = _field("Ids of all effects in `rivals`.")
    rivals: tuple[tuple[str, ...], ...] = _field(
        "Ids of the effects of each explanation that remains, the best first; one explanation where it is named."
    )
    would_separate: NextTest | None = _field("The test that would tell the rivals apart; null where none is known.")
    drive_next: str = _field(
        "Driving that these recordings lack, which would help to distinguish what looks alike in them; empty where "
        "none is known.",
        default="",
    )
    evidence: tuple[Likely, ...] = _field(
        "What the evidence says of each effect of the library; absent where none was computed.", default=()
    )
    fit: dict[str, SignalErrors] = _field("Errors by signal.")
    base: dict[str, BaseParameter] = _field("Base parameters by name.")
    threshold: float = _field("Gain that an effect needs at least.", "-")
    driven_s: float = _field("Duration of all driving.", "s")
    assumed: tuple[str, ...] = _field("Ids of the effects that were fitted without a search, as the user asked.")
    ablation: str = _field("The part of the method that the user switched off; empty for none.")
    misfit: float | None = _field(
        "Root mean square of all residuals in training with the base parameters fitted, in multiples of what a good "
        "model leaves.",
        "-",
        default=None,
    )
    recording_defects: tuple[str, ...] = _field(
        "What is wrong in the recordings themselves, found before any fit: signs, axes and units, with what mends "
        "them, and values in coarse steps.",
        default=(),
    )
    remainder: Remainder | None = _field(
        "What is left over besides what is named; absent where that is all, as far as is known.", default=None
    )
    onset: Onset | None = _field(
        "What begins within recordings; absent where nothing is known to, or all is explained.", default=None
    )
    observer: ObserverComparison | None = _field(
        "How the observer fares with the extended vehicle file; absent where nothing is named, or it could not run.",
        default=None,
    )
    cpu_s: float = _field("Time of computing.", "s")

    @property
    def sure(self) -> list[str]:
        """Ids of the effects that every explanation has which remains; where there is only one, none."""
        if len(self.rivals) < 2:
            return []
        return [id for id in self.answer_set if all(id in effects for effects in self.rivals)]

    @property
    def accepted(self) -> tuple[EffectEntry, ...]:
        """The effects that are named."""
        return tuple(effect for effect in self.effects if effect.accepted)

    @property
    def in_answer(self) -> tuple[EffectEntry, ...]:
        """The effects that are named, or that cannot be told apart."""
        if self.verdict == "ambiguous":
            return tuple(effect for effect in self.effects if effect.id in self.answer_set)
        return self.accepted if self.verdict == "named" else ()

    def written(self) -> str:
        """The text of explain.json."""
        return json.dumps(self.as_json(), indent=1, allow_nan=False) + "\n"

    def write(self, folder: Path) -> None:
        """Write explain.json into a folder."""
        with atomic_write(folder / ANSWER) as file:
            file.write(self.written())


def read_answer(folder: Path) -> Answer:
    """The explain.json in a folder. Raises `InputError` where there is none, or none of this version."""
    path = folder / ANSWER
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no answer there yet; run vsense explain with --report {folder} first") from None
    except ValueError as error:
        raise InputError(f"{path}: not what vsense explain writes: {error}") from None
    return parsed(content, str(path))


def parsed(content: Any, source: str) -> Answer:
    """The content of an explain.json that was found at `source`. Raises `InputError` for any other content."""
    if not isinstance(content, dict) or "verdict" not in content:
        raise InputError(f"{source}: not what vsense explain writes: it has no verdict")
    version = content.get("version")
    if version != VERSION:
        version_in_words = "of an earlier version, without a number" if version is None else f"of version {version}"
        raise InputError(f"{source}: {version_in_words}; expected version {VERSION}: {AGAIN}")
    try:
        return Answer.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{source}: not what vsense explain writes: {where}: {first['msg']}; {AGAIN}") from None


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of explain.json."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Answer.model_json_schema()}


if __name__ == "__main__":
    print(json.dumps(json_schema(), indent=1, ensure_ascii=False))
