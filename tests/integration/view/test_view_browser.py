"""The page with a client behind it, in a browser without WebGPU: pictures, a hand on the camera, the bar, the panel."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cags_client.output.page import ViewSettings
from support.browser import chromium, keep_screenshot, require_browser
from support.client_page import choose, click, drag
from support.live_page import BallShow, StillWalk
from support.web_page import require_built

pytestmark = pytest.mark.slow

WAIT_S = 30
CENTRE = """
const canvas = document.getElementById('picture'), copy = new OffscreenCanvas(64, 48), c = copy.getContext('2d');
c.drawImage(canvas, 0, 0, 64, 48);
return Array.from(c.getImageData(0, 0, 64, 48).data).filter((_, i) => i % 4 < 3);
"""


@contextmanager
def in_a_thread(settings: ViewSettings | None = None) -> Iterator[BallShow]:
    """The balls on a page, served from a thread of their own."""
    ready = threading.Event()
    box: list[tuple[BallShow, Callable[[], object]]] = []

    async def run() -> None:
        over, loop = asyncio.Event(), asyncio.get_running_loop()
        async with BallShow(settings) as running:
            box.append((running, lambda: loop.call_soon_threadsafe(over.set)))
            ready.set()
            await over.wait()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    assert ready.wait(20)
    running, end = box[0]
    try:
        yield running
    finally:
        end()
        thread.join()


@pytest.fixture(scope="module")
def show() -> Iterator[BallShow]:
    require_browser()
    require_built()
    with in_a_thread() as running:
        yield running


@pytest.fixture
def page(show: BallShow, tmp_path: Path) -> Iterator[Any]:
    with at_rest(show), chromium(tmp_path) as running:
        visit(running, show, "?h264")
        yield running
        assert complaints(running) == []


@contextmanager
def at_rest(show: BallShow) -> Iterator[None]:
    """Nobody has hold of the camera, and the balls play."""
    show.view.poses.release()
    show.controls.play()
    show.controls.set_loop(True)
    show.controls.set_rate(1.0)
    yield
    ends = time.monotonic() + 10
    while show.view.pages and time.monotonic() < ends:
        time.sleep(0.05)  # else the next page would watch this one


def visit(running: Any, show: BallShow, address: str = "") -> None:
    running.get(show.view.url + address)
    wait(running, lambda: asked(running, "player.pictures") > 3)


def wait(running: Any, condition: Callable[[], bool], seconds: float = WAIT_S) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(running, seconds, poll_frequency=0.1).until(lambda _: condition())


def asked(running: Any, expression: str) -> Any:
    """An expression over the page's ``player``."""
    return running.execute_script(f"const {{ player, camera }} = window.cags; return {expression}")


def codec(running: Any) -> str:
    return str(asked(running, "player.shown.pictures[0].codec"))


