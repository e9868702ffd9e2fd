"""Every action of the page as the command line and as Python, to be copied: the same calls that the page makes."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from vsense_ros.studio.project import Drive


@dataclass(frozen=True)
class Action:
    """One action in two ways of writing it."""

    command: str
    python: str


def _command(*words: str) -> str:
    return " ".join(word if word == "\\" else shlex.quote(word) for word in words if word)


def _paths(drives: Sequence[Drive]) -> str:
    return "[" + ", ".join(repr(drive.path) for drive in drives) + "]"


def _given(**options: object) -> str:
    return "".join(f", {name}={value!r}" for name, value in options.items() if value)


def new_vehicle(path: str, values: dict[str, object]) -> Action:
    """Write a vehicle file from catalogue values."""
    stated = {name: value for name, value in values.items() if value not in (None, "")}
    options = [word for name, value in stated.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    arguments = ", ".join(f"{name}={value!r}" for name, value in stated.items())
    python = (
        "from vsense_ros.prepare.catalogue import catalogue_values\n"
        "from vsense_ros.prepare.new_vehicle import new_vehicle, write_new_vehicle\n\n"
        f"write_new_vehicle({path!r}, new_vehicle(catalogue_values({arguments})))"
    )
    return Action(_command("vsense", "new-vehicle", path, *options), python)


def check_vehicle(vehicle: str, drives: Sequence[Drive] = ()) -> Action:
    """Check a vehicle file, with recordings or alone."""
    python = (
        "from vsense_ros.api.recording import read_all\n"
        "from vsense_ros.prepare.vehicle_check import check_vehicle\n\n"
        f"(drives,) = read_all({_paths(drives)})\n"
        f"for sentence in check_vehicle({vehicle!r}, drives).sentences():\n    print(sentence)"
    )
    return Action(_command("vsense", "check", vehicle, *(drive.path for drive in drives)), python)


def info(drive: Drive) -> Action:
    """List the signals of a recording."""
    given = _given(mapping=drive.mapping, dbc=drive.database)
    options = ["--mapping", drive.mapping] if drive.mapping else []
    options += ["--dbc", drive.database] if drive.database else []
    python = f"import vsense_ros as vs\n\nfound = vs.info({drive.path!r}{given})\nprint(*found.problems, sep='\\n')"
    return Action(_command("vsense", "info", drive.path, *options), python)


def join(drives: Sequence[Drive], target: str) -> Action:
    """Join several recordings of one drive."""
    mappings = [word for drive in drives if drive.mapping for word in ("--mapping", drive.mapping)]
    python = (
        "import vsense_ros as vs\nfrom vsense_ros.bag import write_bag\nfrom vsense_ros.bag.join import joined\n\n"
        + "parts = ["
        + ", ".join(f"vs.read({drive.path!r}{_given(mapping=drive.mapping, dbc=drive.database)})" for drive in drives)
        + f"]\nwrite_bag({target!r}, joined(parts))"
    )
    return Action(_command("vsense", "import", *(drive.path for drive in drives), target, *mappings), python)


def calibrate(vehicle: str, drives: Sequence[Drive], target: str) -> Action:
    """Calibrate the sensors of a car."""
    python = (
        "import vsense_ros as vs\nfrom vsense_ros.api.recording import read_all\n"
        "from vsense_ros.prepare.calibration import calibrate\n\n"
        f"(drives,) = read_all({_paths(drives)})\nfound = calibrate(drives, vs.load_vehicle({vehicle!r}))"
    )
    paths = (drive.path for drive in drives)
    return Action(_command("vsense", "calibrate", *paths, "--vehicle", vehicle, "--output", target), python)


def observability(vehicle: str, drive: Drive, filter: str) -> Action:
    """Which states of a filter a drive determines."""
    python = (
        "import vsense_ros as vs\nfrom vsense_ros.assess import observability\n\n"
        f"found = observability.report(vs.read({drive.path!r}), vs.load_vehicle({vehicle!r}), {filter!r})"
    )
    return Action(_command("vsense", "observability", drive.path, "--vehicle", vehicle, "--filter", filter), python)


def run(vehicle: str, drive: Drive, filter: str, *, mend: bool, smooth: bool) -> Action:
    """Estimate a recording."""
    words = ["vsense", "run", drive.path, "--vehicle", vehicle]
    words += ["--filter", filter] if filter else []
    words += ["--mend"] if mend else []
    words += ["--smooth"] if smooth else []
    source = f"vs.read({drive.path!r}{_given(mapping=drive.mapping, dbc=drive.database)})"
    arguments = _given(filter=filter, mend=mend, smooth=smooth)
    python = (
        f"import vsense_ros as vs\n\nresult = vs.estimate({source}, {vehicle!r}{arguments})\n"
        'slip = result["side_slip"]\nprint(slip.value, slip.sigma, slip.coverage)'
    )
    return Action(_command(*words, "--report"), python)


def identify(vehicle: str, drives: Sequence[Drive], held_out: Sequence[Drive], model: str) -> Action:
    """Identify the parameters of a car."""
    words = ["vsense", "identify", *(drive.path for drive in drives), "--vehicle", vehicle, "--model", model]
    words += ["--hold-out", *(drive.path for drive in held_out)] if held_out else []
    python = (
        f"import vsense_ros as vs\n\nfound = vs.identify({_paths(drives)}, {vehicle!r}, model={model!r}, "
        f"hold_out={_paths(held_out)})\nfound.vehicle"
    )
    return Action(_command(*words), python)


def explain(
    vehicle: str, drives: Sequence[Drive], held_out: Sequence[Drive], *, by_lap: bool, mend: bool, observe: bool
) -> Action:
    """Name what the model of a car leaves out."""
    words = ["vsense", "explain", *(drive.path for drive in drives), "--vehicle", vehicle]
    words += ["--hold-out", *(drive.path for drive in held_out)] if held_out else []
    words += ["--laps"] if by_lap else []
    words += ["--mend"] if mend else []
    words += [] if observe else ["--no-observer"]
    arguments = _given(by_lap=by_lap, mend=mend) + ("" if observe else ", observe=False")
    python = (
        f"import vsense_ros as vs\n\nfound = vs.explain({_paths(drives)}, {vehicle!r}, hold_out={_paths(held_out)}"
        f"{arguments})\nprint(found.answer.sentence)"
    )
    return Action(_command(*words), python)
