"""Best & Bogdanski 2016 again: a car identified from its CAN bus by Kalman filters, on a twin whose truth is known.

The twin is the car of their table 1 (best_twin.py). It is identified from one drive of 100 s by the extended and by
the unscented filter, three times with other drivers, noise and starts, then examined on manoeuvres that nothing was
fitted to. The paper's own settings are run beside.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from studies import best_twin
from studies.best_twin import Twin
from vsense_ros.estimation.filter import Array
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification import best
from vsense_ros.identification.information import Information, Refusal, information, refusals
from vsense_ros.identification.open_loop import OpenLoop
from vsense_ros.identification.progress import Progress
from vsense_ros.identification.rinsing import (
    Drive,
    Identifier,
    Kind,
    Noise,
    Pass,
    Rinsed,
    Schedule,
    rinse,
)
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import PAPER, REACH, SYMBOLS, Best4Dof

SEEDS = (0, 1, 2)
PAPER_DENSITY = 1e-7  # of the paper's P(0) and Q, in the units of its table
SECONDS = 100.0  # of the drive
WRONG = 0.3  # of its value, by which a parameter may be off at the start
FREE = tuple(SYMBOLS)
TRUTH = np.array([PAPER[name] for name in FREE])
UNITS = np.array([unit for _, unit in SYMBOLS.values()])
KINDS: Mapping[str, Kind] = {"iekf": "extended", "iukf": "unscented"}
HEIGHTS = ("front_roll_centre_height", "rear_roll_centre_height")  # that are free, too, in the paper's case h+
LITERAL_PASSES = {"iekf": 200, "iukf": 40}
STATE_UNITS = (1.0,) * 5 + (1e3,) * 8  # in which the paper's Q is 1e-7: forces in kN
# Printed in table 1 (IEKF, UKF; h+ at pass 200), and a pass of 100 s in MATLAB [s].
PRINTED = {
    "hG": (0.533, 0.532, 0.633), "Izz": (2.069, 2.086, 2.214), "Kphi": (1.152, 1.147, 1.692),
    "Bphi": (0.615, 0.608, 1.010), "Kxf": (3.299, 3.291, 3.116), "Kxr": (0.966, 0.966, 1.036),
    "Caf": (0.625, 0.627, 0.665), "Car": (1.283, 1.286, 1.311), "Cf": (2.042, 2.043, 1.801),
    "Df": (1.103, 1.102, 1.051),
    "Ef": (0.630, 0.632, 0.724), "Cr": (1.653, 1.652, 1.085), "Dr": (0.954, 0.955, 1.155), "Er": (0.720, 0.714, 0.711),
}  # fmt: skip
PRINTED_SECONDS = {"iekf": 266.0, "iukf": 212.0}
UNFITTED = ("speed", "lateral_velocity", "yaw_rate", "roll")


@dataclass(frozen=True)
class Identified:
    """One drive, identified by one filter: what it began with, its passes, and the information in the drive."""

    drive: Drive
    start: Array
    rinsed: Rinsed
    information: Information

    @property
    def curve_errors(self) -> Array:
        """Root mean square error of each force curve, of its peak (4,)."""
        return curve_errors(self.rinsed.values)


@dataclass(frozen=True)
class HPlus:
    """The case with free roll centres: what was refused after which pass, the weakest direction, and the paper's
    settings beside."""

    refused: list[Refusal]
    direction: str
    detected_at: int
    rinsed: Rinsed
    literal: Rinsed
    values: Array  # true ones (16,)

    @property
    def detected(self) -> bool:
        """True if it was called unidentifiable before pass 20."""
        return bool(self.refused) and self.detected_at < 20


@dataclass(frozen=True)
class Repeated:
    """All that the repetition came to."""

    twins: dict[int, Twin]
    identified: dict[str, list[Identified]]  # by filter, one for each seed
    filtered: list[Identified]  # by the extended filter, of signals that were low-passed as the paper's
    literal: dict[str, Rinsed]
    h_plus: HPlus
    validation: dict[str, tuple[Twin, Array, Array]]  # by manoeuvre: outputs and states of the identified model
    peer_seconds: float | None  # a pass of filterpy's UKF
    wall_seconds: float  # the three identifications by the extended filter


def curve_errors(values: Array) -> Array:
    """Root mean square error of the force curves with these free parameters, of their peaks (4,)."""
    truth = best_4dof.curves(PAPER)
    curves = best_4dof.curves(PAPER | dict(zip(FREE, values.tolist(), strict=True)))
    return np.asarray(np.sqrt((((curves - truth) / truth.max(axis=1)[:, None]) ** 2).mean(axis=1)))


def curve_bands(of_drive: Information) -> Array:
    """Standard deviation along each force curve of `REACH`, of its peak (4, points): what a drive determines where the
    shape and the curvature of a tyre are not observable separately."""

    return np.apply_along_axis(of_drive.deviation_of, 0, curve_slopes(of_drive.values)[0])


def curve_slopes(values: Array) -> tuple[Array, Array]:
    """Derivatives of each force curve of `REACH` by the free parameters at these values, of its peak
    (14, 4, points), and the peaks (4, 1) [N]."""

    def curves(values: Array) -> Array:
        return best_4dof.curves(PAPER | dict(zip(FREE, values.tolist(), strict=True)))

    steps = np.diag(1e-4 * np.abs(values))
    peak = curves(values).max(axis=1)[:, None]
    return np.array([(curves(values + s) - curves(values - s)) / (2 * s.sum() * peak) for s in steps]), peak


def wrong_start(seed: int, names: tuple[str, ...] = FREE, by: float = WRONG) -> dict[str, float]:
    """The car's parameters, with these off by up to a share of themselves."""
    random = np.random.default_rng(1000 + seed)
    off = {name: PAPER[name] * (1 + random.uniform(-by, by)) for name in names}
    return PAPER | off


