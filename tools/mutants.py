"""How many mutants of a package its own fast tests kill: python tools/mutants.py PACKAGE TESTS [--sample 40].

A mutant is the package with one arithmetic operator, comparison or condition turned into its opposite (DeMillo, Lipton
& Sayward 1978); it is killed when a test fails. Cosmic Ray finds the places, writes the mutants and runs the tests;
this draws a sample of them, makes each in a copy of the tree, and begins with the tests that are nearest to what is
mutated. It prints a line for each, writes JSON with `--json FILE`, and ends with 1 where fewer than `--least` percent
are killed.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

from changed_tests import ROOT, imports, nearest
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.plugins import get_operator
from cosmic_ray.testing import run_tests
from cosmic_ray.work_item import MutationSpec, TestOutcome

# Each operator with the one that stands for its opposite. `<` for `<=` is left out: on measured numbers it is the same.
_ARITHMETIC = ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Div", "Mod_Mul", "Pow_Mul", "BitAnd_BitOr")
_COMPARISONS = ("Eq_NotEq", "NotEq_Eq", "Lt_GtE", "GtE_Lt", "LtE_Gt", "Gt_LtE", "Is_IsNot", "IsNot_Is")
OPERATORS = (
    *(f"core/ReplaceBinaryOperator_{name}" for name in (*_ARITHMETIC, "BitOr_BitAnd")),
    *(f"core/ReplaceComparisonOperator_{name}" for name in _COMPARISONS),
    *(f"core/{name}" for name in ("ReplaceAndWithOr", "ReplaceOrWithAnd", "AddNot")),
    "core/ReplaceUnaryOperator_Delete_Not",
    "core/ReplaceUnaryOperator_Delete_USub",
)
LEAST = 85.0  # percent that tests kill which would notice: what is alive then is mostly equivalent (Jia & Harman 2011)
COPIED = ("vsense_ros", "test", "tools", "config", "bags", "docs", "hw", "launch", "studies", "exam")
SINGLE = ("pyproject.toml", "setup.py", "setup.cfg", "package.xml", "README.md", "CHANGELOG.md")
SLACK = 30.0  # [s] beside three times what the tests take without a mutant, after which they count as failed


def mutants(package: Path, at: Iterable[str] = ()) -> list[MutationSpec]:
    """All mutants of the files in a package; `at` keeps those of some places, as `health.py:52`."""
    found = []
    for file in sorted(package.rglob("*.py")):
        tree, types = get_ast_from_path(file), _annotated(file)
        for name in OPERATORS:
            operator = get_operator(name)()
            places = [place for node in ast_nodes(tree) for place in operator.mutation_positions(node)]
            for occurrence, (start, end) in enumerate(places):
                if not any(first <= start < last for first, last in types):
                    found.append(MutationSpec(file, name, occurrence, start, end))
    kept = set(at)
    return [one for one in found if not kept or f"{one.module_path.name}:{one.start_pos[0]}" in kept]


def _annotated(file: Path) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Where the annotations of a file begin and end (line, column): `int | None` in them is no arithmetic."""
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.arg | ast.AnnAssign):
            found.append(node.annotation)
        elif isinstance(node, ast.FunctionDef):
            found.append(node.returns)
    return [
        ((one.lineno, one.col_offset), (one.end_lineno or one.lineno, one.end_col_offset or 0)) for one in found if one
    ]


def copy_tree(target: Path) -> None:
    """What the tests need of the repository."""
    for name in COPIED:
        if (ROOT / name).exists():
            shutil.copytree(ROOT / name, target / name, ignore=shutil.ignore_patterns("__pycache__", "out"))
    for name in SINGLE:
        shutil.copy(ROOT / name, target / name)


