"""The page about the packages of vsense_ros and their arrows: python tools/architecture.py writes docs/architecture.md
and the picture beside it.

What a package is stands in its docstring, its line in the contract of pyproject.toml; arrows are the imports as they
are in the code, those within functions too. The text around them is architecture.md.j2, whose every file must exist.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

sys.path.insert(0, str(Path(__file__).parent))
from layered_picture import draw

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "vsense_ros"
PAGE, PICTURE = ROOT / "docs" / "architecture.md", ROOT / "docs" / "architecture.svg"
PATH = re.compile(r"`((?:vsense_ros|test|tools|docs|launch|config)/[\w/.-]+)(?:::?(\w+))?`")


@dataclass(frozen=True)
class Subpackage:
    """A folder of vsense_ros: what it says it is, and the packages from which it imports."""

    name: str
    text: str
    imports: tuple[str, ...]


def packages() -> list[Subpackage]:
    """All packages, in the order of the contract's lines from top to bottom."""
    return [
        Subpackage(name, first_sentence(PACKAGE / name), tuple(sorted(imports()[name])))
        for line in lines()
        for name in line
    ]


def first_sentence(folder: Path) -> str:
    """What a package says it is."""
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    paragraph = " ".join(text.partition("\n\n")[0].split())
    if not paragraph:
        raise SystemExit(f"{folder.relative_to(ROOT)}/__init__.py: expected a docstring that says what the package is")
    return re.split(r"(?<=\w\.) ", paragraph)[0]


def lines() -> list[list[str]]:
    """The packages that there are, on the lines of the contract."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (contract,) = [one for one in contracts if one.get("containers") == [PACKAGE.name]]
    named = [re.findall(r"\w+", line) for line in contract["layers"]]
    return [there for line in named if (there := [name for name in line if (PACKAGE / name).is_dir()])]


@cache
def imports() -> dict[str, set[str]]:
    """The packages from which each package imports."""
    found: dict[str, set[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        package = path.relative_to(PACKAGE).parts[0]
        if (PACKAGE / package).is_dir():
            own = found.setdefault(package, set())
            own.update(other for other in _imported(path) if other != package and (PACKAGE / other).is_dir())
    return found


def _imported(path: Path) -> Iterator[str]:
    for statement in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(statement, ast.ImportFrom) and statement.module == PACKAGE.name:
            names = [f"{PACKAGE.name}.{alias.name}" for alias in statement.names]
        elif isinstance(statement, ast.ImportFrom):
            names = [statement.module or ""]
        elif isinstance(statement, ast.Import):
            names = [alias.name for alias in statement.names]
        yield from (name.split(".")[1] for name in names if name.startswith(f"{PACKAGE.name}."))


def without_shortcuts(arrows: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """The arrows whose end cannot be reached from their begin by others: the transitive reduction of a graph without
    circles (Aho, Garey, Ullman 1972)."""

    @cache
    def reached(package: str) -> frozenset[str]:
        return frozenset(arrows[package]).union(*(reached(other) for other in arrows[package]))

    return [
        (package, other)
        for package, others in arrows.items()
        for other in others
        if not any(other in reached(between) for between in others)
    ]


def exceptions() -> list[tuple[str, str]]:
    """Arrows that do not lead to a lower line, which the contract lists with what will remove them."""
    line = {name: i for i, names in enumerate(lines()) for name in names}
    return [
        (package.name, other)
        for package in packages()
        for other in package.imports
        if line[other] <= line[package.name]
    ]


def picture() -> str:
    """The packages on their lines and the arrows between them, as SVG."""
    upward = exceptions()
    down = {
        package.name: [one for one in package.imports if (package.name, one) not in upward] for package in packages()
    }
    return draw(lines(), {package.name: package.text for package in packages()}, without_shortcuts(down))


def page() -> str:
    """The page in Markdown. Raises `SystemExit` where it names a file or a function that does not exist."""
    loader = FileSystemLoader(Path(__file__).parent)
    template = Environment(loader=loader, undefined=StrictUndefined, keep_trailing_newline=True, trim_blocks=True)
    text = template.get_template("architecture.md.j2").render(
        packages=packages(), allowed=_allowed(), exceptions=exceptions(), example=_example
    )
    if missing := [problem for match in PATH.finditer(text) if (problem := _missing(*match.groups()))]:
        raise SystemExit("tools/architecture.md.j2 names what does not exist: " + ", ".join(missing))
    return text


def _example(path: str) -> str:
    """A link to a test, if there is one."""
    return f"[{Path(path).name}](../{path})" if (ROOT / path).exists() else "none yet"


def _allowed() -> str:
    return " → ".join(names[0] if len(names) == 1 else "{" + ", ".join(names) + "}" for names in lines())


def _missing(path: str, name: str | None) -> str:
    """What of a file, or of a name that it must define, is not there; empty if all is."""
    if not (ROOT / path).exists():
        return path
    if name and not re.search(rf"(?:def|class) {name}\b|^{name}\b", (ROOT / path).read_text(encoding="utf-8"), re.M):
        return f"{path}:{name}"
    return ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    PICTURE.write_text(picture(), encoding="utf-8")
