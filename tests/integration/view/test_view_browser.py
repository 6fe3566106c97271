"""The live page in a real browser: moving pictures, a hand on the camera, the transport bar, and no complaint."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.browser import chromium, keep_screenshot, require_browser
from support.live_page import BallShow

pytestmark = pytest.mark.slow

WAIT_S = 30
CENTRE = """
const canvas = document.getElementById('picture'), copy = new OffscreenCanvas(64, 48), c = copy.getContext('2d');
c.drawImage(canvas, 0, 0, 64, 48);
return Array.from(c.getImageData(0, 0, 64, 48).data).filter((_, i) => i % 4 < 3);
"""


@pytest.fixture(scope="module")
def show() -> Iterator[BallShow]:
    """The balls on a page, served from a thread of their own."""
    require_browser()
    ready = threading.Event()
    box: list[tuple[BallShow, Callable[[], object]]] = []

    async def run() -> None:
        over, loop = asyncio.Event(), asyncio.get_running_loop()
        async with BallShow() as running:
            box.append((running, lambda: loop.call_soon_threadsafe(over.set)))
            ready.set()
            await over.wait()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    assert ready.wait(20)
    running, end = box[0]
    yield running
    end()
    thread.join()


@pytest.fixture
def page(show: BallShow, tmp_path: Path) -> Iterator[Any]:
    show.controls.play()
    with chromium(tmp_path) as running:
        running.get(show.view.url + "?h264")
        wait(running, lambda: measured(running)["frames"] > 3)
        yield running
        assert complaints(running) == []


def wait(running: Any, condition: Callable[[], bool], seconds: float = WAIT_S) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(running, seconds, poll_frequency=0.1).until(lambda _: condition())


def measured(running: Any) -> dict[str, Any]:
    return dict(running.execute_script("return structuredClone(window.cags ?? {frames: 0})"))


def complaints(running: Any) -> list[str]:
    return [entry["message"] for entry in running.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


def difference(a: list[int], b: list[int]) -> float:
    return sum(abs(x - y) for x, y in zip(a, b, strict=True)) / len(a)


def drag(running: Any, steps: int = 12) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    actions = ActionChains(running, duration=30).click_and_hold(running.find_element(By.ID, "picture"))
    for _ in range(steps):
        actions.move_by_offset(9, 2)
    actions.release().perform()


def click(running: Any, selector: str) -> None:
    from selenium.webdriver.common.by import By

    running.find_element(By.CSS_SELECTOR, selector).click()


def press(running: Any, keys: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    ActionChains(running).send_keys(keys).perform()


def test_pictures_move_by_h264_and_stand_still_when_paused(page: Any, show: BallShow) -> None:
    assert measured(page)["codec"].startswith("avc1.")
    first = page.execute_script(CENTRE)
    wait(page, lambda: difference(first, page.execute_script(CENTRE)) > 1)
    click(page, "#play")
    wait(page, lambda: not show.controls.playing)
    wait(page, lambda: measured(page)["frame"] == show.controls.frame)
    still = page.execute_script(CENTRE)
    before = measured(page)["frames"]
    wait(page, lambda: measured(page)["frames"] > before + 5)
    assert difference(still, page.execute_script(CENTRE)) < 1
    press(page, " ")
    wait(page, lambda: show.controls.playing)


def test_dragging_turns_the_picture_and_is_timed(page: Any, show: BallShow) -> None:
    press(page, " ")
    wait(page, lambda: not show.controls.playing and measured(page)["frame"] == show.controls.frame)
    before = page.execute_script(CENTRE)
    drag(page)
    wait(page, lambda: measured(page)["photonMs"] and measured(page)["pose"] is not None)
    assert show.view.poses.held
    assert difference(before, page.execute_script(CENTRE)) > 1
    click(page, "#rig input[value=walk]")
    wait(page, lambda: not show.view.poses.held)


def test_keys_fly_step_and_compare(page: Any, show: BallShow) -> None:
    click(page, "#picture")
    press(page, "wwdd")
    wait(page, lambda: show.view.poses.held)
    press(page, ".")
    wait(page, lambda: not show.controls.playing)
    press(page, "c")
    wait(page, lambda: page.execute_script("return !document.getElementById('wipe').hidden"))
    press(page, "t")
    wait(page, lambda: not show.view.poses.held)
    press(page, "?")
    wait(page, lambda: page.execute_script("return document.getElementById('help').open"))


def test_a_choice_that_was_come_to_by_keyboard_is_made_by_arrows(page: Any, show: BallShow) -> None:
    chosen = "return document.querySelector('[name=rig]:checked').value"
    page.execute_script("document.getElementById('seek').focus()")
    press(page, "\ue004")
    assert page.execute_script("return document.activeElement.value") == "walk"
    press(page, "\ue014")
    wait(page, lambda: page.execute_script(chosen) == "orbit" and show.view.poses.held)
    press(page, "\ue014")
    wait(page, lambda: page.execute_script(chosen) == "fly")
    press(page, "t")
    wait(page, lambda: not show.view.poses.held)


def test_two_pictures_overlays_and_figures(page: Any, show: BallShow) -> None:
    click(page, "#mode label:nth-child(2)")
    for name in ("occlusion", "tiles", "reference", "score"):
        click(page, f"#overlays input[value={name}]")
    wait(page, lambda: "restored" in page.find_element("id", "plots").text)
    wait(page, lambda: difference(page.execute_script(CENTRE), [0] * 64 * 48 * 3) > 1)
    keep_screenshot(page, "wipe-dark")
    click(page, "#mode label:nth-child(3)")
    click(page, "#theme")
    wait(page, lambda: page.execute_script("return document.documentElement.dataset.theme") == "light")
    before = measured(page)["frames"]
    wait(page, lambda: measured(page)["frames"] > before + 3)
    keep_screenshot(page, "side-by-side-light")
    page.find_element("css selector", "#restorer option[value=none]").click()
    wait(page, lambda: show.controls.restorer == "none")


@pytest.mark.parametrize("name", ["occlusion", "confidence", "detail", "tiles", "reference"])
def test_an_overlay_is_drawn_over_the_picture_and_goes_again(page: Any, show: BallShow, name: str) -> None:
    press(page, " ")
    wait(page, lambda: not show.controls.playing and measured(page)["frame"] == show.controls.frame)
    before = measured(page)["frames"]
    wait(page, lambda: measured(page)["frames"] > before + 5)  # by then the video has settled on the still picture
    bare = page.execute_script(CENTRE)
    click(page, f"#overlays input[value={name}]")
    wait(page, lambda: difference(bare, page.execute_script(CENTRE)) > 0.2)
    drawn = difference(bare, page.execute_script(CENTRE))
    keep_screenshot(page, f"overlay-{name}")
    click(page, f"#overlays input[value={name}]")
    wait(page, lambda: difference(bare, page.execute_script(CENTRE)) < drawn / 2)


def test_the_resolution_is_chosen_by_keyboard_and_what_auto_chose_is_told(page: Any, show: BallShow) -> None:
    page.execute_script("document.getElementById('exactness').focus()")
    press(page, "\ue004")
    assert page.execute_script("return document.activeElement.id") == "resolution"
    press(page, "\ue015")
    wait(page, lambda: show.controls.resolution == "half")
    assert page.find_element("id", "pixels").text == ""
    press(page, "\ue015")
    wait(page, lambda: page.find_element("id", "pixels").text == "chose full")
    press(page, "\ue013\ue013")
    wait(page, lambda: show.controls.resolution == "full" and page.find_element("id", "pixels").text == "")


def test_a_choice_of_what_is_done_and_a_lost_server_are_told(page: Any, show: BallShow) -> None:
    page.find_element("css selector", "#restorer option[value=none]").click()
    wait(page, lambda: show.controls.restorer == "none")
    show.controls.away = True
    wait(page, lambda: page.find_element("id", "link-state").text == "server lost")
    show.controls.away = False
    wait(page, lambda: page.find_element("id", "link-state").text == "live")


def test_a_page_that_nobody_sees_is_not_drawn_for(page: Any, show: BallShow) -> None:
    (state,) = show.view._pages.values()
    page.execute_script("""
        Object.defineProperty(document, 'hidden', {configurable: true, get: () => true});
        window.requestAnimationFrame = (later) => { window.later = later; return 0; };
    """)

    def settled() -> bool:  # a refresh that was asked for before may still come
        before = state.sent
        time.sleep(0.5)
        return not state.ready and state.sent == before

    wait(page, settled)
    sent = state.sent
    time.sleep(1.0)
    assert state.sent == sent
    page.execute_script("delete document.hidden; window.later(performance.now())")
    wait(page, lambda: state.sent > sent)


def test_a_page_on_this_machine_shows_the_colours_that_h264_gives(show: BallShow, tmp_path: Path) -> None:
    pictures = []
    show.controls.pause()
    with chromium(tmp_path) as running:
        for asked, codec in (("", "i420"), ("?h264", "avc1.")):
            running.get(show.view.url + asked)
            wait(running, lambda: measured(running)["frames"] > 8)
            assert measured(running)["codec"].startswith(codec)
            pictures.append(running.execute_script(CENTRE))
        assert difference(*pictures) < 1.5
        assert complaints(running) == []


def test_a_browser_without_webcodecs_gets_jpeg(show: BallShow, tmp_path: Path) -> None:
    with chromium(tmp_path) as running:
        running.get(show.view.url + "?jpeg")
        wait(running, lambda: measured(running)["frames"] > 3)
        assert measured(running)["codec"] == "jpeg"
        assert complaints(running) == []


def test_a_phone_sees_the_picture_without_scrolling_sideways(show: BallShow, tmp_path: Path) -> None:
    show.controls.play()
    with chromium(tmp_path, width=390, height=844, phone=True) as running:
        running.get(show.view.url)
        wait(running, lambda: measured(running)["frames"] > 3)
        assert running.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        box = running.execute_script("return document.getElementById('picture').getBoundingClientRect().toJSON()")
        assert box["width"] == pytest.approx(390, abs=1)
        assert box["bottom"] < 844
        keep_screenshot(running, "phone-dark")
        assert complaints(running) == []


def test_a_phone_on_its_side_has_picture_and_settings_beside_each_other(show: BallShow, tmp_path: Path) -> None:
    show.controls.play()
    with chromium(tmp_path, width=844, height=390, phone=True) as running:
        running.get(show.view.url)
        wait(running, lambda: measured(running)["frames"] > 3)
        script = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
        picture, transport, panel = (running.execute_script(script, s) for s in ("#picture", ".transport", "#panel"))
        assert picture["height"] > 240
        assert picture["bottom"] <= transport["top"] + 1
        assert transport["bottom"] <= 390
        assert transport["right"] <= panel["left"] + 1
        assert (panel["right"], panel["bottom"]) == (844, 390)
        inside = "const t = document.querySelector('.transport'); return t.scrollWidth <= t.clientWidth"
        assert running.execute_script(inside)
        running.execute_script("document.getElementById('delay').scrollIntoView()")
        assert running.execute_script(script, "#picture") == picture
        keep_screenshot(running, "phone-landscape-dark")
        assert complaints(running) == []


def test_controls_have_names_and_are_reached_by_tab(page: Any) -> None:
    unnamed = page.execute_script(
        """return [...document.querySelectorAll('button, input, select, [role=slider], canvas')].filter((node) =>
             !(node.getAttribute("aria-label") || node.labels?.length || node.textContent.trim()))
             .map((node) => node.outerHTML.slice(0, 80))"""
    )
    assert unnamed == []
    reached = set()
    for _ in range(40):
        press(page, "\ue004")
        reached.add(page.execute_script("return document.activeElement.id"))
    assert {"picture", "play", "loop", "seek", "theme", "picture-a", "restorer"} <= reached
