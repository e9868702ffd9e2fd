"""Play the workbench in Chromium from the vehicle to the estimate, and write what was measured to out/studio.json.

`make studio-test` runs it. With `--film FILE` the screenshots become an animated picture, with `--axe FILE` the
accessibility is checked by that build of axe-core (`npm pack axe-core`), which is not part of this repository.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "test"))

from studio.browser import boards_are_drawn, go, opened, run, served  # noqa: E402
from vsense_ros.bag import write_bag  # noqa: E402
from vsense_ros.messages.recording import Channel, Recording  # noqa: E402

BAG = ROOT / "bags" / "double_lane_change"
CAR = ROOT / "config" / "vehicles" / "prototype_model.yaml"
STAGES = ("car", "data", "check", "estimate", "identify", "explain", "compare", "live")
FILM_WIDTH = 900  # [px]
FRAME = 1600  # [ms]


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


def zoomed(scratch: Path) -> tuple[float, float]:
    """Time to the first curve of an hour [s], and the median time of a zoom of its 30 signals [ms]."""
    hour(scratch / "hour")
    with served(scratch / "project", scratch / "hour") as address, opened() as page:
        page.goto(address)
        began = time.monotonic()
        go(page, "data")
        boards_are_drawn(page)
        first = time.monotonic() - began
        for box in page.locator(".vs-tree .q-tree__node--parent > .q-tree__node-header .q-checkbox").all():
            if box.get_attribute("aria-checked") != "true":
                box.click()
        page.wait_for_timeout(3000)
        taken = []
        for begin, end in ((0, 1800), (600, 2400), (100, 130), (0, 3600), (1000, 1010)):
            serial = page.evaluate("document.querySelector('.vs-board').dataset.ready")
            page.evaluate(f"VSense.link('main').zoom({begin}, {end})")
            page.wait_for_function(f"document.querySelector('.vs-board').dataset.ready !== '{serial}'")
            taken.append(float(page.evaluate("document.querySelector('.vs-board').dataset.ms")))
    return first, float(np.median(taken))


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
        began = time.monotonic()
        with served(scratch / "first", BAG, CAR) as address, opened() as page:
            page.goto(address)
            page.locator("nav button").first.wait_for()
            first_page = time.monotonic() - began
            play = Play(page, pictures)
            played(play)
            violations = play.violations(given.axe)
        first_curve, zoom = zoomed(scratch)
    if given.film is not None:
        film(play.frames, given.film)
    result = {
        "path": play.steps,
        "first_page_s": round(first_page, 2),
        "first_curve_s": round(first_curve, 2),
        "zoom_ms": round(zoom, 1),
        "axe_violations": violations,
    }
    given.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result))
    sys.exit(0 if all(play.steps.values()) else 1)


if __name__ == "__main__":
    main()