def identify(drive: Drive, start: Mapping[str, float], kind: Kind = "extended") -> Identified:
    """One drive by one filter."""
    one = best.identifier(start, FREE, kind=kind)
    rinsed = rinse(one, [drive])
    of_drive = information(best.identifier(start, FREE), [drive], rinsed.values, best.prior(PAPER, FREE))
    return Identified(drive, one.begin(), rinsed, of_drive)


def repeat(
    seeds: tuple[int, ...] = SEEDS, progress: Progress | None = None, literal: Mapping[str, int] = LITERAL_PASSES
) -> Repeated:
    """Everything, in some two minutes."""
    jobs = 2 * len(seeds) + len(literal) + 3
    done = iter(range(1, jobs + 1))

    def report() -> None:
        if progress is not None:
            progress(next(done) / jobs)

    twins = {seed: best_twin.drive(best_twin.rich_driver(seed), SECONDS) for seed in seeds}
    drives = {seed: twin.recorded(seed, cut_off=best.SETTINGS.cut_off) for seed, twin in twins.items()}
    report()
    identified: dict[str, list[Identified]] = {name: [] for name in KINDS}
    wall = {}
    for name, kind in KINDS.items():
        begun = time.perf_counter()
        for seed in seeds:
            identified[name].append(identify(drives[seed], wrong_start(seed), kind))
            report()
        wall[name] = time.perf_counter() - begun
    first = seeds[0]
    filtered = [identify(twins[seed].recorded(seed), wrong_start(seed)) for seed in seeds]
    as_printed = {}
    for name, passes in literal.items():
        as_printed[name] = literally(twins[first].recorded(first), FREE, KINDS[name], passes)
        report()
    h_plus = free_heights(drives[first], twins[first].recorded(first), first)
    report()
    validation = validate(identified["iekf"][0].rinsed.values)
    report()
    return Repeated(
        twins, identified, filtered, as_printed, h_plus, validation, peer_pass(drives[first], wrong_start(first)),
        wall["iekf"],
    )  # fmt: skip


@dataclass(frozen=True)
class Literal2016(Schedule):
    """The paper's: P(0) = Q = 1e-7 I in the units of its table before every pass, R the variance of the innovations of
    the pass before, and so many passes whatever they change."""

    units: tuple[float, ...] = ()  # of the free parameters in SI, (p,)
    passes: int = 200
    ends: bool = False  # where the curves stand still

    def deviations(self, index: int, scales: Array) -> Array:
        """Deviations of the free parameters before this pass, (p,)."""
        return PAPER_DENSITY**0.5 * np.array(self.units)

    def may_end(self, index: int) -> bool:
        """True if a pass in which nothing moves may be the last."""
        return self.ends

    def variance(self, before: Pass | None, outputs: Sequence[float]) -> Array:
        """Variance of the innovations of the pass before, (m,)."""
        return super().variance(None, outputs) if before is None else before.variance


def literal_noise(outputs: Sequence[float], units: Sequence[float], states: Sequence[str]) -> Noise:
    """The paper's: P(0) = Q = 1e-7 I in these units (n,) of the states."""
    deviations = PAPER_DENSITY**0.5 * np.asarray(units, dtype=float)
    return Noise(outputs, deviations, dict(zip(states, deviations.tolist(), strict=True)))


