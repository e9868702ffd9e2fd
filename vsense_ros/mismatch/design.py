"""The next test: which manoeuvre would tell apart the effects that the recordings leave open.

Each manoeuvre is driven with the car as it was fitted, recorded with those sensors of the vehicle that gave
measurements, and simulated with each effect at its fitted size. The signals of two effects differ; what counts is the
part of the difference that neither base parameters nor the other effect's size within its interval can make up for
(the projection of `search`), in units of what sensors and a good model leave. That is the distance d′ between two
hypotheses about a Gaussian residual (Green & Swets 1966); half its square is the information, the expected
log-likelihood ratio (Kullback & Leibler 1951). Residuals of neighbouring instants are correlated, which makes both too
large, for all tests alike.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification.free_parameter import FreeParameter, with_offsets
from vsense_ros.identification.least_squares import DivergedError, Fit, cost, prior_weight, slopes_by, solve
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.manoeuvre import TESTS, Manoeuvre, drive
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.mismatch.answer_schema import Answer, BaseParameter, EffectEntry, NextTest, read_answer
from vsense_ros.mismatch.candidates import base_parameters, candidates, out_of_reach, unknown_torques
from vsense_ros.mismatch.confidence import NORMAL_90
from vsense_ros.mismatch.effect_parameters import parameters_of
from vsense_ros.mismatch.page import PAGE, write_next_test
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import WINDOWS, Dataset, build_dataset
from vsense_ros.mismatch.words import label
from vsense_ros.model.coordinates import YAW
from vsense_ros.model.effects import BY_ID, Effect
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

NEXT = "next.json"


@dataclass(frozen=True)
class DesignSettings:
    """Settings of the design of a next test."""

    decisive: float = 3.0  # [-] d′ from which a test decides: one of two in seven hundred goes wrong
    seed: int = 1  # of the sensors' noise, by which signals are weighted, and which cancels otherwise


DESIGN = DesignSettings()


@dataclass(frozen=True)
class Rival:
    """One or several effects with their fitted sizes by dotted name, and their standard deviations."""

    name: str
    sizes: Mapping[str, float]
    deviations: Mapping[str, float]
    forms: Mapping[str, str] = field(default_factory=dict)  # of effects, by the same names


@dataclass(frozen=True)
class Option:
    """A manoeuvre to choose from; `opposite`: on the road of the recordings, in the other direction."""

    manoeuvre: Manoeuvre
    opposite: bool = False

    @property
    def title(self) -> str:
        return f"{self.manoeuvre.title}{', on the same road the other way' if self.opposite else ''}"


@dataclass(frozen=True)
class Separation:
    """How well a test tells apart the two rivals that it tells apart worst."""

    test: Option
    distance: float  # d′ [-]
    signal: str  # that shows most of it
    pair: tuple[str, str]

    @property
    def information(self) -> float:
        """Expected log-likelihood ratio [nat]."""
        return 0.5 * self.distance**2

    @property
    def next_test(self) -> NextTest:
        """As an answer has it."""
        return NextTest(
            manoeuvre=self.test.title,
            id=self.test.manoeuvre.name,
            opposite=self.test.opposite,
            signal=self.signal,
            d_prime=self.distance,
            information=self.information,
            pair=self.pair,
        )


CHOICE = (
    *(Option(manoeuvre) for manoeuvre in TESTS),
    *(Option(manoeuvre, opposite=True) for manoeuvre in TESTS if manoeuvre.name == "accelerate_and_brake"),
)


def left_open(answer: Answer, vehicle: Vehicle) -> tuple[list[Rival], dict[str, float]]:
    """The rivals of an answer with their sizes, and the offsets of the base parameters by name: the car as it was
    fitted with the best of the rivals.

    Raises `InputError` where there is nothing to tell apart.
    """
    if answer.verdict != "ambiguous":
        raise InputError(f"the verdict is {answer.verdict}: only an ambiguous answer leaves effects to tell apart")
    if answer.vehicle != vehicle.name:
        raise InputError(f"the answer is about the vehicle {answer.vehicle!r}, the vehicle file about {vehicle.name!r}")
    entries = {effect.id: effect for effect in reversed(answer.effects)}
    rivals = [_rival_of([entries[id] for id in ids]) for ids in answer.rivals]
    if len(rivals) < 2:
        raise InputError(f"the answer leaves {len(rivals)} explanations, two are needed to be told apart")
    return rivals, {name: _fitted(parameter) for name, parameter in answer.base.items()}


def _fitted(parameter: BaseParameter) -> float:
    return parameter.value if parameter.explained is None else parameter.explained


def _rival_of(effects: Sequence[EffectEntry]) -> Rival:
    names, sizes, deviations, forms = [], {}, {}, {}
    for effect in effects:
        names.append(f"{effect.id} {effect.place}".strip())
        for size in effect.parameters:
            dotted, (low, high) = f"effects.{effect.id}.{size.name}", size.interval_90
            sizes[dotted] = size.value
            deviations[dotted] = (high - low) / (2 * NORMAL_90)
            forms[dotted] = effect.form or ""
    return Rival(" + ".join(names), sizes, deviations, forms)


def separations(
    vehicle: Vehicle,
    rivals: Sequence[Rival],
    base: Mapping[str, float],
    choice: Sequence[Option] = CHOICE,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Separation]:
    """How well each test that the car can drive tells the rivals apart, the best first.

    `base` are the fitted offsets of the base parameters by name; from the names it also follows which sensors the
    recordings had. Raises `InputError` for a size that no effect has.
    """
    vehicle, fitted = _as_recorded(vehicle, base)
    library = candidates((), parameters_of(vehicle).values)
    free_parameters = {
        (parameter.name, parameter.form): parameter for candidate in library for parameter in candidate.free_parameters
    }
    if unknown := [name for rival in rivals for name in rival.sizes if (name, "") not in free_parameters]:
        raise InputError(f"no effect of the library has {', '.join(unknown)}")
    own = {name for rival in rivals for name in rival.sizes}
    common = tuple(parameter for parameter in fitted if parameter.name not in own)
    offsets = np.array([base.get(parameter.name, 0.0) for parameter in common])
    tested = []
    for i, test in enumerate(choice):
        with suppress(DivergedError, FloatingPointError):
            tested.append(_separation(vehicle, rivals, common, offsets, free_parameters, test))
        progress((i + 1) / len(choice))
    return sorted((one for one in tested if one is not None), key=lambda one: one.distance, reverse=True)


def _as_recorded(vehicle: Vehicle, base: Mapping[str, float]) -> tuple[Vehicle, tuple[FreeParameter, ...]]:
    """The car without the sensors that its recordings lacked, as far as that follows from the names of the fitted
    `base` parameters, and these parameters; without any, all that a fit would have."""
    kinds = {sensor.kind for sensor in vehicle.sensors.values()}
    by_torque = tuple(f"effects.{id}." for id, effect in BY_ID.items() if "wheel_torques" in effect.needs)
    if base and not any(name.startswith(by_torque) for name in base):
        kinds -= {"wheel_torques"}
        if not {parameter.name for parameter in unknown_torques(vehicle)} & base.keys():
            kinds -= {"wheel_speeds"}
    sensors = {name: sensor for name, sensor in vehicle.sensors.items() if sensor.kind in kinds}
    free_parameters = base_parameters(vehicle, out_of_reach(kinds), kinds)
    return vehicle.model_copy(update={"sensors": sensors}), tuple(
        k for k in free_parameters if not base or k.name in base
    )


def designed(
    report: Path, vehicle: Vehicle, progress: Callable[[float], None] = lambda share: None
) -> list[Separation]:
    """How well each test tells apart what the ambiguous answer in a folder leaves open, the best first; it is written
    into the folder, too. Raises `InputError` where there is no such answer."""
    rivals, base = left_open(read_answer(report), vehicle)
    separated = separations(vehicle, rivals, base, progress=progress)
    written(separated, rivals, report)
    return separated


def written(separated: Sequence[Separation], rivals: Sequence[Rival], report: Path) -> Answer:
    """Write next.json into the folder of an answer, and the best test as `would_separate` into its explain.json and
    onto its page; the answer with it."""
    content = {
        "rivals": [{"name": rival.name, "sizes": dict(rival.sizes)} for rival in rivals],
        "telling": DESIGN.decisive,
        "tests": [one.next_test.as_json() for one in separated],
    }
    with atomic_write(report / NEXT) as file:
        file.write(json.dumps(content, indent=1, allow_nan=False) + "\n")
    answer = _with_next_test(read_answer(report), separated)
    answer.write(report)
    write_next_test(answer, report / PAGE)
    return answer


def _with_next_test(answer: Answer, separated: Sequence[Separation]) -> Answer:
    """The answer with the best test, if it tells the rivals apart."""
    best = separated[0].next_test if separated and separated[0].distance >= DESIGN.decisive else None
    effects = tuple(effect.with_(would_separate=best) if effect.answer_set else effect for effect in answer.effects)
    return answer.with_(would_separate=best, effects=effects)


def printed(separated: Sequence[Separation], console: Console) -> None:
    """Print how well each test tells the rivals apart, and which to drive."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1))
    several = len({name for one in separated for name in one.pair}) > 2
    for name in ("next test", "signal that shows it", "d′", "information", *(["least apart"] if several else [])):
        table.add_column(name, justify="right" if name in ("d′", "information") else "left")
    for one in separated:
        information = f"{one.information:.3g} nat"
        cells = [one.test.title, label(one.signal), f"{one.distance:.1f}", information]
        cells += [" and ".join(one.pair)] if several else []
        table.add_row(*(Text(cell) for cell in cells))
    console.print(table)
    if not separated or separated[0].distance < DESIGN.decisive:
        console.print(f"None of these tests would tell them apart: d′ stays below {DESIGN.decisive:g}.", soft_wrap=True)
    else:
        best = separated[0]
        said = f"Drive: {best.test.title} ({best.test.manoeuvre.source}); watch the {label(best.signal)}."
        console.print(Text(said, style="bold"), soft_wrap=True)