def test_command(place: Path, tests: str, changed: str | None, imported: dict[str, set[str]]) -> str:
    """The fast tests, those first that are nearest to the changed file."""
    every = [str(file.relative_to(place)) for file in sorted((place / tests).rglob("test_*.py"))]
    near = [] if changed is None else [file for file in nearest([changed], imported, ROOT) if file in every]
    files = [*near, *(file for file in every if file not in near)]
    options = "-x -q -m 'not slow and not exam' --no-header -p no:cacheprovider --durations=0 --durations-min=99"
    where = shlex.quote(str(place))  # also the working folder, which Python searches first
    python = f"env --chdir={where} PYTHONPATH={where} {shlex.quote(sys.executable)}"
    return f"{python} -m pytest {options} {' '.join(files)}"


def described(mutant: MutationSpec) -> dict[str, object]:
    """A mutant for the reader."""
    line, column = mutant.start_pos
    source = mutant.module_path.read_text(encoding="utf-8")
    return {
        "file": str(mutant.module_path.relative_to(ROOT)),
        "line": line,
        "column": column,
        "operator": mutant.operator_name.removeprefix("core/"),
        "source": source.splitlines()[line - 1].strip(),
    }


def examine(package: str, tests: str, sample: int, seed: int, at: list[str], workers: int) -> list[dict[str, object]]:
    """Draw mutants, run the tests against each, and say what became of them."""
    drawn = mutants(ROOT / package, at)
    if sample < len(drawn):
        drawn = sorted(random.Random(seed).sample(drawn, sample), key=lambda one: (one.module_path, one.start_pos))
    imported = imports(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        copies: Queue[Path] = Queue()
        for i in range(workers):
            place = Path(folder) / str(i)
            copy_tree(place)
            copies.put(place)
        begun = time.monotonic()
        outcome, output = run_tests(test_command(place, tests, None, imported), 3600)
        if outcome != TestOutcome.SURVIVED:
            sys.exit(f"the tests fail without any mutant:\n{output}")
        longest = 3 * (time.monotonic() - begun) + SLACK

        def examined(mutant: MutationSpec) -> dict[str, object]:
            file = str(mutant.module_path.relative_to(ROOT))
            row = described(mutant)
            place = copies.get()
            try:
                there = MutationSpec(
                    place / file, mutant.operator_name, mutant.occurrence, mutant.start_pos, mutant.end_pos
                )
                result = mutate_and_test([there], test_command(place, tests, file, imported), longest)
            finally:
                copies.put(place)
            row["killed"] = result.test_outcome != TestOutcome.SURVIVED
            word = "killed" if row["killed"] else "ALIVE "
            print(f"{word} {row['file']}:{row['line']} {row['operator']}: {row['source']}", flush=True)
            return row

        with ThreadPoolExecutor(workers) as pool:
            return list(pool.map(examined, drawn))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", help="folder of the package, as vsense_ros/estimation")
    parser.add_argument("tests", help="folder of its tests, as test/estimation")
    parser.add_argument("--sample", type=int, default=40, help="number of mutants of a package (40)")
    parser.add_argument("--seed", type=int, default=1, help="of the random sample (1)")
    parser.add_argument("--at", action="append", default=[], metavar="FILE:LINE", help="only mutants of this line")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="mutants at a time (one a processor)")
    parser.add_argument("--least", type=float, default=LEAST, help=f"percentage that must be killed ({LEAST:g})")
    parser.add_argument("--json", type=Path, help="file for the result")
    given = parser.parse_args()
    for folder in (given.package, given.tests):
        if not (ROOT / folder).is_dir():
            parser.error(f"there is no folder {folder} in {ROOT}")
    rows = examine(given.package, given.tests, given.sample, given.seed, given.at, given.workers)
    percent = killed_percent(rows)
    print(f"{given.package}: {percent:.0f} % of {len(rows)} mutants killed by {given.tests}")
    if given.json:
        document = {"package": given.package, "tests": given.tests, "killed_percent": percent, "mutants": rows}
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    sys.exit(percent < given.least)


def killed_percent(rows: list[dict[str, object]]) -> float:
    """Share of the mutants that were killed [%]; 0 where there was none."""
    return 100 * sum(bool(one["killed"]) for one in rows) / max(len(rows), 1)


if __name__ == "__main__":
    main()
