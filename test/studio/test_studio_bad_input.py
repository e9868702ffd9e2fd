"""What goes wrong in front of a browser or below it: each is a sentence, and nothing is lost or opened."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from studio.browser import ROOT, boards_are_drawn, browsing, go, page_of, run, served
from vsense_ros.bag import read_bag, write_bag

BAG = ROOT / "bags" / "double_lane_change"
CAR = ROOT / "config" / "vehicles" / "prototype_model.yaml"
pytestmark = pytest.mark.slow

# What a page of another port of this machine, to which the browser sends the cookie, can see of the workbench.
ELSEWHERE = """async (address) => {
  const seen = [], body = JSON.stringify({ set: "a/curves", time: 0 }), headers = { "Content-Type": "text/plain" };
  for (const options of [{}, { mode: "no-cors" }, { method: "POST", body, headers, mode: "no-cors" }])
    for (const path of ["", "data/at"])
      await fetch(address + path, { ...options, credentials: "include" })
        .then(async (answer) => seen.push(await answer.text()), () => null);
  const socket = new WebSocket(address.replace("http", "ws") + "_nicegui_ws/socket.io/?EIO=4&transport=websocket");
  await new Promise((done) => { socket.onopen = () => { seen.push("socket"); done(); }; socket.onerror = done; });
  return seen.filter((text) => text);
}"""


@pytest.fixture(scope="module")
def browser() -> Any:
    with browsing() as started:
        yield started


@contextmanager
def other_site(folder: Path) -> Iterator[str]:
    """A page of another server of this machine."""
    (folder / "index.html").write_text("<!doctype html><title>elsewhere</title>", encoding="utf-8")
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()


def test_a_page_of_another_port_sees_nothing_although_the_browser_sends_the_cookie(
    tmp_path: Path, browser: Any
) -> None:
    with served(tmp_path / "project", BAG, CAR) as address, page_of(browser) as page, other_site(tmp_path) as elsewhere:
        page.goto(address)
        page.get_by_text("Figures beside those of real cars").wait_for()
        other = page.context.new_page()
        other.goto(elsewhere)
        assert other.evaluate(ELSEWHERE, address.partition("?")[0]) == []


def test_a_recording_that_changes_below_is_read_anew_and_one_that_is_deleted_is_a_sentence(
    tmp_path: Path, browser: Any
) -> None:
    bag = tmp_path / "drive"
    shutil.copytree(BAG, bag)
    with served(tmp_path / "project", bag, CAR) as address, page_of(browser) as page:
        page.goto(address)
        go(page, "data")
        boards_are_drawn(page)
        page.get_by_text("12.1 s").wait_for()
        write_bag(bag, read_bag(BAG).between(0.0, 5.0), overwrite=True)
        go(page, "car")
        go(page, "data")
        page.get_by_text("5.1 s").wait_for()
        shutil.rmtree(bag)
        go(page, "estimate")
        page.get_by_role("button", name="Estimate this recording").click()
        page.get_by_text("no such file; it may have been moved or deleted").first.wait_for()
        assert not page.errors


def test_without_a_steering_angle_each_stage_says_a_sentence(tmp_path: Path, browser: Any) -> None:
    recording = read_bag(BAG)
    channels = {topic: channel for topic, channel in recording.channels.items() if topic != "vehicle/steering"}
    write_bag(tmp_path / "drive", replace(recording, channels=channels))
    with served(tmp_path / "project", tmp_path / "drive", CAR) as address, page_of(browser) as page:
        page.goto(address)
        go(page, "check")
        run(page, "Run check", "This recording has no vehicle/steering")
        go(page, "estimate")
        run(page, "Estimate this recording", "Against the reference")
        go(page, "identify")
        run(page, "Identify the car", "steering")
        go(page, "explain")
        run(page, "Explain these recordings", "no steering angle, which drives the model")
        assert "Traceback" not in page.inner_text("main")
        assert not page.errors
