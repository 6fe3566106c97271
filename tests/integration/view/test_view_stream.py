"""A newcomer's run: a capture set in motion is encoded, served, shaped, and looked at in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.browser import chromium, keep_screenshot, require_browser
from support.client_page import choose, click, drag, measured
from support.live_stack import live_stack
from support.web_page import require_built

pytestmark = pytest.mark.slow

WAIT_S = 60
RECOGNISABLE_DB = 18.0
"""PSNR that a stranger's picture does not reach and the scene, whatever its detail, passes."""


@pytest.fixture(scope="module")
def page_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Server, shaper and client with a page, on a ``.splat`` capture set in motion."""
    require_browser()
    require_built()
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
        wait(running, lambda: measured(running)["pictures"] > 0)
        if not measured(running)["playing"]:  # the play is the client's, and as the page before left it
            click(running, "#play")
        wait(running, lambda: measured(running)["pictures"] > 2)
        yield running
        assert [e["message"] for e in running.get_log("browser") if e["level"] in ("SEVERE", "WARNING")] == []


def wait(running: Any, condition: Callable[[], bool]) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(running, WAIT_S, poll_frequency=0.1).until(lambda _: condition())


def score(running: Any) -> float:
    return float(measured(running)["stats"].get("psnr_restored_db") or 0)


def test_the_scene_is_recognised_in_the_page_and_answers_the_hand(page: Any) -> None:
    click(page, "#overlay-score")
    wait(page, lambda: score(page) > RECOGNISABLE_DB)
    keep_screenshot(page, "newcomer")
    click(page, "#overlay-score")

    drag(page, 5, 1, steps=20)
    wait(page, lambda: len(measured(page)["photonMs"]) >= 3)
    click(page, "#play")
    wait(page, lambda: not measured(page)["playing"])
    time.sleep(0.5)
    held = measured(page)["frame"]
    drag(page, 5, 1, steps=20)
    time.sleep(0.5)
    assert measured(page)["frame"] == held
    choose(page, "#time", "12")
    wait(page, lambda: measured(page)["frame"] == 12)
    keep_screenshot(page, "newcomer-paused")


def test_overlays_and_comparison_work_on_a_real_stream(page: Any) -> None:
    click(page, "#inspect")
    choose(page, "#picture-b", "distorted")
    for name in ("detail", "tiles", "reference", "occlusion", "confidence"):
        click(page, f"#overlay-{name}")
    before = measured(page)["pictures"]
    wait(page, lambda: measured(page)["pictures"] > before + 5)
    keep_screenshot(page, "newcomer-overlays")
    assert not page.find_element("id", "toast").is_displayed()


def test_pictures_have_the_windows_shape_and_change_with_it(page: Any) -> None:
    """The server learns of it in mid-session; nothing is said of that, and the play goes on."""
    click(page, "#overlay-score")
    for width, height in ((700, 900), (1200, 700)):
        page.set_window_size(width, height)
        inner = page.execute_script("return innerWidth / innerHeight")
        wait(page, lambda shape=inner: abs(shape_of(page) / shape - 1) < 0.03)
        before = measured(page)["pictures"]
        wait(page, lambda before=before: measured(page)["pictures"] > before + 10 and score(page) > RECOGNISABLE_DB)
        drawn = page.execute_script("const { width, height } = cags.player.shown.pictures[0]; return width * height")
        assert 0.9 * 320 * 240 < drawn <= 320 * 240
        assert not page.find_element("id", "toast").is_displayed()
        assert not page.find_element("id", "message").is_displayed()


def shape_of(running: Any) -> float:
    picture = "const { width, height } = window.cags.player.shown.pictures[0]; return width / height"
    return float(running.execute_script(picture))


def test_cap_and_delay_reach_the_shaper(page: Any) -> None:
    choose(page, "#delay", "60")
    choose(page, "#cap", "40")
    wait(page, lambda: (measured(page)["shaper"] or {}).get("capacity_mbps", 99) < 10)
    assert measured(page)["shaper"]["delay_ms"] == 60