def literally(drive: Drive, free: tuple[str, ...], kind: Kind = "extended", passes: int = 200) -> Rinsed:
    """The paper's settings, from a start that is 4 to 12 % off."""
    random = np.random.default_rng(1)
    off = random.choice([-1, 1], len(free)) * random.uniform(0.04, 0.12, len(free))
    start = PAPER | {name: PAPER[name] * (1 + share) for name, share in zip(free, off, strict=True)}
    units = np.array([SYMBOLS[name][1] if name in SYMBOLS else 1.0 for name in free])
    peak = best_4dof.curves(PAPER).max(axis=1)[:, None]
    one = Identifier(
        Best4Dof(), start, free, literal_noise((0.2, 0.2, 0.02), STATE_UNITS, Best4Dof.states), kind=kind,
        curves=lambda p: best_4dof.curves(p) / peak, drifts=PAPER_DENSITY**0.5 * units,
    )  # fmt: skip
    return rinse(one, [replace(drive, every=1)], Literal2016(units=tuple(units.tolist()), passes=passes))


def free_heights(drive: Drive, low_passed: Drive, seed: int) -> HPlus:
    """The case h+: the heights of the roll centres are free, too. It is judged after each pass."""
    free = (*FREE, *HEIGHTS)
    values = np.array([PAPER[name] for name in free])
    one = best.identifier(wrong_start(seed, free), free)
    rinsed = rinse(one, [drive])
    refused: list[Refusal] = []
    at, direction = 0, ""
    for made in rinsed.passes:
        at += 1
        of_drive = information(one, [drive], made.values, best.prior(PAPER, free))
        refused = refusals(of_drive, best_4dof.JUDGED_BY_CURVE)
        direction = str(of_drive.weakest(best_4dof.JUDGED_BY_CURVE))
        if refused:
            break
    return HPlus(refused, direction, at, rinsed, literally(low_passed, free), values)


def validate(values: Array) -> dict[str, tuple[Twin, Array, Array]]:
    """The identified model alone on manoeuvres that it was not fitted to."""
    runs = {
        "step steer, then braking": best_twin.drive(best_twin.step_then_brake, 20.0, speed=22.0),
        "straight, accelerating and braking": best_twin.drive(best_twin.straight, 30.0, speed=12.0),
        "constant speed, random steering": best_twin.drive(best_twin.random_steering(7), 40.0, speed=20.0),
        "identification": best_twin.drive(best_twin.rich_driver(SEEDS[0]), SECONDS),
    }
    model = OpenLoop(Best4Dof(), PAPER, FREE)
    twins = {}
    for name, twin in runs.items():
        drive = twin.recorded(99, name)
        twins[name] = (twin, model.outputs(drive, values), model.states(drive, values))
    return twins


def fits(result: Repeated) -> dict[str, dict[str, float]]:
    """By manoeuvre and signal, 1 - RMS error / standard deviation; no signal that does not move."""
    made: dict[str, dict[str, float]] = {}
    for name, (twin, outputs, states) in result.validation.items():
        signals = dict(zip(Best4Dof.outputs, zip(twin.clean.T, outputs.T, strict=True), strict=True))
        for state in UNFITTED:
            at = Best4Dof.states.index(state)
            signals[state] = (twin.states[:, at], states[:, at])
        made[name] = {
            signal: fit(truth, model) for signal, (truth, model) in signals.items() if np.std(truth) > _still(signal)
        }
    return made


def _still(signal: str) -> float:
    """Less than this standard deviation is no movement of a signal."""
    return 0.3 if "acceleration" in signal or signal == "speed" else 0.005


def fit(truth: Array, model: Array) -> float:
    """1 - RMS error / standard deviation."""
    return float(1 - np.sqrt(np.mean((model - truth) ** 2)) / np.std(truth))