def _separation(
    vehicle: Vehicle,
    rivals: Sequence[Rival],
    common: tuple[FreeParameter, ...],
    offsets: Array,
    free_parameters: Mapping[tuple[str, str], FreeParameter],
    test: Option,
) -> Separation | None:
    """None where the manoeuvre gives nothing to compare."""
    known = vehicle.values()
    start = parameters_of(vehicle)
    fitted = with_offsets(start, common, offsets)
    car = vehicle.with_parameters({name: value for name, value in fitted.values.items() if name in known})
    motion = _with_run_up(car, test)
    dataset = build_dataset([record(motion, car, DESIGN.seed, name=test.manoeuvre.name, biased=False)], vehicle)
    if not dataset.windows:
        return None
    dataset = _steered_truly(dataset, motion)
    residuals = Residuals(Predictor(vehicle, dataset))
    base = Fit(fitted, common, offsets, residuals(fitted), [], 0.0)
    for name, error in residuals.by_signal(base.residuals).items():  # of the true model: what the sensors leave
        residuals.deviation[name] = max(residuals.deviation[name], error)
    base = replace(base, residuals=residuals(fitted))
    absorbing = list(slopes_by(residuals, start, base, common))
    fits = [_rival(residuals, fitted, rival, free_parameters, test) for rival in rivals]
    worst: tuple[float, list[Array], tuple[str, str]] | None = None
    for (a, true), (b, wrong) in permutations(enumerate(fits), 2):
        off = [x - y for x, y in zip(wrong.residuals, true.residuals, strict=True)]
        weight = prior_weight(off)
        # In units in which the interval of a size weighs as much as a deviation of a base parameter.
        certain = [rivals[b].deviations[k.name] / k.deviation * np.sqrt(weight) for k in wrong.free_parameters]
        slopes = [
            np.column_stack([*columns, own * certain]) for *columns, own in zip(*absorbing, wrong.slopes, strict=True)
        ]
        change = solve(slopes, off, np.zeros(slopes[0].shape[1]), weight)
        left = [r + s @ change for r, s in zip(off, slopes, strict=True)]
        square = cost(left) + weight * float(change @ change)
        if worst is None or square < worst[0]:
            worst = square, left, (rivals[a].name, rivals[b].name)
    assert worst is not None
    apart = residuals.deviations(worst[1])
    return Separation(test, float(np.sqrt(worst[0])), max(apart, key=lambda name: apart[name]), worst[2])


