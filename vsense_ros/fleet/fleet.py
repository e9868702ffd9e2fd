"""Many cars at once: each vehicle of a fleet is explained in a process of its own, and its result is kept.

A fleet is a folder with one folder for each vehicle. The recordings of a vehicle are explained together, because what
is named must hold on recordings that were left out of the fit.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Literal

import dask
from distributed import Client, LocalCluster, as_completed, get_worker
from pydantic import BaseModel, ConfigDict, ValidationError

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.answer_schema import Answer, EffectEntry, read_answer
from vsense_ros.mismatch.design import designed
from vsense_ros.mismatch.explain import Explanation, explain_recordings, stepwise
from vsense_ros.mismatch.windows import LEFT_OUT, build_dataset
from vsense_ros.model.vehicle import Vehicle

VEHICLE_FILE = "vehicle.yaml"
HELD_OUT = "held_out"
RESULT = "result.json"
TABLE = "fleet.parquet"  # of all vehicles, by which the results of a fleet are known
FAULT = "fault.txt"
FAILED: Literal["failed"] = "failed"  # the verdict where the search itself broke down
_PROGRESS = "vsense_fleet_progress"
_LAYOUT = (
    f"expected one folder for each vehicle, with its recordings, {VEHICLE_FILE} (or one beside the folders, for all "
    f"that have none), and those to prove it on in {HELD_OUT}/"
)


Role = Literal["training", "held_out"]


@dataclass(frozen=True)
class Member:
    """One vehicle of a fleet: its name, its file, and its recordings by name below its folder."""

    name: str
    vehicle: Path | None
    training: Mapping[str, Path]
    held_out: Mapping[str, Path]

    @property
    def recordings(self) -> list[tuple[str, Role, Path]]:
        """Name, role and path of all of them."""
        roles: tuple[tuple[Role, Mapping[str, Path]], ...]
        roles = (("training", self.training), ("held_out", self.held_out))
        return [(name, role, path) for role, paths in roles for name, path in paths.items()]


class RecordingUse(BaseModel):
    """A recording of a vehicle, and the reason why it was not used, empty where it was."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    role: Role
    reason: str


class NoAnswer(BaseModel):
    """Why there is no answer about a vehicle."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    verdict: Literal["failed", "not_assessable"]
    sentence: str


class Result(BaseModel):
    """What came of one vehicle; `key` changes with whatever the answer depends on, and is empty where there is none."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    key: str
    vehicle: str
    recordings: tuple[RecordingUse, ...]
    outcome: Answer | NoAnswer

    @property
    def answer(self) -> Answer | None:
        return self.outcome if isinstance(self.outcome, Answer) else None

    @property
    def in_answer(self) -> tuple[EffectEntry, ...]:
        """The effects that are named, or that cannot be told apart."""
        return self.outcome.in_answer if isinstance(self.outcome, Answer) else ()

    def as_json(self) -> dict[str, Any]:
        """The content of result.json."""
        return self.model_dump(exclude_defaults=True)


# Of a vehicle and the folder for its results; the progress takes a share, 0 to 1.
Work = Callable[[Member, Path, Callable[[float], None]], Result]


def members(folder: Path) -> list[Member]:
    """The vehicles of a fleet. Raises `InputError` where there is none, or where results lie among them."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; {_LAYOUT}")
    common = folder / VEHICLE_FILE
    vehicles = []
    for place in sorted(folder.iterdir()):
        if not place.is_dir() or place.name.startswith("."):
            continue
        for table in (*place.glob(TABLE), *place.glob(f"*/{TABLE}")):
            raise InputError(f"{place}: expected a vehicle, found results of a fleet ({table}); move them elsewhere")
        own = place / VEHICLE_FILE
        training, held_out = _recordings(place), _recordings(place / HELD_OUT)
        if own.is_file() or training or held_out:
            vehicle = next((path for path in (own, common) if path.is_file()), None)
            held_out = {f"{HELD_OUT}/{name}": path for name, path in held_out.items()}
            vehicles.append(Member(place.name, vehicle, training, held_out))
    if not vehicles:
        raise InputError(f"{folder}: no vehicle in it; {_LAYOUT}")
    return vehicles


def _recordings(folder: Path) -> dict[str, Path]:
    """What may be recordings: all that is not a vehicle file."""
    if not folder.is_dir():
        return {}
    return {
        path.name: path
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and path.name != HELD_OUT
        and path.suffix not in (".yaml", ".yml", ".md", ".txt", ".tir", ".json")
    }


def make_room(out: Path, folder: Path) -> None:
    """Make the folder `out` for the results of the fleet in `folder`. Raises `InputError` where it lies among the
    vehicles, of which it would be one the next time, or cannot be written to."""
    if out.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"{out}: expected a folder outside of {folder}, where each folder is a vehicle; name another with --report"
        )
    if reason := _unwritable(out):
        raise InputError(reason)


def _unwritable(folder: Path) -> str:
    """Why results cannot be written to a folder, which is made if need be; empty where they can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return f"{folder}: expected a folder that results can be written to, found: {error.strerror}"


