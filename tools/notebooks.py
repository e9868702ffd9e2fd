"""The notebooks of docs/notebooks, executed: `python tools/notebooks.py` writes pages with outputs to out/notebooks.

A notebook is a Markdown page. Its Python blocks are run one after the other in one namespace, as cells are. Below each
block stands what it printed, the value of its last expression, and the picture if that is one.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "docs" / "notebooks"
OUT = ROOT / "out" / "notebooks"
BLOCK = re.compile(r"^```python\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


def executed(page: Path, out: Path) -> str:
    """The text of a notebook with the outputs of its blocks; pictures are written to `out`, beside the page.

    What a block raises is raised here, with the page and its block in front.
    """
    namespace: dict[str, Any] = {}
    count = 0

    def with_output(match: re.Match[str]) -> str:
        nonlocal count
        count += 1
        printed = StringIO()
        try:
            with redirect_stdout(printed):
                value = _run(match[1], namespace)
        except Exception as error:
            raise RuntimeError(f"{page.name}, block {count}: {type(error).__name__}: {error}") from error
        shown = ""
        if hasattr(value, "savefig"):
            name = f"{page.stem}_{count}.svg"
            value.savefig(out / name)
            shown = f"\n![Output of the block above]({name})\n"
        elif value is not None:
            printed.write(f"{value}\n")
        text = printed.getvalue()
        return match[0] + (f"\n```text\n{text.rstrip()}\n```\n" if text.strip() else "") + shown

    text = page.read_text(encoding="utf-8")
    with _clone():
        return BLOCK.sub(with_output, text)


def _run(source: str, namespace: dict[str, Any]) -> Any:
    """Run statements; the value of the last one if it is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<notebook>", "exec"), namespace)
    if last is None:
        return None
    assert isinstance(last, ast.Expr)
    return eval(compile(ast.Expression(last.value), "<notebook>", "eval"), namespace)


@contextmanager
def _clone() -> Iterator[None]:
    """Work in a folder that has the recordings of a clone, and is removed with what a notebook writes."""
    before = Path.cwd()
    with TemporaryDirectory() as folder:
        (Path(folder) / "bags").symlink_to(ROOT / "bags")
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


def main() -> int:
    OUT.mkdir(parents=True, exist_ok=True)
    for page in sorted(SOURCES.glob("*.md")):
        (OUT / page.name).write_text(executed(page, OUT), encoding="utf-8")
        print(f"docs/notebooks/{page.name} has been executed")
    return 0


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