def _rival(
    residuals: Residuals,
    fitted: ParameterSet,
    rival: Rival,
    free_parameters: Mapping[tuple[str, str], FreeParameter],
    test: Option,
) -> Fit:
    """The car with a rival, and the slopes of the residuals by its sizes."""
    turning = tuple(free_parameters[name, rival.forms.get(name, "")] for name in rival.sizes)
    sizes = np.array([_seen(name, size, test) for name, size in rival.sizes.items()])
    parameter_set = with_offsets(fitted, turning, sizes)
    fit = Fit(parameter_set, turning, sizes, residuals(parameter_set), [], 0.0)
    columns = slopes_by(residuals, fitted, fit, turning)
    return replace(fit, slopes=[np.column_stack(window) for window in zip(*columns, strict=True)])


def _seen(name: str, size: float, test: Option) -> float:
    """A size as the test meets it: driven in the other direction, a road slopes the other way."""
    _, effect, _ = name.split(".")
    road = BY_ID[effect].slope is not Effect.slope
    return -size if test.opposite and road else size


def _steered_truly(dataset: Dataset, motion: Trajectory) -> Dataset:
    """The dataset without the noise of the steering angle, to which the models would respond although the car did
    not."""
    steering = {name for name, sensor in dataset.sensors.items() if sensor.kind == "steering"}
    windows = []
    for window in dataset.windows:
        true = {
            name: replace(readings, value=np.interp(readings.t, motion.t, motion.inputs[:, 0])[:, None])
            for name, readings in window.readings.items()
            if name in steering
        }
        windows.append(replace(window, readings={**window.readings, **true}))
    return replace(dataset, windows=tuple(windows))


def _with_run_up(car: Vehicle, test: Option) -> Trajectory:
    """The drive after a straight run that is as long as the beginning of a window that is not compared."""
    motion = drive(test.manoeuvre.name, car)
    count = round((WINDOWS.run_in + 0.5) * 1e3)
    q, u = rolling_straight(car, test.manoeuvre.speed)
    run = Trajectory.unfilled(np.linspace(0.0, count * 1e-3, count, endpoint=False))
    run.q[:], run.u[:], run.udot[:], run.wheels[:], run.inputs[:] = q, u, 0.0, motion.wheels[0], 0.0
    run.q[:, 0] = motion.q[0, 0] + test.manoeuvre.speed * 1e-3 * (np.arange(count) - count)
    whole = Trajectory(
        np.append(run.t, motion.t + count * 1e-3),
        *(
            np.concatenate([getattr(run, part), getattr(motion, part)])
            for part in ("q", "u", "udot", "wheels", "inputs")
        ),
    )
    if test.opposite:
        whole.q[:, :2] *= -1
        whole.q[:, YAW] += np.pi
    return whole