@contextmanager
def workers(scheduler: str | None, count: int | None = None) -> Iterator[Client]:
    """A Dask cluster: the one at an address, or processes of this machine, as many as it has cores, one thread each.

    Processes of this machine talk by TLS with keys made for this run alone: whoever reaches a plain scheduler, as each
    user of the machine does, has it run any code.
    """
    # A recording that crashes a process does so again, and must not take other vehicles with it that wait there.
    settings = {
        "distributed.scheduler.allowed-failures": 1,
        "distributed.scheduler.worker-saturation": 1.0,
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="20s")
            except (OSError, ValueError) as error:
                raise InputError(f"no Dask scheduler at {scheduler}: {error}") from None
            with client:
                yield client
            return
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        # The scheduler and each process have an HTTP server that asks for no key: without pages, it answers nothing.
        pages: dict[str, list[str]] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
        with (
            dask.config.set(pages),
            LocalCluster(
                n_workers=count or cores,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                security=True,
                env={"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
                silence_logs=logging.ERROR,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client


def explain_fleet(
    fleet: Sequence[Member],
    out: Path,
    client: Client,
    work: Work | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Result]:
    """Result of each vehicle, in the order of the fleet, from processes that see the same files. It is kept in
    `out/<vehicle>`. An error with one vehicle does not stop the others."""
    shares = dict.fromkeys((member.name for member in fleet), 0.0)

    def at(event: tuple[float, Any]) -> None:
        name, share = event[1]
        if share > shares.get(name, 1.0):
            shares[name] = share
            progress(sum(shares.values()) / len(shares))

    client.subscribe_topic(_PROGRESS, at)

    def submitted(member: Member) -> Any:
        return client.submit(_task, work or explain_member, member, out.resolve() / member.name, pure=False)

    tasks = {submitted(member): member for member in fleet}
    results, lost = {}, []
    for task in as_completed(list(tasks), raise_errors=False):
        member = tasks[task]
        try:
            results[member.name] = task.result()
        except Exception:
            lost.append(member)
        at((0.0, (member.name, 1.0)))
    for member in lost:  # once more and alone: another vehicle may have crashed its process
        try:
            results[member.name] = submitted(member).result()
        except Exception as error:
            reason = f"the process that worked on it died: {type(error).__name__}: {error}"
            results[member.name] = _failed(member, reason)
    client.unsubscribe_topic(_PROGRESS)
    return [results[member.name] for member in fleet]


def _task(work: Work, member: Member, out: Path) -> Result:
    worker = get_worker()
    try:
        return work(member, out, lambda share: worker.log_event(_PROGRESS, (member.name, share)))
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        try:
            out.mkdir(parents=True, exist_ok=True)
            (out / FAULT).write_text(traceback.format_exc(), encoding="utf-8")
        except OSError:  # raised further, it would look like a crash of this process, and all would be done again
            return _failed(member, reason)
        return _failed(member, f"{reason}; see {FAULT}")


def _failed(member: Member, reason: str) -> Result:
    return _without_answer(member, NoAnswer(verdict=FAILED, sentence=reason))


def _refused(member: Member, reason: str) -> Result:
    return _without_answer(member, NoAnswer(verdict="not_assessable", sentence=reason))


def _without_answer(member: Member, no_answer: NoAnswer) -> Result:
    return Result(key="", vehicle=member.name, recordings=_uses(member, lambda name: ""), outcome=no_answer)


def _uses(member: Member, reason: Callable[[str], str]) -> tuple[RecordingUse, ...]:
    """All recordings, with the reason by name why one was not used."""
    return tuple(RecordingUse(name=name, role=role, reason=reason(name)) for name, role, _ in member.recordings)


def explain_member(member: Member, out: Path, progress: Callable[[float], None] = lambda share: None) -> Result:
    """Explain one vehicle, or take what an earlier run left in `out` of the same recordings, vehicle and program."""
    if member.vehicle is None:
        return _refused(member, f"no {VEHICLE_FILE} in its folder, nor in that of the fleet")
    try:
        car = load_vehicle(member.vehicle)
    except InputError as error:
        return _refused(member, str(error))
    key = _key(car, member)
    if (earlier := _kept(out, key)) is not None:
        return earlier
    if reason := _unwritable(out):  # before any computing
        return _failed(member, reason)
    explanation, reasons = _explained(member, car, progress)
    (out / RESULT).unlink(missing_ok=True)  # an earlier one, to which the files that come now do not belong
    explanation.write(out)
    answer = _with_next_test(explanation.answer, car, out)

    def unused(name: str) -> str:
        return reasons.get(name) or _unused(name, answer.remarks)

    result = Result(key=key, vehicle=member.name, recordings=_uses(member, unused), outcome=answer)
    with atomic_write(out / RESULT) as file:
        file.write(json.dumps(result.as_json(), indent=1, allow_nan=False) + "\n")
    (out / FAULT).unlink(missing_ok=True)
    return result


def _explained(member: Member, car: Vehicle, progress: Callable[[float], None]) -> tuple[Explanation, dict[str, str]]:
    """The answer about the recordings that can be used, and by name why others cannot."""
    read, reasons = _read(member)
    step = stepwise(progress)

    def explained() -> Explanation:
        training, held_out = (
            [read[name] for name in names if name in read] for names in (member.training, member.held_out)
        )
        return explain_recordings(training, car, held_out, progress=step, observe=True)

    try:
        latest = explained()
    except Exception:
        unusable = _unusable(read, car)
        if not unusable:
            raise
        reasons |= unusable
        read = {name: recording for name, recording in read.items() if name not in unusable}
        latest = explained()
    while (blamed := _blamed(latest.answer, read)) and any(name in read for name in member.training if name != blamed):
        reasons[blamed] = latest.answer.sentence
        del read[blamed]
        latest = explained()
    return latest, reasons


def _read(member: Member) -> tuple[dict[str, Recording], dict[str, str]]:
    """The recordings by name, and by name why others cannot be read."""
    read, reasons = {}, {}
    for name, _, path in member.recordings:
        try:
            read[name] = replace(import_recording(path), name=name)
        except Exception as error:
            reasons[name] = _in_words(error)
    return read, reasons


def _with_next_test(answer: Answer, car: Vehicle, out: Path) -> Answer:
    """An answer that was written into a folder, there and here with the test that tells apart what it leaves open."""
    if answer.verdict != "ambiguous":
        return answer
    try:
        designed(out, car)
    except Exception as error:  # the answer is there without the next test
        return answer.with_(remarks=(*answer.remarks, f"no next test could be designed: {_in_words(error)}"))
    return read_answer(out)


def _unusable(read: Mapping[str, Recording], car: Vehicle) -> dict[str, str]:
    """Recordings that cannot be divided into windows even alone, with the reason."""
    reasons = {}
    for name, recording in read.items():
        try:
            build_dataset([recording], car)
        except Exception as error:
            reasons[name] = _in_words(error)
    return reasons


def _in_words(error: Exception) -> str:
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def _blamed(answer: Answer, names: Iterable[str]) -> str:
    """The recording for which nothing could be said, where it is one; empty otherwise."""
    if answer.verdict != "not_assessable":
        return ""
    said = [name for name in names if re.search(rf"(?<![\w/]){re.escape(name)}(?![\w/])", answer.sentence)]
    return said[0] if len(said) == 1 else ""


def _unused(name: str, remarks: Sequence[str]) -> str:
    """Why nothing of a recording was used, where that is so."""
    said = (r.removeprefix(f"{name}: ") for r in remarks if r.startswith(f"{name}: ") and r.endswith(LEFT_OUT))
    return "; ".join(said)


def _kept(out: Path, key: str) -> Result | None:
    try:
        result = Result.model_validate_json((out / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValidationError):
        return None
    return result if result.key == key else None


def _key(car: Vehicle, member: Member) -> str:
    """Changes with whatever the answer depends on."""
    digest = hashlib.sha256(_program().encode())
    digest.update(car.model_dump_json().encode())
    for name, _, path in member.recordings:
        beside = (path.with_suffix(suffix) for suffix in (".yaml", ".yml"))  # which say how columns are read
        files = sorted(path.rglob("*")) if path.is_dir() else [path, *beside]
        for file in filter(Path.is_file, files):
            digest.update(f"\0{name}/{file.relative_to(path.parent)}\0".encode())
            with file.open("rb") as content:
                digest.update(hashlib.file_digest(content, "sha256").digest())
    return digest.hexdigest()


@cache
def _program() -> str:
    """Hash of the sources and thresholds of this package: another version may answer otherwise."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".c", ".yaml")):
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
