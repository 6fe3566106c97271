"""A newcomer's run: a capture set in motion is encoded, served, shaped, and looked at in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.browser import chromium, keep_screenshot, require_browser
from support.live_stack import live_stack

pytestmark = pytest.mark.slow

WAIT_S = 60
RECOGNISABLE_DB = 18.0
"""PSNR that a stranger's picture does not reach and the scene, whatever its detail, passes."""


@pytest.fixture(scope="module")
def page_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Server, shaper and client with a page, on a ``.splat`` capture set in motion."""
    require_browser()
    from cags_encoder.formats import write_splats
    from cags_encoder.scenes import open_scene

    folder = tmp_path_factory.mktemp("newcomer")
    capture = folder / "capture.splat"
    write_splats(capture, open_scene("procedural:size=6000,frames=1").frame(0))
    with live_stack(f"motion:{capture}:frames=30", folder, width=320, height=240) as url:
        yield url


@pytest.fixture
def page(page_url: str, tmp_path: Path) -> Iterator[Any]:
    with chromium(tmp_path) as running:
        running.get(page_url)
        wait(running, lambda: measured(running)["frames"] > 2)
        yield running
        assert [e["message"] for e in running.get_log("browser") if e["level"] in ("SEVERE", "WARNING")] == []


def wait(running: Any, condition: Callable[[], bool]) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(running, WAIT_S, poll_frequency=0.1).until(lambda _: condition())


def measured(running: Any) -> dict[str, Any]:
    return dict(running.execute_script("return structuredClone(window.cags ?? {frames: 0})"))


def score(running: Any) -> float:
    return float(running.execute_script("return window.cags.stats?.psnr_restored_db ?? 0"))


def drag(running: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    actions = ActionChains(running, duration=30).click_and_hold(running.find_element(By.ID, "picture"))
    for _ in range(20):
        actions.move_by_offset(5, 1)
    actions.release().perform()


def test_the_scene_is_recognised_in_the_page_and_answers_the_hand(page: Any) -> None:
    page.find_element("css selector", "#overlays input[value=score]").click()
    wait(page, lambda: score(page) > RECOGNISABLE_DB)
    keep_screenshot(page, "newcomer")
    page.find_element("css selector", "#overlays input[value=score]").click()

    drag(page)
    wait(page, lambda: len(measured(page)["photonMs"]) >= 3)
    page.find_element("id", "play").click()
    wait(page, lambda: page.execute_script("return document.getElementById('play').dataset.playing") == "false")
    time.sleep(0.5)
    held = measured(page)["frame"]
    drag(page)
    time.sleep(0.5)
    assert measured(page)["frame"] == held
    page.execute_script(
        "const seek = document.getElementById('seek'); seek.value = 12; seek.dispatchEvent(new Event('change'))"
    )
    wait(page, lambda: measured(page)["frame"] == 12)
    keep_screenshot(page, "newcomer-paused")


def test_overlays_and_comparison_work_on_a_real_stream(page: Any) -> None:
    page.find_element("css selector", "#mode label:nth-child(2)").click()
    for name in ("detail", "tiles", "reference", "occlusion", "confidence"):
        page.find_element("css selector", f"#overlays input[value={name}]").click()
    before = measured(page)["frames"]
    wait(page, lambda: measured(page)["frames"] > before + 5)
    keep_screenshot(page, "newcomer-overlays")
    assert page.find_element("id", "trouble").text == ""


def test_cap_and_delay_reach_the_shaper(page: Any) -> None:
    page.execute_script(
        "const delay = document.getElementById('delay'); delay.value = 60; delay.dispatchEvent(new Event('change'));"
        "const cap = document.getElementById('cap'); cap.value = 40; cap.dispatchEvent(new Event('change'))"
    )
    wait(page, lambda: float(page.execute_script("return window.cags.stats?.capacity_mbps ?? 99")) < 10)
