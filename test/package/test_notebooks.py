"""The notebooks of the documentation run, and their outputs are put below their blocks."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "notebooks").glob("*.md"))


@pytest.fixture(scope="module")
def notebooks() -> ModuleType:
    spec = importlib.util.spec_from_file_location("notebooks", ROOT / "tools" / "notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_a_block_prints_and_its_last_value_stand_below_it(notebooks: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("Text\n\n```python\na = 2\nprint('two')\na + 1\n```\n\n```python\na * 10\n```\n", encoding="utf-8")
    assert notebooks.executed(page, tmp_path).count("```text\ntwo\n3\n```\n") == 1
    assert "```text\n20\n```\n" in notebooks.executed(page, tmp_path)


def test_a_block_that_raises_is_named(notebooks: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\n1\n```\n\n```python\n1 / 0\n```\n", encoding="utf-8")
    with pytest.raises(RuntimeError, match=r"page.md, block 2: ZeroDivisionError"):
        notebooks.executed(page, tmp_path)


@pytest.mark.exam
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_notebook_runs(notebooks: ModuleType, page: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("pandas")
    text = notebooks.executed(page, tmp_path)
    assert text.count("```text\n") + len(list(tmp_path.glob("*.svg"))) >= 3


def test_there_are_five_notebooks_and_the_site_lists_them() -> None:
    listed = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert len(PAGES) == 5
    assert all(f"notebooks/{page.name}" in listed for page in PAGES)
