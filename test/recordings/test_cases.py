"""The cases of public bug reports give what is expected of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from recordings.cases import CASES


@pytest.mark.parametrize("name", CASES)
def test_a_reported_case_gives_what_is_expected(name: str, tmp_path: Path) -> None:
    CASES[name](tmp_path)
