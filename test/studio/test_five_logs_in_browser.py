"""From five raw logs and a catalogue to an explained, identified car, by clicks alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from studio.browser import opened, served
from studio.five_logs import play_five_logs, write_five_logs

MOST_MINUTES = 15.0


@pytest.mark.exam
def test_five_raw_logs_and_a_catalogue_become_an_explained_car_within_a_quarter_of_an_hour(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    catalogue = write_five_logs(logs)
    with served(tmp_path / "project") as address, opened() as page:
        page.goto(address)
        began = time.monotonic()

        def step(name: str, action: Callable[[], Any]) -> None:
            action()

        play_five_logs(page, logs, catalogue, step)
        assert (time.monotonic() - began) / 60 < MOST_MINUTES
        assert not page.errors
