"""Figures in documents beside those that a command prints: `python tools/printed.py` runs them and names what differs.

A table or a block of a page says where its figures come from, in a comment before it that a reader does not see:

    <!-- printed by: COMMAND -->      each row stands in a line of what the command prints
    <!-- figures of: COMMAND -->      each figure stands somewhere in what it prints
    <!-- by no command: REASON -->    it was measured in another way

Several commands have " ; " between them. A figure agrees with a printed one that it is rounded from. Times of
computing are not compared.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = tuple(ROOT / "docs" / name for name in ("filters.md", "observers.md", "comparison.md", "how_to/identify.md"))
KINDS = ("printed by", "figures of", "by no command")

_MARK = re.compile(rf"<!-- ({'|'.join(KINDS)}): (.+) -->")
_FIGURE = re.compile(r"[-+]?\d+(\.\d+)?(e-?\d+)?")
_TIME = re.compile(r"[\d.]+ (?:µs|min)\b")
_NOT_COMPARED = re.compile(r"µs|\bminutes\b|\btime\b|^thesis")  # heads of columns
_ORNAMENTS = str.maketrans(dict.fromkeys("()*`;:,°%", " ") | {"−": "-"})


@dataclass(frozen=True)
class Figures:
    """A table or block with figures: its page and line, what it says of its origin (`kind` of `KINDS`, empty without a
    word; the command, or the reason), and its rows."""

    page: Path
    line: int
    kind: str
    origin: str
    rows: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page.name}, line {self.line}"


def every(page: Path) -> Iterator[Figures]:
    """Tables and blocks of a page that have figures with a decimal point."""
    lines = page.read_text(encoding="utf-8").splitlines()
    mark, i = ("", ""), 0
    while i < len(lines):
        line = lines[i]
        if found := _MARK.fullmatch(line):
            mark = (found[1], found[2])
        elif line.startswith("|") or line == "```":
            end = i + 1
            while end < len(lines) and (lines[end].startswith("|") if line[0] == "|" else lines[end] != "```"):
                end += 1
            rows = tuple(_cells(lines[i:end]) if line[0] == "|" else lines[i + 1 : end])
            if any(re.search(r"\d\.\d", row) for row in rows):
                yield Figures(page, i + 1, *mark, rows)
            mark, i = ("", ""), end - (line[0] == "|")
        elif line.startswith("```"):  # of code
            i = lines.index("```", i)
        elif line:
            mark = ("", "")
        i += 1


def _cells(lines: list[str]) -> list[str]:
    """Rows of a table below its head, without columns of times and of what a thesis says."""
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    kept = [i for i, head in enumerate(cells[0]) if not _NOT_COMPARED.search(head)]
    return ["  ".join(row[i] for i in kept) for row in cells[2:]]


def missing(figures: Figures, output: str) -> list[str]:
    """Rows that no line of the output has, or figures that it has nowhere."""
    if figures.kind == "figures of":
        printed = _words(output)
        wanted = [word for row in figures.rows for word in _words(row.partition("  ")[2]) if _FIGURE.fullmatch(word)]
        return [word for word in wanted if not any(_agree(word, one) for one in printed)]
    lines = [_words(line) for line in output.splitlines()]
    return [row for row in figures.rows if _has_figures(row) and not any(_within(_words(row), one) for one in lines)]


def _has_figures(row: str) -> bool:
    return any(_FIGURE.fullmatch(word) for word in _words(row))


def _words(text: str) -> list[str]:
    return _TIME.sub(" ", text).translate(_ORNAMENTS).split()


def _within(words: list[str], line: list[str]) -> bool:
    """True if these words stand in a line, in this order."""
    rest = iter(line)
    return all(any(_agree(word, one) for one in rest) for word in words)


def _agree(word: str, printed: str) -> bool:
    """True if words are the same, or a figure is rounded from the printed one."""
    if word == printed:
        return True
    if not (_FIGURE.fullmatch(word) and _FIGURE.fullmatch(printed)):
        return False
    step = 10.0 ** -len(word.partition("e")[0].partition(".")[2]) * 10.0 ** int(word.partition("e")[2] or 0)
    return abs(float(word) - float(printed)) <= step * 0.5000001


def run(commands: str) -> str:
    """What commands of this repository print, in lines that are as long as they need to be."""
    return "\n".join(_run(command) for command in commands.split(" ; "))


def _run(command: str) -> str:
    program, *words = shlex.split(command)
    start = [sys.executable] if program == "python" else [sys.executable, "-m", "vsense_ros.cli"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "400"}
    done = subprocess.run([*start, *words], cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return done.stdout


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", default="", metavar="TEXT", help="commands that contain it")
    parser.add_argument("--output", type=Path, metavar="FILE", help="what it has printed, in place of running it")
    chosen = parser.parse_args()
    wrong = 0
    for figures in (one for page in PAGES for one in every(page)):
        if figures.kind not in KINDS[:2] or chosen.only not in figures.origin:
            continue
        output = chosen.output.read_text(encoding="utf-8") if chosen.output else run(figures.origin)
        rows = missing(figures, output)
        print(f"{figures}: {figures.origin}: " + ("as printed" if not rows else f"{len(rows)} not printed"))
        for row in rows:
            print(f"  {row}")
        wrong += len(rows)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
