"""Pages of docs/ that are made from code are those that it makes: `make docs` writes them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from docs import DOCS, PAGES, missing


@pytest.mark.exam
@pytest.mark.parametrize("name", PAGES)
def test_a_page_that_is_made_from_code_is_up_to_date(name: str) -> None:
    if lacking := missing(name):
        pytest.skip(f"{lacking} is not installed here")
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name](), "run: make docs"


def test_every_page_that_is_made_from_code_is_in_docs() -> None:
    assert {name for name in PAGES if not (DOCS / name).is_file()} == set()
