"""Fuzzing by coverage: inputs that reach code which none reached before are kept, and changed further.

    python -m fuzz.coverage --runs 20000 importers CAN

Every parser of targets.py runs in a process of its own under atheris (libFuzzer). An input that breaks one is written
to test/fuzz/findings, where test_fuzz.py tries it from then on. Those that reached something new stay in out/corpus,
from which the next run goes on. Adds the counts to out/fuzz.json, of this run and of all (`total`).
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

FINDINGS = Path(__file__).parent / "findings"
CORPUS = Path("out/corpus")
NO_PARSER = ("observer",)
LONGEST = 20  # [s] for one input
MOST_MEMORY = 2048  # [MiB]


def child(name: str, runs: int, seconds: int, place: Path) -> None:
    """Feed one target; ends the process, with another code than 0 where an input breaks the target."""
    import atheris

    with atheris.instrument_imports(include=["vsense_ros.bag", "vsense_ros.driver", "vsense_ros.messages"]):
        from fuzz.targets import TARGETS
        from vsense_ros.errors import InputError
    (target,) = [t for t in TARGETS if t.name == name]
    feed, seeds = target.make(place)
    corpus = CORPUS / name.replace(" ", "_")
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds):
        (corpus / f"seed_{number}").write_bytes(seed)

    def one(data: bytes) -> None:
        with suppress(InputError):
            feed(data)

    FINDINGS.mkdir(exist_ok=True)
    limits = [f"-runs={runs}", f"-max_total_time={seconds}", f"-timeout={LONGEST}", f"-rss_limit_mb={MOST_MEMORY}"]
    artifact = f"-artifact_prefix={FINDINGS}/{name.replace(' ', '_')}-"
    atheris.Setup([name, *limits, artifact, "-max_len=65536", str(corpus)], one)
    atheris.Fuzz()


def fuzz_by_coverage(name: str, runs: int, seconds: int) -> dict[str, Any]:
    """Number of inputs, edges of code that they reached, and whether the parser held."""
    with tempfile.TemporaryDirectory(prefix="vsense_") as place:
        command = [sys.executable, "-m", "fuzz.coverage", "--child", place, name]
        command += ["--runs", str(runs), "--seconds", str(seconds)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    log = done.stderr + done.stdout
    lines = re.findall(r"#(\d+)\s.*?cov: (\d+)", log)
    result: dict[str, Any] = {"holds": done.returncode == 0}
    if lines:
        result |= {"inputs": int(lines[-1][0]), "edges": int(lines[-1][1])}
    return result if result["holds"] else result | {"broke": log.strip()[-3000:]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="targets; default: all parsers")
    parser.add_argument("--runs", type=int, default=20_000, help="inputs for each target at most; default: 20000")
    parser.add_argument("--seconds", type=int, default=120, help="for each target at most; default: 120")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--output", type=Path, default=Path("out/fuzz.json"))
    given = parser.parse_args()
    if given.child:
        child(given.names[0], given.runs, given.seconds, given.child)
    from fuzz.targets import TARGETS

    names = given.names or [target.name for target in TARGETS if target.name not in NO_PARSER]
    content = json.loads(given.output.read_text(encoding="utf-8")) if given.output.exists() else {}
    results = content.get("coverage", {})
    for name in names:
        before = results.get(name, {}).get("total", 0)
        results[name] = fuzz_by_coverage(name, given.runs, given.seconds)
        results[name]["total"] = before + results[name].get("inputs", 0)
        print(f"{name:<18} {results[name]}"[:2000], flush=True)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps(content | {"coverage": results}, indent=2) + "\n", encoding="utf-8")
    return 0 if all(results[name]["holds"] for name in names) else 1


if __name__ == "__main__":
    sys.exit(main())
