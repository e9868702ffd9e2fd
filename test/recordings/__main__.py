"""`make recordings`: the cases, the planted faults and the speeds of all formats, to out/recordings.json.

With a folder of DBC files, also whether each of them loads.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
import traceback
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from recordings import conventions, formats, guessing, planted
from recordings.cases import CASES
from recordings.clean import Examined, examined
from recordings.further_cases import FURTHER_CASES
from recordings.known_buses import BUSES
from recordings.known_logs import LOGS
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.bag.importers import import_recording
from vsense_ros.driver.can_database import read_database
from vsense_ros.errors import InputError
from vsense_ros.evaluate.terminal import progress

SECONDS = 1500.0  # of the drive of which the formats are timed: 150,000 rows, 300,000 frames


def run_cases() -> dict[str, bool]:
    """For each case, true if it gives what is expected."""
    found = {}
    cases = CASES | FURTHER_CASES
    with progress("cases") as done:
        for number, (name, case) in enumerate(cases.items(), 1):
            with TemporaryDirectory() as folder:
                try:
                    case(Path(folder))
                    found[name] = True
                except Exception:  # a case may fail in any way
                    traceback.print_exc()
                    found[name] = False
            done(number / len(cases))
    return found


def run_clean(count: int) -> Examined:
    """The checks and the mends of recordings with nothing wrong."""
    with progress("clean drives") as done:
        return examined(count, done)


def run_planted(clean: Examined) -> dict[str, Any]:
    """How many planted faults are named rightly, and in how many clean drives something is found."""
    missed: list[str] = []
    every = list(planted.planted())
    with progress("planted faults") as done:
        for number, (fault, where, recording) in enumerate(every, 1):
            if not planted.is_named(fault, recording):
                missed.append(f"{fault.name} in {where}")
            done(number / len(every))
    return {
        "named": len(every) - len(missed),
        "n": len(every),
        "false": len(clean.doubted),
        "clean": clean.recordings,
        "faults": len(planted.FAULTS),
        "missed": missed,
        "false_findings": clean.problems,
    }


def run_mends(clean: Examined) -> dict[str, Any]:
    """How often `--mend` puts other conventions right, how often it does harm, and in how many clean drives it acts."""
    missed: list[str] = []
    harmful: list[str] = []
    every = list(conventions.drives())
    with progress("conventions") as done:
        for number, one in enumerate(every, 1):
            right, harm = conventions.judged(one)
            missed += [] if right else [one.name]
            harmful += [one.name] if harm else []
            done(number / len(every))
    return {
        "right": len(every) - len(missed),
        "n": len(every),
        "harmful": len(harmful),
        "in_clean": len(clean.mended),
        "clean": clean.recordings,
        "missed": missed,
        "harmed": [*harmful, *clean.mended],
    }


def run_guesses() -> dict[str, Any]:
    """For how many logs a proposed mapping reads what was measured, and which it reads wrongly without a word."""
    logs = LOGS | BUSES
    found = []
    with progress("proposed mappings") as done:
        for verdict in guessing.verdicts(logs):
            found.append(verdict)
            done(len(found) / len(logs))
    return {
        "right": sum(verdict.right for verdict in found),
        "n": len(found),
        "silently_wrong": sum(verdict.silent for verdict in found),
        "missed": [f"{verdict.name}: {verdict.why}" for verdict in found if not verdict.right],
    }


def run_formats(seconds: float) -> dict[str, dict[str, float]]:
    """How fast each format is read, of its own size, and how many messages or frames that is."""
    found: dict[str, dict[str, float]] = {}
    with progress("formats") as done, TemporaryDirectory() as folder:
        for number, (name, make) in enumerate(formats.MAKERS.items(), 1):
            place = Path(folder) / name
            place.mkdir()
            path, options = make(place, seconds)
            import_recording(path, **options)  # so that no import of a library is timed
            size = sum(f.stat().st_size for f in path.rglob("*")) if path.is_dir() else path.stat().st_size
            before = time.perf_counter()
            recording = import_recording(path, **options)
            took = time.perf_counter() - before
            messages = sum(len(channel) for channel in recording.channels.values())
            found[name] = {"mb_s": size / took / 1e6, "us_per_message": took / messages * 1e6, "messages": messages}
            if name == "mcap":
                found[name] |= _bag_speeds(place, recording)
            done(number / len(formats.MAKERS))
    return found


def _bag_speeds(folder: Path, recording: Any) -> dict[str, float]:
    messages = sum(len(channel) for channel in recording.channels.values())
    before = time.perf_counter()
    write_bag(folder / "again", recording)
    between = time.perf_counter()
    read_bag(folder / "again")
    return {
        "written_messages_per_s": messages / (between - before),
        "read_us_per_message": (time.perf_counter() - between) / messages * 1e6,
    }


def run_databases(folder: Path) -> dict[str, Any]:
    """Which of the DBC files of a folder load, and how many only in part."""
    files = sorted(folder.rglob("*.dbc"))
    failed, partly = [], []
    for file in files:
        try:
            if read_database(file).notes:
                partly.append(file.name)
        except InputError as error:
            failed.append(str(error))
    return {"loaded": len(files) - len(failed), "n": len(files), "with_notes": partly, "failed": failed}


def main() -> int:
    parser = argparse.ArgumentParser(prog="recordings", description=__doc__)
    parser.add_argument("--dbc", type=Path, help="folder of DBC files")
    parser.add_argument("--out", type=Path, default=Path("out/recordings.json"))
    parser.add_argument("--clean", type=int, default=100, help="number of clean drives")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the drive of which the formats are timed")
    arguments = parser.parse_args()
    clean = run_clean(arguments.clean)
    found: dict[str, Any] = {
        "cases": run_cases(),
        "planted": run_planted(clean),
        "mend": run_mends(clean),
        "guess": run_guesses(),
        "formats": run_formats(arguments.seconds),
    }
    if arguments.dbc is not None:
        found["databases"] = run_databases(arguments.dbc)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(found, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    told = found["planted"]
    print(f"cases: {sum(found['cases'].values())} of {len(found['cases'])}")
    print(
        f"planted: {told['named']} of {told['n']} named rightly, "
        f"{told['false']} of {told['clean']} clean drives doubted"
    )
    for text in (*told["missed"], *told["false_findings"]):
        print(f"  {text}")
    mend = found["mend"]
    print(
        f"mends: {mend['right']} of {mend['n']} right, {mend['harmful']} harmful; "
        f"{mend['in_clean']} of {mend['clean']} clean drives mended"
    )
    for text in (*mend["missed"], *mend["harmed"]):
        print(f"  {text}")
    guess = found["guess"]
    print(f"proposed mappings: {guess['right']} of {guess['n']} right, {guess['silently_wrong']} wrong without a word")
    for text in guess["missed"]:
        print(f"  {text}")
    print(f"{'format':<26}{'MB/s':>8}{'µs/message':>12}")
    for name, speed in found["formats"].items():
        print(f"{name:<26}{speed['mb_s']:>8.1f}{speed['us_per_message']:>12.2f}")
    bag = found["formats"]["mcap"]
    print(
        f"bags: {bag['written_messages_per_s']:,.0f} messages/s written, "
        f"{bag['read_us_per_message']:.2f} µs a message read"
    )
    if "databases" in found:
        told = found["databases"]
        print(f"databases: {told['loaded']} of {told['n']} load, {len(told['with_notes'])} of them with notes")
    print(f"largest memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB; {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
