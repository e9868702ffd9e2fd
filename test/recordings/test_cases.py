"""The cases of public bug reports give what is expected of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from recordings.cases import CASES
from recordings.further_cases import FURTHER_CASES

ALL = CASES | FURTHER_CASES


@pytest.mark.parametrize("name", ALL)
def test_a_reported_case_gives_what_is_expected(name: str, tmp_path: Path) -> None:
    ALL[name](tmp_path)
