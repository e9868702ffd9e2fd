"""The fast tests that what has changed is likeliest to break, for `make check`: python tools/changed_tests.py SECONDS.

What has changed is what differs from the newest commit of main that is an ancestor, files unknown to git included; on a
clean main, what its last commit changed. Test files come in the order of their distance from it: those that changed
themselves, those that import a changed module, those that import one that does, and so on. Tests that have not begun
when the time is over are left out and counted: `make test` runs all of them.

Why not pytest-testmon, which traces what each test runs: it first needs a run of all tests, and the tracing took 70 %
more processor time.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "vsense_ros"
FARTHEST = 2  # imports away: beyond it lies nearly everything


def changed(root: Path = ROOT, branch: str = "main") -> set[str]:
    """The files that differ, as paths below the repository."""
    known = [name for name in (branch, f"origin/{branch}") if _git(root, "rev-parse", "--verify", "-q", name)]
    base = _git(root, "merge-base", "HEAD", known[0]) if known else ["HEAD"]
    new = _git(root, "ls-files", "--others", "--exclude-standard")
    found = {*_git(root, "diff", "--name-only", *base), *new}
    return found or {*_git(root, "diff", "--name-only", "HEAD~1")}


def _git(root: Path, *arguments: str) -> list[str]:
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=False)
    return done.stdout.split("\n")[:-1]


def imports(root: Path = ROOT) -> dict[str, set[str]]:
    """For each Python file of package, studies and tests the files that it imports, as paths below the repository."""
    files = {
        str(path.relative_to(root)) for folder in (PACKAGE, "studies", "test") for path in (root / folder).rglob("*.py")
    }
    return {file: {one for one in _imported(root, file, files) if one != file} for file in files}


def _imported(root: Path, file: str, files: set[str]) -> Iterable[str]:
    """Imports as the interpreter finds them: from the root, and from the folder of a test and those above it."""
    places = ["", *(f"{parent}/" for parent in Path(file).parents if parent.parts[:1] == ("test",))]
    for statement in ast.walk(ast.parse((root / file).read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(statement, ast.ImportFrom) and statement.module:
            names = [statement.module, *(f"{statement.module}.{alias.name}" for alias in statement.names)]
        elif isinstance(statement, ast.Import):
            names = [alias.name for alias in statement.names]
        for name in names:
            paths = [place + name.replace(".", "/") for place in places]
            yield from {f"{path}{end}" for path in paths for end in (".py", "/__init__.py")} & files
    yield from {f"{place}conftest.py" for place in places} & files


def nearest(changes: Iterable[str], imported: Mapping[str, Iterable[str]], root: Path = ROOT) -> list[str]:
    """Test files in the order of their distance from the changes."""
    by: dict[str, set[str]] = defaultdict(set)
    for file, others in imported.items():
        for other in others:
            by[other].add(file)
    distance = {file: 0 for change in changes for file in _meant(change, imported, root)}
    front = set(distance)
    for step in range(1, FARTHEST + 1):
        front = {file for one in front for file in by[one] if file not in distance}
        distance |= dict.fromkeys(front, step)
    tests = [file for file in distance if Path(file).name.startswith("test_") and Path(file).parts[1] != "benchmark"]
    return sorted(tests, key=lambda file: (distance[file], file))


def _meant(change: str, imported: Iterable[str], root: Path) -> list[str]:
    """The Python files that a changed file stands for: itself, or those that name it, as they do a template or C."""
    if change in imported:
        return [change]
    if change.endswith(".py") or Path(change).parts[0] not in (PACKAGE, "studies", "test", "config", "docs", "tools"):
        return []
    name = Path(change).name
    return [file for file in imported if name in (root / file).read_text(encoding="utf-8")]


def main(seconds: float) -> int:
    """Run them; the exit code of pytest, or 0 where there is nothing to run."""
    until = time.time() + seconds
    tests = nearest(changed(), imports())
    if not tests:
        print("No test imports what has changed.")
        return 0
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-m",
        "not slow and not exam",
        "-q",
        "--durations=0",
        "--durations-min=5",
        "-p",
        "deadline",
    ]
    command += [f"--until={until}", "-n", "auto", "--maxschedchunk=2", "--maxfail=20", *tests]
    code = subprocess.run(command, cwd=ROOT, env=_environment(), check=False).returncode
    return 0 if code == 5 else code  # 5: these files have slow tests alone


def _environment() -> dict[str, str]:
    paths = [str(ROOT / "tools"), *filter(None, [os.environ.get("PYTHONPATH", "")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
