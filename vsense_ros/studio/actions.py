"""Every action of the page as the command line and as Python, to be copied: the same calls that the page makes."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vsense_ros.studio.project import Drive

_NEEDED = ("mass", "wheelbase", "track", "tyre")  # values without which no vehicle is made


@dataclass(frozen=True)
class Action:
    """One action in two ways of writing it."""

    command: str
    python: str


def _command(*words: str, drives: Sequence[Drive] = ()) -> str:
    """A command line, after those that import the `drives` whose logs need a mapping."""
    lines = [
        ("vsense", "import", drive.path, _bag(drive), *_reading(drive)) for drive in drives if drive.mapping
    ]  # fmt: skip
    return "\n".join(" ".join(shlex.quote(word) for word in line if word) for line in (*lines, words))


def _reading(drive: Drive) -> list[str]:
    options = ["--mapping", drive.mapping] if drive.mapping else []
    return [*options, "--dbc", drive.database] if drive.database else options


def _bag(drive: Drive) -> str:
    """Path of a recording as commands take it: that of the bag that is imported of a log with a mapping."""
    return str(Path(drive.path).with_suffix("")) if drive.mapping else drive.path


def _source(drive: Drive) -> str:
    given = _given(mapping=drive.mapping, dbc=drive.database)
    return f"vs.read({drive.path!r}{given})" if given else repr(drive.path)


def _sources(drives: Sequence[Drive]) -> str:
    return "[" + ", ".join(map(_source, drives)) + "]"


def _given(**options: object) -> str:
    return "".join(f", {name}={value!r}" for name, value in options.items() if value)


def new_vehicle(path: str, values: dict[str, object]) -> Action:
    """Write a vehicle file from catalogue values."""
    stated = {name: value for name, value in values.items() if value not in (None, "")}
    options = [word for name, value in stated.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    needed = ", ".join(repr(stated.get(name)) for name in _NEEDED)
    others = _given(**{name: value for name, value in stated.items() if name not in _NEEDED})
    python = f"import vsense_ros as vs\n\nvs.new_vehicle({needed}{others}).write({path!r})"
    return Action(_command("vsense", "new-vehicle", path, *options), python)


def check_vehicle(vehicle: str, drives: Sequence[Drive] = ()) -> Action:
    """Check a vehicle file, with recordings or alone."""
    recordings = f", {_sources(drives)}" if drives else ""
    python = f"import vsense_ros as vs\n\nprint(*vs.check({vehicle!r}{recordings}).sentences(), sep='\\n')"
    return Action(_command("vsense", "check", vehicle, *map(_bag, drives), drives=drives), python)


def info(drive: Drive) -> Action:
    """List the signals of a recording."""
    python = f"import vsense_ros as vs\n\nprint(*vs.info({_source(drive)}).problems, sep='\\n')"
    return Action(_command("vsense", "info", drive.path, *_reading(drive)), python)


def join(drives: Sequence[Drive], target: str) -> Action:
    """Join several recordings of one drive."""
    options = [word for drive in drives for word in _reading(drive)]
    python = (
        "import vsense_ros as vs\nfrom vsense_ros.bag import write_bag\nfrom vsense_ros.bag.join import joined\n\n"
        f"parts = [vs.read(one) for one in {_sources(drives)}]\nwrite_bag({target!r}, joined(parts))"
    )
    return Action(_command("vsense", "import", *(drive.path for drive in drives), target, *options), python)


def calibrate(vehicle: str, drives: Sequence[Drive], target: str) -> Action:
    """Calibrate the sensors of a car."""
    python = (
        "import vsense_ros as vs\nfrom vsense_ros.api.preparation import write_calibration\n\n"
        f"found = vs.calibrate({_sources(drives)}, {vehicle!r})\n"
        f"write_calibration(found, {target!r}, {vehicle!r})"
    )
    words = ("vsense", "calibrate", *map(_bag, drives), "--vehicle", vehicle, "--output", target)
    return Action(_command(*words, drives=drives), python)


def observability(vehicle: str, drive: Drive, filter: str) -> Action:
    """Which states of a filter a drive determines."""
    python = (
        "import vsense_ros as vs\nfrom vsense_ros.assess import observability\n\n"
        f"found = observability.report(vs.read({_source(drive)}), vs.load_vehicle({vehicle!r}), {filter!r})"
    )
    words = ("vsense", "observability", _bag(drive), "--vehicle", vehicle, "--filter", filter)
    return Action(_command(*words, drives=[drive]), python)


def run(vehicle: str, drive: Drive, filter: str, *, mend: bool, smooth: bool) -> Action:
    """Estimate a recording."""
    words = ["vsense", "run", _bag(drive), "--vehicle", vehicle]
    words += ["--filter", filter] if filter else []
    words += ["--mend"] if mend else []
    words += ["--smooth"] if smooth else []
    arguments = _given(filter=filter, mend=mend, smooth=smooth)
    python = (
        f"import vsense_ros as vs\n\nresult = vs.estimate({_source(drive)}, {vehicle!r}{arguments})\n"
        'slip = result["side_slip"]\nprint(slip.value, slip.sigma, slip.coverage)'
    )
    return Action(_command(*words, "--report", drives=[drive]), python)


def identify(vehicle: str, drives: Sequence[Drive], held_out: Sequence[Drive], model: str) -> Action:
    """Identify the parameters of a car."""
    words = ["vsense", "identify", *map(_bag, drives), "--vehicle", vehicle, "--model", model]
    words += ["--hold-out", *map(_bag, held_out)] if held_out else []
    python = (
        f"import vsense_ros as vs\n\nfound = vs.identify({_sources(drives)}, {vehicle!r}, model={model!r}, "
        f"hold_out={_sources(held_out)})\nfound.vehicle"
    )
    return Action(_command(*words, drives=[*drives, *held_out]), python)


def explain(
    vehicle: str, drives: Sequence[Drive], held_out: Sequence[Drive], *, by_lap: bool, mend: bool, observe: bool
) -> Action:
    """Name what the model of a car leaves out."""
    words = ["vsense", "explain", *map(_bag, drives), "--vehicle", vehicle]
    words += ["--hold-out", *map(_bag, held_out)] if held_out else []
    words += ["--laps"] if by_lap else []
    words += ["--mend"] if mend else []
    words += [] if observe else ["--no-observer"]
    arguments = _given(by_lap=by_lap, mend=mend) + ("" if observe else ", observe=False")
    python = (
        f"import vsense_ros as vs\n\nfound = vs.explain({_sources(drives)}, {vehicle!r}, hold_out={_sources(held_out)}"
        f"{arguments})\nprint(found.answer.sentence)"
    )
    return Action(_command(*words, drives=[*drives, *held_out]), python)
