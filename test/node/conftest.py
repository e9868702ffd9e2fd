"""Nodes as processes answer in time only where they get a processor: on a busy machine they go before others."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress

import pytest

_BEFORE_OTHERS = -10  # niceness, which the nodes inherit


@pytest.fixture(autouse=True, scope="session")
def _processor_first() -> Iterator[None]:
    """Where that is not allowed, as for most users, the nodes take their turn."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, min(before, _BEFORE_OTHERS))
    yield
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, before)
