"""The workbench in the Chromium of the system, for tests, measurements and the film of the documentation."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PATIENCE = 120_000.0  # [ms] for a job on a machine that is busy


def chromium() -> str:
    """Path of the browser; skips the test where there is none."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("there is no Chromium on this machine")
    return found


class Address(str):
    """The address with its token that a command printed, with the command's process id and the time of its start."""

    pid: int
    began: float


@contextmanager
def served(project: Path, *files: object) -> Iterator[Address]:
    """The command `vsense studio` in a process of its own; gives the address with its token."""
    began = time.monotonic()
    command = [sys.executable, "-m", "vsense_ros.cli", "studio", *map(str, files), "--project", str(project)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTEST_CURRENT_TEST", None)  # by which NiceGUI would take the command for a test of its own
    process = subprocess.Popen(
        [*command, "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    )
    assert process.stdout is not None
    try:
        words = ""
        while "token=" not in words:
            line = process.stdout.readline()
            assert line, f"the command ended: {words}"
            words += line
        found = re.search(r"http://\S+", words)
        assert found is not None
        address = Address(found[0])
        address.pid, address.began = process.pid, began
        yield address
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()


@contextmanager
def browsing() -> Iterator[Any]:
    """The browser, which starts within a second or two: for several pages one after the other."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def page_of(browser: Any, width: int = 1400, height: int = 900) -> Iterator[Any]:
    """A page with cookies and storage of its own, whose errors are collected in `page.errors`."""
    context = browser.new_context(viewport={"width": width, "height": height})
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.errors = []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    try:
        yield page
    finally:
        context.close()


@contextmanager
def opened(width: int = 1400, height: int = 900) -> Iterator[Any]:
    """A page of a browser of its own, as `page_of` has it."""
    with browsing() as browser, page_of(browser, width, height) as page:
        yield page


def go(page: Any, stage: str) -> None:
    """Go to a stage by its button."""
    page.locator(f"button[data-stage={stage}]").click()
    page.locator(f"button[data-stage={stage}][aria-current=page]").wait_for()


def run(page: Any, button: str, result: str) -> float:
    """Press a button and wait for what its result shows; returns the time that it took [s]."""
    began = time.monotonic()
    page.get_by_role("button", name=button).first.click()
    page.get_by_text(result).first.wait_for()
    return time.monotonic() - began


def boards_are_drawn(page: Any) -> None:
    """Wait until the curves of the stage have been drawn."""
    page.locator(".vs-board[data-ready]").first.wait_for()
