"""The measures of the code base beside their goals: python tools/house.py [FOLDER], to out/house.json.

Read by people who decide what to simplify next. Each measure is counted anew from the sources, except those that take
long: the minutes of `make test` and the share of killed mutants are what these last wrote to out/.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from radon.complexity import cc_visit

sys.path.insert(0, str(Path(__file__).parent))
from circles import circles

ROOT = Path(__file__).parents[1]
PACKAGE = "vsense_ros"
MOST_LINES = 500  # of a file
MANY_METHODS = 25  # of a class
CONSTANT = re.compile(r"_*[A-Z][A-Z0-9_]*")
FRAGMENTS = ("Of ", "Whether ", "The same")  # openings of a docstring that cannot be read alone
USUAL = (0, 1, -1, 2, 0.5)  # numbers that decide nothing
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module


@dataclass(frozen=True)
class Module:
    path: Path
    text: str

    @property
    def lines(self) -> int:
        return self.text.count("\n")

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)


def modules(root: Path) -> list[Module]:
    """All Python files of the package; C, templates and tables are not counted."""
    paths = sorted((root / PACKAGE).rglob("*.py"))
    return [Module(path, path.read_text(encoding="utf-8")) for path in paths]


def constants(tree: ast.Module) -> list[str]:
    """Names in capitals that a module assigns at its top level, whatever their value.

    Fields of a settings class and members of an enumeration are not among them: these have a type and a place.
    """
    assigned = [n for n in tree.body if isinstance(n, ast.Assign | ast.AnnAssign)]
    targets = [t for n in assigned for t in (n.targets if isinstance(n, ast.Assign) else [n.target])]
    names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    return [name for name in names if CONSTANT.fullmatch(name)]


def literals(tree: ast.Module) -> int:
    """Numbers written in the bodies of functions, other than 0, 1, -1, 2 and 0.5.

    This is counted beside the constants so that moving a constant into a function does not look like an improvement.
    """
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    inside = {id(node): node for f in functions for statement in f.body for node in ast.walk(statement)}
    values = [n.value for n in inside.values() if isinstance(n, ast.Constant) and type(n.value) in (int, float)]
    return sum(value not in USUAL for value in values)


def fragments(tree: ast.Module) -> int:
    """Docstrings of modules, classes and functions that begin with "Of", "Whether" or "The same"."""
    nodes = [n for n in ast.walk(tree) if isinstance(n, Definition)]
    return sum((ast.get_docstring(node) or "").startswith(FRAGMENTS) for node in nodes)


def many_methods(module: Module) -> Iterator[str]:
    """Classes with 25 functions or more in their bodies, as "file:class (methods)"."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ClassDef):
            methods = sum(isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef) for n in node.body)
            if methods >= MANY_METHODS:
                yield f"{module.path.name}:{node.name} ({methods})"


def complexities(module: Module) -> Iterator[tuple[int, str]]:
    """Cyclomatic complexity (McCabe 1976, Boolean operators counted, by radon) of every function and method."""
    functions = [block for block in cc_visit(module.text) if not hasattr(block, "methods")]
    yield from ((f.complexity, f"{module.path.name}:{f.fullname}") for f in functions)


def hard_dependencies(root: Path) -> int:
    """Number of packages that `pip install vsense_ros` brings directly: the setup script run up to its metadata."""
    import setuptools  # noqa: F401 (brings distutils)

    from distutils.core import run_setup  # isort: skip

    with chdir(root):
        return len(run_setup("setup.py", stop_after="init").install_requires)


def written(path: Path, key: str) -> Any:
    """A value that an earlier command wrote, or None."""
    return json.loads(path.read_text(encoding="utf-8")).get(key) if path.is_file() else None