def peer_pass(drive: Drive, start: Mapping[str, float], steps: int = 150) -> float | None:
    """Processor time [s] of a pass of filterpy's unscented filter with 27 states and our compiled equations, from some
    steps; None where filterpy is not installed."""
    try:
        from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
    except ImportError:
        return None
    one = best.identifier(start, FREE, kind="unscented")
    kernels: Any = one.filter._points  # type: ignore[attr-defined]
    move, sense = (kernels._functions[name] for name in ("move", "sensor outputs"))
    size = len(one.filter.mean)
    x, u, h = np.zeros(size), np.zeros(drive.inputs.shape[1]), np.array([drive.h])
    from vsense_ros.codegen import Kernel

    moved = Kernel(move, [x, u, one.filter.parameters, h])  # type: ignore[attr-defined]
    sensed = Kernel(sense, [x, u, one.filter.parameters])  # type: ignore[attr-defined]

    def along(state: Array, _: float) -> Array:
        x[:] = state
        moved.call()
        return moved.results[0][:, 0].copy()

    def seen(state: Array) -> Array:
        x[:] = state
        sensed.call()
        return sensed.results[0][:, 0].copy()

    peer = UnscentedKalmanFilter(size, 3, drive.h, seen, along, JulierSigmaPoints(size, kappa=1.0))
    peer.x = np.concatenate([drive.start, one.begin()])
    peer.P = np.diag(np.concatenate([np.square(best.SETTINGS.start_deviations), (0.03 * one.begin()) ** 2]))
    peer.R, peer.Q = (
        np.diag(np.square(best.SETTINGS.output_deviations)),
        np.diag([1e-4] * 5 + [1e3] * 8 + [1e-12] * len(FREE)),
    )
    begun = time.process_time()
    for k in range(steps):
        u[:] = drive.inputs[k]
        peer.predict()
        peer.update(drive.outputs[k])
    return (time.process_time() - begun) * len(drive.inputs) / steps


def content(result: Repeated) -> dict[str, Any]:
    """What is written as JSON."""
    iekf, iukf = (np.array([one.rinsed.values for one in result.identified[name]]) for name in KINDS)
    errors = np.median(np.abs(iekf / TRUTH - 1), axis=0) * 100
    twin = {
        SYMBOLS[name][0]: {
            "truth": float(TRUTH[i] / UNITS[i]), "iekf": float(np.median(iekf[:, i]) / UNITS[i]),
            "iukf": float(np.median(iukf[:, i]) / UNITS[i]), "error_percent": float(errors[i]),
        }
        for i, name in enumerate(FREE)
    }  # fmt: skip
    curves = np.median([one.curve_errors for one in result.identified["iekf"]], axis=0) * 100
    worst: dict[str, float] = {}
    for name, signals in fits(result).items():
        if name != "identification":
            for signal, value in signals.items():
                worst[signal] = min(value, worst.get(signal, 1.0))
    return {
        "twin": twin,
        "curves_percent_of_peak": {
            name.replace(" ", "_"): float(value) for name, value in zip(REACH, curves, strict=True)
        },
        "pass_s": {
            name: float(np.median([made.seconds for one in drives for made in one.rinsed.passes]))
            for name, drives in result.identified.items()
        },
        "passes": max(len(one.rinsed.passes) for drives in result.identified.values() for one in drives),
        "h_plus": {"detected": result.h_plus.detected, "directions": [result.h_plus.direction]},
        "validation": worst,
    }


