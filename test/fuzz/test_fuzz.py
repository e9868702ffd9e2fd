"""A sample of `make fuzz`: what is not meant is refused in words, or does no harm."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest

from fuzz.coverage import FINDINGS
from fuzz.targets import TARGETS, Target, fuzz
from vsense_ros.errors import InputError


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_no_input_breaks_it(target: Target) -> None:
    fuzz(target, max(20, round(6000 * target.share)), seed=7)


@pytest.mark.parametrize("finding", sorted(FINDINGS.glob("*")), ids=lambda path: path.name)
def test_an_input_that_once_broke_a_parser_is_read_or_refused(finding: Path, tmp_path: Path) -> None:
    (target,) = [t for t in TARGETS if finding.name.startswith(f"{t.name.replace(' ', '_')}-")]
    feed, _ = target.make(tmp_path)
    for _ in range(4):  # files of YAML go to four readers in turn
        with suppress(InputError):
            feed(finding.read_bytes())
