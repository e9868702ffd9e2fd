"""A sample of `make fuzz`: what is not meant is refused in words, or does no harm."""

from __future__ import annotations

import pytest

from fuzz.targets import TARGETS, Target, fuzz


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_no_input_breaks_it(target: Target) -> None:
    fuzz(target, max(20, round(6000 * target.share)), seed=7)
