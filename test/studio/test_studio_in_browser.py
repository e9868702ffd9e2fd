"""The workbench as a user meets it: clicks and keys in a real browser."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from studio.browser import ROOT, boards_are_drawn, browsing, go, page_of, run, served

BAG = ROOT / "bags" / "double_lane_change"
CAR = ROOT / "config" / "vehicles" / "prototype_model.yaml"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with served(tmp_path_factory.mktemp("studio"), BAG, CAR) as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Any:
    with browsing() as started:
        yield started


def test_a_recording_is_read_checked_and_estimated_by_clicks(address: str, browser: Any) -> None:
    with page_of(browser) as page:
        page.goto(address)
        page.get_by_text("Figures beside those of real cars").wait_for()
        go(page, "data")
        boards_are_drawn(page)
        assert page.locator("canvas[aria-label*='imu/data']").count() >= 1
        go(page, "check")
        run(page, "Run check", "nothing looks wrong")
        go(page, "estimate")
        run(page, "Estimate this recording", "Tyre forces from above")
        boards_are_drawn(page)
        assert page.get_by_text("Against the reference").count() == 1
        assert not page.errors


def test_keys_move_the_cursor_and_zoom_and_values_are_shown(address: str, browser: Any) -> None:
    with page_of(browser) as page:
        page.goto(address)
        go(page, "data")
        boards_are_drawn(page)
        board = page.locator(".vs-board").first
        board.focus()
        page.keyboard.press("ArrowRight")
        page.locator(".vs-legend-entry b").first.wait_for()
        page.wait_for_function("document.querySelector('.vs-legend-entry b').textContent !== ''")
        before = page.evaluate("VSense.link('main').window")
        page.keyboard.press("+")
        begin, end = page.evaluate("VSense.link('main').window")
        assert before is None
        assert 0 <= begin < end < 12
        page.keyboard.press("Home")
        assert page.evaluate("VSense.link('main').window[0]") == 0


def test_a_reload_in_the_middle_of_a_job_shows_the_same_stage_and_then_its_result(address: str, browser: Any) -> None:
    with page_of(browser) as page:
        page.goto(address)
        go(page, "estimate")
        page.get_by_role("checkbox", name="velocity").click()
        page.get_by_role("button", name="Estimate this recording").click()
        page.locator(".vs-progress").wait_for()
        page.reload()
        page.get_by_text("Tyre forces from above").wait_for()
        assert page.locator("button[data-stage=estimate][aria-current=page]").count() == 1


def test_a_car_is_identified_and_used_by_clicks(address: str, browser: Any) -> None:
    with page_of(browser) as page:
        page.goto(address)
        go(page, "identify")
        page.get_by_label("Model").wait_for()
        if page.get_by_text(re.compile("[Rr]un Check (first|again)")).count():
            go(page, "check")
            run(page, "Run check", "nothing looks wrong")
            go(page, "identify")
        page.get_by_label("Model").click()
        page.get_by_role("option", name="single_track").click()
        page.get_by_role("button", name="Identify the car").click()
        page.get_by_role("region", name="Identified parameters").wait_for()
        page.get_by_role("button", name="Use this car").click()
        page.get_by_text("Car: identified_").wait_for()
        assert not page.errors


@pytest.mark.exam
def test_two_tabs_show_the_same_project(address: str, browser: Any) -> None:
    with page_of(browser) as page:
        page.goto(address)
        second = page.context.new_page()
        second.goto(address.partition("?")[0])
        go(page, "data")
        boards_are_drawn(page)
        page.get_by_role("checkbox", name="held out").first.click()
        go(second, "data")
        second.get_by_role("checkbox", name="held out", checked=True).wait_for()
        page.get_by_role("checkbox", name="held out").first.click()


def test_no_stage_is_wider_than_a_phone(address: str, browser: Any) -> None:
    with page_of(browser, width=400) as page:
        page.goto(address)
        for stage in ("car", "data", "check", "estimate", "identify", "explain", "compare", "live"):
            go(page, stage)
            page.locator("main h1").wait_for()
            # On a busy machine the elements of a page are drawn before they have found their places.
            page.wait_for_function("document.documentElement.scrollWidth <= 400")
            assert page.evaluate("document.documentElement.scrollWidth") <= 400, stage


def test_a_wrong_token_and_another_origin_get_a_sentence(address: str, browser: Any) -> None:
    with page_of(browser) as page:
        answer = page.goto(address.partition("token=")[0] + "token=wrong")
        assert answer.status == 403
        assert "token" in page.inner_text("body")


@pytest.mark.exam
def test_results_of_a_killed_workbench_are_there_when_it_starts_again(tmp_path: Path, browser: Any) -> None:
    with served(tmp_path, BAG, CAR) as first, page_of(browser) as page:
        page.goto(first)
        go(page, "check")
        run(page, "Run check", "nothing looks wrong")
    with served(tmp_path) as again, page_of(browser) as page:
        page.goto(again)
        go(page, "check")
        page.get_by_text("nothing looks wrong").first.wait_for()