def complaints(running: Any) -> list[str]:
    return [entry["message"] for entry in running.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


def difference(a: list[int], b: list[int]) -> float:
    return sum(abs(x - y) for x, y in zip(a, b, strict=True)) / len(a)


def press(running: Any, keys: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    ActionChains(running).send_keys(keys).perform()


def words(running: Any) -> str:
    """What is said over the picture; nothing where nothing is."""
    message = running.find_element("id", "message")
    return str(message.text) if message.is_displayed() else ""


def light(running: Any) -> str:
    return str(running.execute_script("return document.getElementById('light-text').textContent"))


def paused(running: Any, show: BallShow) -> list[int]:
    """Pause, and wait until the video has settled on the still picture; what is seen then."""
    press(running, " ")
    wait(running, lambda: not show.controls.playing and asked(running, "player.shown.frame") == show.controls.frame)
    before = asked(running, "player.pictures")
    wait(running, lambda: asked(running, "player.pictures") > before + 5)
    return list(running.execute_script(CENTRE))


def test_pictures_come_without_webgpu_move_by_h264_and_stand_still_when_paused(page: Any, show: BallShow) -> None:
    assert codec(page).startswith("avc1.")
    assert page.execute_script("return navigator.gpu?.requestAdapter() ?? null") is None
    page.get_log("browser")  # having asked is itself a complaint
    assert words(page) == ""
    first = page.execute_script(CENTRE)
    wait(page, lambda: difference(first, page.execute_script(CENTRE)) > 1)
    still = paused(page, show)
    before = asked(page, "player.pictures")
    wait(page, lambda: asked(page, "player.pictures") > before + 5)
    assert difference(still, page.execute_script(CENTRE)) < 1
    click(page, "#play")
    wait(page, lambda: show.controls.playing)


def test_seek_step_loop_and_speed_reach_the_client(page: Any, show: BallShow) -> None:
    paused(page, show)
    choose(page, "#time", "12")
    wait(page, lambda: show.controls.frame == 12 == asked(page, "player.shown.frame"))
    press(page, ".")
    wait(page, lambda: show.controls.frame == 13 == asked(page, "player.shown.frame"))
    press(page, ",")
    wait(page, lambda: show.controls.frame == 12)
    assert page.find_element("id", "clock").text.startswith("0:00.4")
    click(page, "#loop")
    choose(page, "#rate", "0.5")
    wait(page, lambda: not show.controls.loop and show.controls.rate == 0.5)
    show.controls.set_loop(True)  # by another hand: the page shows it
    wait(page, lambda: page.execute_script("return document.getElementById('loop').checked"))


def test_a_hand_on_the_picture_moves_the_clients_camera_and_is_timed(page: Any, show: BallShow) -> None:
    before = paused(page, show)
    followed = asked(page, "camera.pose.position")
    assert followed == pytest.approx(show.view.poses.pose_at(0).position, abs=1e-5)
    assert not show.view.poses.held
    drag(page, 9, 2)
    wait(page, lambda: asked(page, "player.photonMs.length") > 0)
    assert show.view.poses.held
    wait(page, lambda: asked(page, "camera.pose.position") == pytest.approx(show.view.poses.pose_at(0).position))
    assert difference(before, page.execute_script(CENTRE)) > 1
    assert 0 < max(asked(page, "player.photonMs")) < 10_000
    click(page, "#follow")
    wait(page, lambda: not show.view.poses.held)
    wait(page, lambda: asked(page, "camera.pose.position") == pytest.approx(followed, abs=1e-5))


def test_keys_move_the_camera_and_the_pose_reaches_the_player_with_its_own_time(page: Any, show: BallShow) -> None:
    began_us = page.execute_script("return (performance.timeOrigin + performance.now()) * 1000")
    click(page, "#picture")
    press(page, "wwd")
    wait(page, lambda: show.view.poses.held)
    wait(page, lambda: asked(page, "player.shown.pose_at_us") is not None)
    at_us = asked(page, "player.shown.pose_at_us")
    assert began_us < at_us <= page.execute_script("return (performance.timeOrigin + performance.now()) * 1000")
    held = show.view.poses.pose_at(0)
    assert show.view.poses.time_of(held) == at_us
    assert held.position != StillWalk().pose_at(0).position
    press(page, "h")
    wait(page, lambda: show.view.poses.pose_at(0).position != held.position)


def test_two_pictures_overlays_and_figures(page: Any, show: BallShow) -> None:
    click(page, "#inspect")
    choose(page, "#picture-b", "distorted")
    for name in ("occlusion", "tiles", "reference", "score"):
        click(page, f"#overlay-{name}")
    wait(page, lambda: asked(page, "player.shown.pictures.length") == 2)
    wait(page, lambda: "restored" in page.execute_script("return document.getElementById('plots').textContent"))
    wait(page, lambda: "dB" in page.find_element("id", "figures").text)
    keep_screenshot(page, "wipe")
    left = paused(page, show)
    choose(page, "#wipe", "0")
    wait(page, lambda: difference(left, page.execute_script(CENTRE)) > 0.2)
    choose(page, "#set-restorer", "none")
    wait(page, lambda: show.controls.restorer == "none")
    choose(page, "#set-restorer", "correct")


@pytest.mark.parametrize("name", ["occlusion", "confidence", "detail", "tiles", "reference"])
def test_an_overlay_is_drawn_over_the_picture_and_goes_again(page: Any, show: BallShow, name: str) -> None:
    bare = paused(page, show)
    click(page, f"#overlay-{name}")
    wait(page, lambda: difference(bare, page.execute_script(CENTRE)) > 0.2)
    drawn = difference(bare, page.execute_script(CENTRE))
    keep_screenshot(page, f"overlay-{name}")
    click(page, f"#overlay-{name}")
    wait(page, lambda: difference(bare, page.execute_script(CENTRE)) < drawn / 2)


def test_what_auto_chose_and_a_lost_server_are_told(page: Any, show: BallShow) -> None:
    click(page, "#inspect")
    choose(page, "#set-resolution", "auto")
    wait(page, lambda: "full, chosen" in page.find_element("id", "figures").text)
    choose(page, "#set-resolution", "full")
    wait(page, lambda: show.controls.resolution == "full")
    show.controls.away = True
    wait(page, lambda: "server is not there" in words(page) and light(page) == "server: not reached")
    show.controls.away = False
    wait(page, lambda: words(page) == "" and "not reached" not in light(page))


def test_a_second_page_watches_the_first_one_and_says_so(page: Any, show: BallShow, tmp_path: Path) -> None:
    with chromium(tmp_path / "second") as other:
        visit(other, show)
        watching = other.find_element("id", "watching")
        assert watching.is_displayed()
        assert not page.find_element("id", "watching").is_displayed()
        drag(other, 9, 2)
        press(other, " ")
        wait(other, lambda: "another page steers" in other.find_element("id", "toast").text)
        assert show.controls.playing
        assert not show.view.poses.held
        controls = ["play", "time", "loop", "rate", "set-restorer", "set-exactness", "set-resolution", "follow"]
        unusable = f"return {controls}.filter((id) => !document.getElementById(id).disabled)"
        assert other.execute_script(unusable) == [], "what it shows stays true"
        asked(other, "player.seek(55)")
        assert asked(other, "player.waiting") is False, "its clock goes on with the other's play"
        drag(page, 9, 2)
        wait(page, lambda: show.view.poses.held)
        assert set(page.execute_script(unusable)) == set(controls)
        steered = asked(page, "camera.pose.position")
        wait(other, lambda: asked(other, "camera.pose.position") == pytest.approx(steered, abs=1e-4))
        page.get("about:blank")
        wait(other, lambda: not watching.is_displayed())
        assert set(controls) - set(other.execute_script(unusable)) <= {"follow"}
        press(other, " ")
        wait(other, lambda: not show.controls.playing)
        page.back()  # browsers keep a page that was left, and its connection is to be made anew
        wait(
            page,
            lambda: asked(page, "player?.pictures ?? 0") > 3 and page.find_element("id", "watching").is_displayed(),
        )
        assert complaints(other) == []


def test_a_client_that_ends_is_said_to_be_gone_and_found_again(tmp_path: Path) -> None:
    require_browser()
    require_built()
    with chromium(tmp_path) as running:
        with in_a_thread() as first:
            visit(running, first)
            port = int(first.view.url.rstrip("/").rpartition(":")[2])
        wait(running, lambda: "client is not there" in words(running) and light(running) == "client: not reached")
        assert difference(running.execute_script(CENTRE), [0] * 64 * 48 * 3) > 1, "the picture stands"
        seen = asked(running, "player.pictures")
        with in_a_thread(ViewSettings(view_port=port)):
            wait(running, lambda: asked(running, "player.pictures") > seen + 3)
            wait(running, lambda: words(running) == "")
        refused = [line for line in complaints(running) if "ERR_CONNECTION_REFUSED" not in line]
        assert refused == [], "nothing but that nobody answered meanwhile"


def test_a_token_is_asked_for_and_a_wrong_one_is_said_to_be(tmp_path: Path) -> None:
    require_browser()
    require_built()
    with chromium(tmp_path) as running, in_a_thread(ViewSettings(view_port=0, view_token="sesame")) as show:
        running.get(show.view.url)
        wait(running, lambda: "asks for a token" in words(running))
        running.find_element("id", "token-text").send_keys("wrong\n")
        wait(running, lambda: "does not open" in words(running))
        field = running.find_element("id", "token-text")
        field.clear()
        field.send_keys("sesame\n")
        wait(running, lambda: asked(running, "player.pictures") > 3)
        assert complaints(running) == []


def test_a_page_too_many_says_so_and_joins_once_there_is_room(
    page: Any, show: BallShow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_client.output.page.server.MAX_PAGES", 1)
    with chromium(tmp_path / "second") as other:
        other.get(show.view.url)
        wait(other, lambda: "takes no more pages" in words(other) and "close one" in words(other))
        assert light(other) == "client: no room"
        links = len(show.view._links)
        time.sleep(1.5)
        assert len(show.view._links) == links == 1, "it does not ask again by itself"
        page.get("about:blank")
        wait(other, lambda: show.view.pages == 0)
        click(other, "#again")
        wait(other, lambda: asked(other, "player.pictures") > 3 and words(other) == "" and light(other) == "good")
        assert complaints(other) == []


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


def test_the_address_says_where_to_begin(show: BallShow, tmp_path: Path) -> None:
    with at_rest(show), chromium(tmp_path) as running:
        visit(running, show, "#t=0.5&pose=0,0,-6,0,0,0,1&paused&once&camera=fly")
        wait(running, lambda: asked(running, "player.shown.frame") == 15 and not show.controls.playing)
        wait(running, lambda: show.view.poses.pose_at(0).position == pytest.approx((0, 0, -6), abs=1e-6))
        assert (show.controls.loop, asked(running, "camera.mode")) == (False, "fly")
        running.execute_script("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
        press(running, "l")
        wait(running, lambda: running.execute_script("return window.copied ?? ''").endswith("camera=fly"))
        assert "#t=0.5&pose=0,0,-6,0,0,0,1&" in running.execute_script("return window.copied")
        assert complaints(running) == []


def test_a_page_on_this_machine_shows_the_colours_that_h264_gives(show: BallShow, tmp_path: Path) -> None:
    pictures = []
    with at_rest(show), chromium(tmp_path) as running:
        show.controls.pause()
        for address, wanted in (("", "i420"), ("?h264", "avc1.")):
            visit(running, show, address)
            wait(running, lambda: asked(running, "player.pictures") > 8)
            assert codec(running).startswith(wanted)
            pictures.append(running.execute_script(CENTRE))
        assert difference(*pictures) < 1.5
        assert complaints(running) == []


def test_a_browser_without_webcodecs_gets_jpeg(show: BallShow, tmp_path: Path) -> None:
    with at_rest(show), chromium(tmp_path) as running:
        visit(running, show, "?jpeg")
        assert codec(running) == "jpeg"
        assert complaints(running) == []


def test_a_phone_sees_the_picture_without_scrolling_sideways(show: BallShow, tmp_path: Path) -> None:
    with at_rest(show), chromium(tmp_path, width=390, height=844, phone=True) as running:
        visit(running, show)
        assert running.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        click(running, "#inspect")
        inside = "const t = document.getElementById('inspector'); return t.scrollWidth <= t.clientWidth"
        assert running.execute_script(inside)
        keep_screenshot(running, "phone-dark")
        assert complaints(running) == []


def test_what_a_small_window_shows_lies_above_its_bar(show: BallShow, tmp_path: Path) -> None:
    boxes = """
      window.cags.messages.toast('Link copied', 60000);
      window.cags.messages.say('The server is not there', 'The picture stands on what has come; it goes on by itself.');
      return Object.fromEntries(['bar', 'inspector', 'toast', 'message'].map(
        (id) => [id, document.getElementById(id).getBoundingClientRect().toJSON()]))"""
    reached = """return ['play', 'time', 'inspect', 'toast', 'headline'].filter((id) => {
      const e = document.getElementById(id), r = e.getBoundingClientRect();
      e.style.pointerEvents = 'auto';
      return !e.contains(document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2)); })"""
    for width, height in ((320, 568), (360, 640), (375, 667)):
        with at_rest(show), chromium(tmp_path / str(width), width=width, height=height, phone=True) as running:
            visit(running, show, "?h264")
            running.execute_script("document.getElementById('vr').hidden = false")  # as with a headset
            click(running, "#inspect")
            time.sleep(0.2)  # until the bar has been measured
            box = running.execute_script(boxes)
            assert box["bar"]["height"] < 110, "two rows"
            assert all(box[name]["bottom"] <= box["bar"]["top"] for name in ("inspector", "toast", "message"))
            assert box["message"]["bottom"] <= box["toast"]["top"]
            assert running.execute_script(reached) == []
            keep_screenshot(running, f"small-{width}")
            assert complaints(running) == []


def test_an_open_inspector_covers_no_token_and_no_way_on(tmp_path: Path) -> None:
    require_browser()
    require_built()
    covered = """return arguments[0].filter((id) => {
      const e = document.getElementById(id), r = e.getBoundingClientRect();
      return !r.width || !e.contains(document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2)); })"""
    for width, height in ((360, 640), (800, 600)):
        with (
            in_a_thread(ViewSettings(view_port=0, view_token="sesame")) as show,
            chromium(tmp_path / str(width), width=width, height=height, phone=width == 360) as running,
        ):
            visit(running, show, "#token=sesame")
            click(running, "#inspect")
            assert running.find_element("id", "inspector").is_displayed()
            running.execute_script("window.cags.failed('The play has ended', 'for a test')")
            assert running.execute_script(covered, ["headline", "again"]) == []
            keep_screenshot(running, f"ended-{width}")
            running.get("about:blank")
            running.get(show.view.url)
            wait(running, lambda: "asks for a token" in words(running))
            assert running.execute_script(covered, ["headline", "token-text"]) == []
            assert focused(running) == "token-text"
            press(running, "\ue00c")
            running.find_element("id", "token-text").send_keys("sesame\n")
            wait(running, lambda: asked(running, "player.pictures") > 3)
            assert not running.find_element("id", "inspector").is_displayed(), "Escape has closed it"
            assert complaints(running) == []


def test_the_client_is_told_of_the_window_and_again_when_it_has_another_size(show: BallShow, tmp_path: Path) -> None:
    show.controls.windows.clear()
    with at_rest(show), chromium(tmp_path) as running:
        visit(running, show)
        size = running.execute_script("return [innerWidth, innerHeight].map((side) => side * devicePixelRatio)")
        wait(running, lambda: show.controls.windows == [tuple(size)])
        for width in (700, 720, 740):
            running.set_window_size(width, 900)
        wait(running, lambda: len(show.controls.windows) > 1 and show.controls.windows[-1][0] == 740)
        assert len(show.controls.windows) <= 3, "not of every step on the way"
        assert complaints(running) == []


def test_controls_have_names_and_are_reached_by_tab(page: Any) -> None:
    click(page, "#inspect")
    unnamed = page.execute_script(
        """return [...document.querySelectorAll('button, input, select, canvas')].filter((node) =>
             node.checkVisibility() &&
             !(node.getAttribute("aria-label") || node.labels?.length || node.textContent.trim()))
             .map((node) => node.outerHTML.slice(0, 80))"""
    )
    assert unnamed == []
    reached = set()
    for _ in range(40):
        press(page, "\ue004")
        reached.add(page.execute_script("return document.activeElement.id"))
    assert {"picture", "play", "time", "inspect", "picture-a", "set-restorer", "loop"} <= reached


def focused(running: Any) -> str:
    return str(running.execute_script("return document.activeElement.id || document.activeElement.dataset.mode || ''"))


def test_keys_are_the_pages_unless_a_control_takes_them(page: Any, show: BallShow) -> None:
    from selenium.webdriver.common.keys import Keys

    paused(page, show)
    before = asked(page, "camera.pose.rotation")
    page.execute_script("document.getElementById('time').focus()")
    press(page, Keys.ARROW_RIGHT)
    wait(page, lambda: not asked(page, "player.waiting"))
    assert asked(page, "camera.pose.rotation") == before, "the slider's arrow turns no camera"
    press(page, "i")
    assert page.find_element("id", "inspector").is_displayed(), "a letter is nothing to a slider"
    page.execute_script("document.getElementById('save-view').focus()")
    press(page, Keys.ESCAPE)
    assert not page.find_element("id", "inspector").is_displayed()
    assert focused(page) == "inspect", "the focus is not lost with what had it"


def test_arrows_choose_among_the_cameras_modes(page: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    page.execute_script("document.querySelector('[data-mode=orbit]').focus()")
    before = asked(page, "camera.pose.rotation")
    for expected in ("walk", "fly", "orbit"):
        press(page, Keys.ARROW_RIGHT)
        assert focused(page) == expected and asked(page, "camera.mode") == expected
    press(page, Keys.ARROW_LEFT)
    assert focused(page) == "fly"
    stops = page.execute_script(
        "return [...document.querySelectorAll('#modes button')].filter((b) => b.tabIndex === 0).length"
    )
    assert stops == 1, "the group is one stop of the tabulator"
    assert asked(page, "camera.pose.rotation") == before


def test_controls_have_names_and_come_in_the_order_in_which_they_are_seen(page: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    press(page, "i")
    page.execute_cdp_cmd("Accessibility.enable", {})
    nodes = page.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    roles = {"button", "slider", "radio", "checkbox", "combobox", "textbox", "link", "Canvas", "application"}
    controls = [node for node in nodes if not node["ignored"] and node["role"]["value"] in roles]
    assert len(controls) > 20
    assert [node for node in controls if not node["name"]["value"].strip()] == []
    spoken = (
        "return [...document.querySelectorAll('[role=status], [role=alert], [aria-live], output')].map((e) => e.id)"
    )
    assert "clock" not in page.execute_script(spoken), "else it is read out ten times a second"
    press(page, "i")
    page.execute_script("document.activeElement.blur(); document.getElementById('picture').focus()")
    order = []
    for _ in range(9):
        press(page, Keys.TAB)
        order.append(focused(page))
    assert order == ["play", "time", "orbit", "home", "share", "snapshot", "record", "inspect", "full"]


def test_a_phone_has_every_control_in_its_window_and_large_enough_for_a_finger(show: BallShow, tmp_path: Path) -> None:
    sizes = """return [...document.querySelectorAll('#bar button, #bar input')].filter((e) => e.checkVisibility())
      .map((e) => [e.id || e.dataset.mode, e.getBoundingClientRect().toJSON()])"""
    for name, width, height in (("upright", 360, 740), ("lying", 740, 360)):
        with at_rest(show), chromium(tmp_path / name, width=width, height=height, phone=True) as running:
            visit(running, show, "?h264")
            found = running.execute_script(sizes)
            assert len(found) >= 11
            for control, box in found:
                assert box["left"] >= 0 and box["right"] <= width and box["bottom"] <= height, (name, control, box)
                assert min(box["width"], box["height"]) >= 24, (name, control, box)  # WCAG 2.2, 2.5.8
            assert complaints(running) == []
