"""Play the workbench in Chromium from the vehicle to the estimate, and write what was measured to out/studio.json.

`make studio-test` runs it. With `--film FILE` the screenshots become an animated picture, with `--axe FILE` the
accessibility is checked by that build of axe-core (`npm pack axe-core`), which is not part of this repository.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

from studio.browser import boards_are_drawn, go, opened, run, served  # noqa: E402
from studio.five_logs import play_five_logs, write_five_logs  # noqa: E402
from vsense_ros.bag import write_bag  # noqa: E402
from vsense_ros.messages.recording import Channel, Recording  # noqa: E402

BAG = ROOT / "bags" / "double_lane_change"
CAR = ROOT / "config" / "vehicles" / "prototype_model.yaml"
STAGES = ("car", "data", "check", "estimate", "identify", "explain", "compare", "live")
FILM_WIDTH = 900  # [px]
FRAME = 1600  # [ms]
SIGNALS = 30  # of the recording of an hour, which are shown together
SETTLE = 4000  # [ms] for what starts in the background, before something is measured
WATCH = 0.2  # [s] between two looks at the memory


def hour(path: Path) -> None:
    """A recording of an hour at 100 Hz with 30 signals: ten topics of three, as inertial sensors give them."""
    stamp = (np.arange(360_000) * 10_000_000).astype(np.int64) + 1_700_000_000_000_000_000
    random = np.random.default_rng(1)
    channels = {}
    for k in range(5):
        values = {
            name: np.cumsum(random.standard_normal((len(stamp), 3)), axis=0) * 1e-3
            for name in ("angular_velocity", "linear_acceleration")
        }
        topic = f"imu{k}/data"
        values["orientation_covariance"] = np.broadcast_to(-np.eye(1, 9), (len(stamp), 9))  # there is no attitude
        channels[topic] = Channel(topic, "sensor_msgs/msg/Imu", stamp, stamp, values, "imu_link")
    write_bag(path, Recording(channels, "hour"))


class Play:
    """The path through the workbench: which steps succeeded, and what was seen."""

    def __init__(self, page: Any, pictures: Path) -> None:
        self.page, self.pictures = page, pictures
        self.steps: dict[str, bool] = {}
        self.frames: list[bytes] = []

    def step(self, name: str, action: Callable[[], Any]) -> None:
        """Do one step; what goes wrong is printed, and the next one is tried."""
        try:
            action()
            self.steps[name] = True
        except Exception as error:  # a step that fails is a figure of the result
            self.steps[name] = False
            print(f"{name}: {type(error).__name__}: {str(error).splitlines()[0]}", file=sys.stderr)
        self.page.wait_for_timeout(600)
        self.frames.append(self.page.screenshot())
        self.page.screenshot(path=self.pictures / f"{name}.png", full_page=True)

    def violations(self, axe: Path | None) -> int | None:
        """Number of rules of axe that a stage breaks, over all stages; None without axe."""
        if axe is None:
            print("axe-core is not here (npm pack axe-core), accessibility was not checked", file=sys.stderr)
            return None
        found: dict[str, str] = {}
        script = axe.read_text(encoding="utf-8")
        for stage in STAGES:
            go(self.page, stage)
            self.page.wait_for_timeout(1200)
            self.page.evaluate(script)
            result = self.page.evaluate("axe.run(document, {runOnly: ['wcag2a', 'wcag2aa']})")
            for rule in result["violations"]:
                found[f"{stage}: {rule['id']}"] = rule["nodes"][0]["html"][:200]
        for place, html in found.items():
            print(f"axe: {place}: {html}", file=sys.stderr)
        return len(found)


def played(play: Play) -> None:
    """From the vehicle to the comparison of two estimates, by clicks."""
    page = play.page
    play.step("car", lambda: page.get_by_text("Figures beside those of real cars").wait_for())
    play.step("data", lambda: (go(page, "data"), boards_are_drawn(page)))
    play.step("check", lambda: (go(page, "check"), run(page, "Run check", "nothing looks wrong")))
    estimate = "Estimate this recording"
    play.step("estimate", lambda: (go(page, "estimate"), run(page, estimate, "Tyre forces from above")))

    def cursor() -> None:
        boards_are_drawn(page)
        page.evaluate("VSense.link('main').point(6.3)")

    play.step("cursor", cursor)

    def second() -> None:
        page.get_by_role("checkbox", name="velocity").click()
        page.get_by_role("button", name=estimate).click()
        page.locator(".vs-progress").wait_for()
        page.locator(".vs-progress").wait_for(state="detached")
        go(page, "compare")
        boards_are_drawn(page)

    play.step("compare", second)
    play.step("live", lambda: (go(page, "live"), page.get_by_role("button", name="Listen").wait_for()))


def memory_of(pid: int) -> float:
    """Memory of a process and all that it started [MB]; what several share counts once."""
    own = 0.0
    with suppress(OSError, StopIteration):  # it has just ended
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
        own = next(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Pss:")) / 1024
    return own + sum(map(memory_of, children(pid)))


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    with suppress(OSError):
        tasks = Path(f"/proc/{pid}/task").iterdir()
        return [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return []


class MostMemory(Thread):
    """Watches the memory [MB] of the command with its workers and of the browser, and keeps the most of each."""

    def __init__(self, command: int) -> None:
        super().__init__(daemon=True)
        self.pid, self.command, self.browser, self.ended = command, 0.0, 0.0, False

    def run(self) -> None:
        while not self.ended:
            drivers = (pid for pid in children(os.getpid()) if pid != self.pid)  # what sends the clicks is no browser
            self.command = max(self.command, memory_of(self.pid))
            self.browser = max(self.browser, sum(memory_of(pid) for driver in drivers for pid in children(driver)))
            time.sleep(WATCH)


# Moves the cursor over the window in steps; returns the longest time [ms] from a step to the next frame after it.
CURSOR = """async () => {
  const canvas = document.querySelector('.vs-board canvas'), taken = [];
  const { left, top, width } = canvas.getBoundingClientRect();
  for (let k = 0; k < 20; k++) {
    const began = performance.now();
    const place = { clientX: left + 60 + (width - 70) * k / 20, clientY: top + 30, pointerType: 'mouse' };
    canvas.dispatchEvent(new PointerEvent('pointermove', place));
    await new Promise(requestAnimationFrame); await new Promise(requestAnimationFrame);
    taken.push(performance.now() - began);
  }
  return Math.max(...taken);
}"""
# Zooms, and returns the time [ms] until the curves of the new window have been drawn.
ZOOM = """async ([begin, end]) => {
  const board = document.querySelector('.vs-board'), before = board.dataset.ready, began = performance.now();
  VSense.link('main').zoom(begin, end);
  while (board.dataset.ready === before) await new Promise(requestAnimationFrame);
  await new Promise(requestAnimationFrame);
  return performance.now() - began;
}"""


def of_an_hour(scratch: Path) -> dict[str, float]:
    """What an hour at 100 Hz takes: first and all curves after it was chosen [s], zoom and cursor with 30 signals
    [ms], memory of the command with its workers and of the browser [MB]."""
    logs = scratch / "logs"
    hour(logs / "hour")
    (logs / "more").mkdir()
    with served(scratch / "hour_project", logs) as address, opened() as page:
        page.goto(address)
        go(page, "data")
        page.wait_for_timeout(SETTLE)
        watch = MostMemory(address.pid)
        watch.start()
        page.get_by_label("Open a recording of an opened folder").click()
        began = time.monotonic()
        page.get_by_role("option", name="hour", exact=True).click()
        boards_are_drawn(page)
        first = time.monotonic() - began
        page.locator(".vs-timeline").wait_for()
        boards_are_drawn(page)
        whole = time.monotonic() - began
        for topic in page.locator(".vs-tree details:not([open]) summary").all()[::-1]:
            topic.click()
        for box in page.get_by_label("all of them").all():
            box.click()
        assert page.locator(".vs-tree input[value]:checked").count() == SIGNALS
        page.wait_for_timeout(SETTLE)
        windows = ((0, 1800), (600, 2400), (100, 130), (0, 3600), (1000, 1010))
        zooms = [float(page.evaluate(ZOOM, window)) for window in windows]
        cursor = float(page.evaluate(CURSOR))
        watch.ended = True
    return {
        "first_curve_s": first, "all_curves_s": whole, "zoom_ms": float(np.median(zooms)), "zoom_most_ms": max(zooms),
        "cursor_ms": cursor, "memory_mb": watch.command, "browser_mb": watch.browser,
    }  # fmt: skip


def film(frames: list[bytes], path: Path) -> None:
    """The screenshots one after the other as an animated WebP."""
    pictures = [Image.open(BytesIO(frame)).convert("RGB") for frame in frames]
    size = FILM_WIDTH, round(pictures[0].height * FILM_WIDTH / pictures[0].width)
    small = [one.resize(size, Image.Resampling.LANCZOS) for one in pictures]
    small[0].save(path, save_all=True, append_images=small[1:], duration=FRAME, loop=0, quality=72, method=6)


def main() -> None:
    """Run all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--film", type=Path)
    parser.add_argument("--axe", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/studio.json"))
    given = parser.parse_args()
    pictures = given.out.parent / "studio_pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        scratch = Path(folder)
        with opened() as page, served(scratch / "first", BAG, CAR) as address:
            page.goto(address)
            page.locator("nav button").first.wait_for()
            first_page = time.monotonic() - address.began
            page.get_by_text("Figures beside those of real cars").wait_for()
            first_stage = time.monotonic() - address.began
            play = Play(page, pictures)
            played(play)
            violations = play.violations(given.axe)
        taken = of_an_hour(scratch)
        (scratch / "five").mkdir()
        catalogue = write_five_logs(scratch / "five")
        with served(scratch / "second") as address, opened() as page:
            page.goto(address)
            began = time.monotonic()
            play.page = page
            play_five_logs(page, scratch / "five", catalogue, play.step)
            taken["five_logs_min"] = (time.monotonic() - began) / 60
    if given.film is not None:
        film(play.frames, given.film)
    result = {
        "path": play.steps,
        "first_page_s": round(first_page, 2),
        "first_stage_s": round(first_stage, 2),
        **{name: round(value, 2) for name, value in taken.items()},
        "axe_violations": violations,
    }
    given.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result))
    sys.exit(0 if all(play.steps.values()) else 1)


if __name__ == "__main__":
    main()
