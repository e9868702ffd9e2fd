"""Five raw logs of a stranger's car and the numbers of its catalogue, for the path from these to an explained car."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from studies.own_car import cars
from studio.browser import go

Step = Callable[[str, Callable[[], Any]], None]
HELD_OUT = "drive_5"
PATIENCE = 900_000.0  # [ms] for what takes minutes
MIDDLE = 30.0  # [s] at which each of the two drives is cut


def write_five_logs(folder: Path, name: str = "saloon") -> Mapping[str, str | float]:
    """Write the logs of a car of `make own-car` in its own format, the last one to be held out, with the database that
    they need; returns its catalogue values."""
    (car,) = cars([name])
    assert car.log is not None
    parts = [part for drive in car.drives for part in (drive.between(None, MIDDLE), drive.between(MIDDLE, None))]
    for number, recording in enumerate([*parts, car.held_out], start=1):
        car.log.write(recording, folder / f"drive_{number}{car.log.suffix}", car.radius)
    if car.log.database:
        (folder / "car.dbc").write_text(car.log.database, encoding="utf-8")
    return car.catalogue


def play_five_logs(page: Any, folder: Path, catalogue: Mapping[str, str | float], step: Step) -> None:
    """From the logs in a folder and the catalogue to an identified and explained car, by clicks alone."""
    page.set_default_timeout(PATIENCE)
    step("five logs: uploaded", lambda: _upload(page, folder))
    step("five logs: mapped", lambda: _confirm_mapping(page))
    step("five logs: new vehicle", lambda: _write_vehicle(page, catalogue))
    step("five logs: checked", lambda: _check(page))
    step("five logs: calibrated", lambda: _use(page, "Calibrate", "check"))
    step("five logs: identified", lambda: _identify(page))
    step("five logs: explained", lambda: _explain(page))


def _upload(page: Any, folder: Path) -> None:
    go(page, "data")
    page.get_by_label("Drop recordings").set_input_files(sorted(folder.iterdir()))
    page.locator(".vs-drive").nth(4).wait_for()


def _confirm_mapping(page: Any) -> None:
    page.get_by_text("Which column is what?").wait_for()
    page.get_by_label("Database of a CAN log").click()
    page.get_by_role("option", name="car.dbc").click()
    page.get_by_role("button", name="Propose a mapping").click()
    page.get_by_role("button", name="Use this mapping").click()
    for number in range(5):
        page.locator(".vs-drive").nth(number).get_by_text("topics").wait_for()
    page.locator(".vs-drive").filter(has_text=HELD_OUT).get_by_role("checkbox").click()
    page.get_by_role("checkbox", checked=True, name="held out").wait_for()


def _write_vehicle(page: Any, catalogue: Mapping[str, str | float]) -> None:
    go(page, "car")
    page.get_by_role("button", name="New vehicle").click()
    labels = {
        "mass": "Mass as it is driven", "wheelbase": "Wheelbase", "track": "Track, front", "tyre": "Tyre size",
        "axle-load-front": "Mass on the front axle", "steering-ratio": "Steering ratio",
    }  # fmt: skip
    for key, label in labels.items():
        page.get_by_role("dialog").get_by_label(label).fill(str(catalogue[key]))
    page.get_by_role("button", name="Write the file").click()
    page.get_by_text("Figures beside those of real cars").wait_for()


def _check(page: Any) -> None:
    go(page, "check")
    page.get_by_role("button", name="Run check").click()
    page.get_by_text(re.compile("Vehicle file against the recordings|The vehicle file fits")).wait_for()
    for box in page.get_by_role("checkbox", name="Accept these mends", checked=False).all()[:1]:
        box.click()


def _use(page: Any, button: str, stage: str) -> None:
    """Press a button, wait for its result, and go on with the car that it gives."""
    go(page, stage)
    page.get_by_role("button", name=button).first.click()
    page.get_by_role("button", name="Use this car").last.click()
    page.get_by_text("The car is now").first.wait_for()


def _identify(page: Any) -> None:
    go(page, "identify")
    page.get_by_label("Model").click()
    page.get_by_role("option", name="single_track").click()
    _use(page, "Identify the car", "identify")


def _explain(page: Any) -> None:
    go(page, "explain")
    page.get_by_role("button", name="Explain these recordings").click()
    page.get_by_text("The answer").wait_for()
    assert page.locator(".vs-answer").inner_text().strip()