def write(result: Repeated, path: Path) -> None:
    """Write the result as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(json.dumps(content(result), indent=2) + "\n")


def show(result: Repeated, out: Console) -> None:
    """Tables for the terminal."""
    made = content(result)
    out.print(
        "Table 1 on the twin, median of seeds; units of the paper (m, Mg m², 1e5 N m/rad, 1e4 N m s/rad, 1e5 N/rad)"
    )
    out.print(_parameters(result, made))
    out.print(
        "3σ: of this drive alone, prior 30 %. low-passed: signals that went through the paper's 10 Hz filters.\n"
        "paper's settings: P(0) = Q = 1e-7 I in every pass, R of the innovations, low-passed, IEKF after "
        f"{len(result.literal['iekf'].passes)} passes from a start 4 to 12 % off."
    )
    out.print()
    out.print(_curves(result))
    out.print()
    out.print(_times(result, made))
    out.print(f"Passes: {made['passes']} at most; the paper makes 200. Three identifications took "
              f"{result.wall_seconds:.1f} s by the clock.")  # fmt: skip
    out.print()
    table = plain_table("open loop fit, 1 - RMS/σ", *_signals(result), right=_signals(result))
    for name, signals in fits(result).items():
        table.add_row(name, *(f"{signals[s]:.3f}" if s in signals else "–" for s in _signals(result)))
    out.print(table)
    out.print()
    for sentence in h_plus_in_words(result.h_plus):
        out.print(sentence)


def h_plus_in_words(case: HPlus) -> list[str]:
    """What is said of free roll centres."""
    lines = [f"h+ (roll centres free, too): called unidentifiable after pass {case.detected_at}."
             if case.detected else "h+ (roll centres free, too): not called unidentifiable."]  # fmt: skip
    lines += [f"  {one}." for one in case.refused]
    lines.append(f"  The weakest direction is {case.direction}: roll moves the body about an axis whose height only "
                 "the load transfer distinguishes from that of the centre of gravity.")  # fmt: skip
    off = 100 * (case.literal.passes[-1].values / case.values - 1)
    ten = 100 * (case.literal.passes[-1].values / case.literal.passes[-11].values - 1)
    lines.append(
        f"  With the paper's settings, after {len(case.literal.passes)} passes hG is {off[0]:+.1f} % off, Kphi "
        f"{off[2]:+.1f} %, hRf {off[-2]:+.0f} %, hRr {off[-1]:+.0f} %; the last ten passes moved hG by "
        f"{ten[0]:+.2f} %, "
        f"Kphi by {ten[2]:+.2f} %. They do not run away as the paper's do: this plant has no error of its model."
    )
    return lines


def _signals(result: Repeated) -> list[str]:
    return list(dict.fromkeys(signal for signals in fits(result).values() for signal in signals))


def _parameters(result: Repeated, made: Mapping[str, Any]) -> Table:
    headings = ("paper\nIEKF", "paper\nUKF", "truth", "IEKF", "IUKF", "IEKF\nerror %", "worst\nerror %",
                "IUKF to\nIEKF %",
                "3σ %", "low-\npassed %", "paper's\nsettings %")  # fmt: skip
    table = plain_table("", *headings, right=headings)
    all_errors = np.array([one.rinsed.values / TRUTH - 1 for one in result.identified["iekf"]]) * 100
    filtered = np.array([one.rinsed.values / TRUTH - 1 for one in result.filtered]) * 100
    literal = 100 * (result.literal["iekf"].values / TRUTH - 1)
    three = 300 * result.identified["iekf"][0].information.deviations / TRUTH
    apart = between(result)
    for i, name in enumerate(FREE):
        symbol = SYMBOLS[name][0]
        row, printed = made["twin"][symbol], PRINTED[symbol]
        table.add_row(
            symbol, *(f"{value:.3f}" for value in (*printed[:2], row["truth"], row["iekf"], row["iukf"])),
            f"{row['error_percent']:.1f}", f"{all_errors[np.argmax(np.abs(all_errors[:, i])), i]:+.1f}",
            f"{apart[i]:.1f}", f"{three[i]:.1f}", f"{np.median(np.abs(filtered[:, i])):.1f}", f"{literal[i]:+.1f}",
        )  # fmt: skip
    return table


def between(result: Repeated) -> Array:
    """How far the two filters end from one another, at most (14,) [%]."""
    iekf, iukf = (np.array([one.rinsed.values for one in result.identified[name]]) for name in KINDS)
    return np.asarray(np.abs(iukf / iekf - 1).max(axis=0) * 100)


def _curves(result: Repeated) -> Table:
    headings = ("start", "IEKF", "IEKF\nstated 1σ", "IUKF", "IEKF\nlow-passed", "paper's\nsettings", "IUKF to\nIEKF")
    table = plain_table("force curves, RMS error, % of peak", *headings, right=headings)
    columns = [
        np.median([curve_errors(one.start) for one in result.identified["iekf"]], axis=0),
        np.median([one.curve_errors for one in result.identified["iekf"]], axis=0),
        np.median(
            [np.sqrt(np.mean(curve_bands(one.information) ** 2, axis=1)) for one in result.identified["iekf"]], axis=0
        ),
        np.median([one.curve_errors for one in result.identified["iukf"]], axis=0),
        np.median([one.curve_errors for one in result.filtered], axis=0),
        curve_errors(result.literal["iekf"].values),
        curves_between(result),
    ]
    for i, name in enumerate(REACH):
        table.add_row(name, *(f"{100 * column[i]:.2f}" for column in columns))
    return table


def curves_between(result: Repeated) -> Array:
    """RMS distance of the curves of the two filters, of their peaks, at most (4,)."""
    peak = best_4dof.curves(PAPER).max(axis=1)[:, None]
    bands = []
    for one, other in zip(*result.identified.values(), strict=True):
        pair = [best_4dof.curves(PAPER | dict(zip(FREE, o.rinsed.values.tolist(), strict=True))) for o in (one, other)]
        bands.append(np.sqrt((((pair[0] - pair[1]) / peak) ** 2).mean(axis=1)))
    return np.asarray(np.max(bands, axis=0))


def _times(result: Repeated, made: Mapping[str, Any]) -> Table:
    table = plain_table("a pass of 100 s, processor time", "s", "paper (MATLAB) s", right=("s", "paper (MATLAB) s"))
    for name, seconds in made["pass_s"].items():
        table.add_row(name.upper(), f"{seconds:.3f}", f"{PRINTED_SECONDS[name]:.0f}")
    peer = "filterpy is not installed" if result.peer_seconds is None else f"{result.peer_seconds:.1f}"
    table.add_row("filterpy's UKF, 27 states, our compiled equations", peer, "")
    return table