def measures(root: Path = ROOT) -> dict[str, Any]:
    """All measures by name. None stands for what has not been measured yet."""
    package = modules(root)
    trees = [module.tree for module in package]
    lines = sum(module.lines for module in package)
    return {
        "lines": lines,
        "constants_per_1000": round(1000 * sum(len(constants(tree)) for tree in trees) / lines, 2),
        "literals_per_1000": round(1000 * sum(literals(tree) for tree in trees) / lines, 2),
        "files_over_500": sum(module.lines > MOST_LINES for module in package),
        "complexity_max": max(c for module in package for c, _ in complexities(module)),
        "circles": len(circles(root)),
        "hard_dependencies": hard_dependencies(root),
        "test_minutes": written(root / "out/test.json", "minutes"),
        "docstrings_of_whether_the_same": sum(fragments(tree) for tree in trees),
        "mutants_killed_percent": mutants_killed(root / "out/mutants"),
        "classes_of_25_methods": len([c for module in package for c in many_methods(module)]),
    }


def mutants_killed(folder: Path) -> float | None:
    """Percentage of mutants that tests kill, in all packages that tools/mutants.py has examined."""
    reports = [json.loads(path.read_text(encoding="utf-8"))["mutants"] for path in sorted(folder.glob("*.json"))]
    killed = [bool(mutant["killed"]) for report in reports for mutant in report]
    return round(100 * sum(killed) / len(killed), 1) if killed else None


@dataclass(frozen=True)
class Measure:
    """How a measure is printed: a title, what it was in September 2026, and the goal with its direction."""

    title: str
    before: float | None
    goal: float | None
    at_least: bool = False

    def reached(self, value: float | None) -> bool | None:
        if value is None or self.goal is None:
            return None
        return value >= self.goal if self.at_least else value <= self.goal


TABLE = {
    "lines": Measure("lines of the package", 72_732, 58_000),
    "constants_per_1000": Measure("module constants per 1,000 lines", 24.6, 10),
    "literals_per_1000": Measure("numbers in functions per 1,000 lines", 39.51, None),
    "files_over_500": Measure(f"files over {MOST_LINES} lines", 16, 0),
    "complexity_max": Measure("largest complexity of a function", 54, 20),
    "circles": Measure("circles of imports", 4, 0),
    "hard_dependencies": Measure("hard dependencies", 29, 14),
    "test_minutes": Measure("minutes of make test", 49, 10),
    "docstrings_of_whether_the_same": Measure("docstrings: Of, Whether, The same", 399, 0),
    "mutants_killed_percent": Measure("mutants killed [%]", 65, 85, at_least=True),
    "classes_of_25_methods": Measure(f"classes of {MANY_METHODS} methods or more", 11, 3),
}


def table(values: dict[str, Any]) -> str:
    """One line for each measure: value, goal, whether it is reached, and the value before the house was mended."""
    rows = [("measure", "now", "goal", "", "before")]
    for name, measure in TABLE.items():
        reached = {True: "reached", False: "missed", None: ""}[measure.reached(values[name])]
        sign = "≥" if measure.at_least else "≤"
        goal = "" if measure.goal is None else f"{sign} {measure.goal:,g}"
        rows.append((measure.title, _number(values[name]), goal, reached, _number(measure.before)))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:,.6g}"


def culprits(root: Path) -> str:
    """Files, functions and classes beyond the goals, largest first."""
    package = modules(root)
    most = TABLE["complexity_max"].goal or 0
    files = sorted(((m.lines, str(m.path.relative_to(root))) for m in package if m.lines > MOST_LINES), reverse=True)
    complex_ = sorted((c for module in package for c in complexities(module) if c[0] > most), reverse=True)
    classes = [c for module in package for c in many_methods(module)]
    parts = {
        f"Files over {MOST_LINES} lines": [f"{name} ({lines})" for lines, name in files],
        f"Functions of complexity over {most:g}": [f"{name} ({value})" for value, name in complex_],
        f"Classes of {MANY_METHODS} methods or more": classes,
    }
    return "\n".join(f"{title}: {', '.join(found)}" for title, found in parts.items() if found)


def main() -> None:
    root = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT
    values = measures(root)
    (root / "out").mkdir(exist_ok=True)
    (root / "out/house.json").write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
    print(table(values), culprits(root), sep="\n\n")


if __name__ == "__main__":
    main()
