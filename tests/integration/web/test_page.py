"""The viewer in a real browser: a live server's scene, played, steered, and drawn as Python draws it."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.web_page import STILL, WHOLE, Page, Server, encoded, page, require_page, same_as_python, served

ROOM = "procedural:size=800,frames=20,seed=1,fps=5,degree=1"
MOVING = "fourd:splats=700,births=60,frames=12,fps=5,degree=1,seed=2"
SMALL = ("--reference-width", "64", "--reference-height", "48", "--visible-px", "0")
"""Whatever contributes to the picture is sent: what is compared holds everything."""

BEHIND = "window.behind = true; Object.defineProperty(document, 'hidden', { get: () => window.behind })"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_page()
    return encoded(ROOM, tmp_path_factory.mktemp("room") / "room.cags")


@pytest.fixture(scope="module")
def server(room: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with served(room, tmp_path_factory.mktemp("server"), *SMALL) as running:
        yield running


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Page]:
    with page(tmp_path) as running:
        yield running
        assert running.complaints() == []


@pytest.mark.slow
def test_the_first_picture_is_pythons_byte_for_byte(viewer: Page, server: Server, room: Path) -> None:
    viewer.open(server.url, "paused")
    viewer.until(STILL)
    same_as_python(viewer, room)


@pytest.mark.slow
def test_frames_from_other_places_and_times_are_pythons(viewer: Page, server: Server, room: Path) -> None:
    viewer.open(server.url, "paused")
    viewer.until(STILL)
    for frame in (3, 8):
        viewer.do(f"player.seek({frame}); window.cags.camera.turn({0.1 * frame}, 0.03)")
        viewer.until(f"player.shown.frame === {frame} && {STILL}")
        same_as_python(viewer, room)


@pytest.mark.slow
def test_a_moving_scene_is_pythons(tmp_path: Path) -> None:
    bundle = encoded(MOVING, tmp_path / "moving.cags")
    with served(bundle, tmp_path, *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url, "paused")
        viewer.until(STILL)
        for frame in (0, 5):
            viewer.do(f"player.seek({frame})")
            viewer.until(f"player.shown.frame === {frame} && {STILL}")
            same_as_python(viewer, bundle)
        assert viewer.complaints() == []


@pytest.mark.slow
def test_a_tab_opened_behind_another_one_joins_once_it_is_seen(viewer: Page, server: Server) -> None:
    def watching() -> int:
        with urllib.request.urlopen(f"{server.url}status.json", timeout=20) as answer:
            return len(json.load(answer)["sessions"])

    viewer.browser.get("about:blank")
    viewer.until_true(lambda: not watching(), "viewers of earlier tests leave")
    viewer.browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": BEHIND})
    viewer.open(server.url)
    viewer.until("window.cags?.show.renderer")  # the device is there
    assert viewer.ask("player === null") and not watching()
    viewer.browser.execute_script("window.behind = false; document.dispatchEvent(new Event('visibilitychange'))")
    viewer.until("player?.shown")
    assert watching() == 1


@pytest.mark.slow
def test_plays_pauses_seeks_and_loops(viewer: Page, server: Server) -> None:
    viewer.open(server.url)
    first = viewer.until("player?.shown && player.shown.frame + 1") - 1
    viewer.until(f"player.shown.frame > {first}")
    viewer.do("document.getElementById('play').click()")
    still = viewer.ask("player.frame")
    viewer.until("!player.playing")
    viewer.do("player.seek(18)")
    viewer.until("player.shown.frame === 18 && !player.waiting")
    assert viewer.ask("player.frame") == 18 != still
    viewer.do("document.getElementById('play').click()")
    viewer.until("player.playing && player.shown.frame < 15", 60)
    assert viewer.ask("document.getElementById('play').getAttribute('aria-label')") == "Pause"


@pytest.mark.slow
def test_a_lost_server_is_said_and_comes_back_by_itself(tmp_path: Path, room: Path) -> None:
    with served(room, tmp_path / "server", *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url)
        viewer.until("player?.shown && player.status?.link === 'open'")
        server.stop()
        viewer.until("player.status.link === 'away'")
        viewer.until_true(lambda: "server is not there" in viewer.words, "the page says so")
        assert viewer.ask("player.shown !== null")
        server.start()
        viewer.until("player.status.link === 'open'")
        at = viewer.ask("player.pictures")
        viewer.until(f"player.pictures > {at}")
        assert not viewer.browser.find_element("id", "message").is_displayed()


@pytest.mark.slow
def test_a_token_is_asked_for(tmp_path: Path, room: Path) -> None:
    with served(room, tmp_path / "server", "--token", "sesame", *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url)
        viewer.until_true(lambda: "asks for a token" in viewer.words, "the page asks")
        viewer.browser.find_element("id", "token-text").send_keys("wrong\n")
        viewer.until_true(lambda: "does not open" in viewer.words, "a wrong one is said to be")
        field = viewer.browser.find_element("id", "token-text")
        field.clear()
        field.send_keys("sesame\n")
        viewer.until("player?.shown && player.pictures > 0")


@pytest.mark.slow
def test_a_token_in_a_new_address_counts(tmp_path: Path, room: Path) -> None:
    with served(room, tmp_path / "server", "--token", "sesame", *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url, "token=wrong")
        viewer.until_true(lambda: "does not open" in viewer.words, "a wrong one is said to be")
        viewer.browser.execute_script("location.hash = '#paused&token=sesame'")
        viewer.until("player?.shown")


@pytest.mark.slow
def test_after_a_lost_device_the_visit_goes_on_where_it_was(tmp_path: Path, room: Path) -> None:
    with served(room, tmp_path / "server", "--token", "sesame", *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url, "background=204060&camera=fly&once&target=0,0,1")
        address = viewer.browser.current_url
        viewer.until_true(lambda: "asks for a token" in viewer.words, "the page asks")
        viewer.browser.find_element("id", "token-text").send_keys("sesame\n")
        viewer.until("player?.shown && player.pictures > 0")
        viewer.do("player.pause(); player.seek(7); window.cags.camera.turn(0.3, 0.1); window.before = true")
        viewer.until("player.shown.frame === 7 && !player.waiting")
        before = viewer.ask("({ place: window.cags.place, pose: window.cags.camera.pose })")
        viewer.browser.execute_cdp_cmd("Browser.crashGpuProcess", {})
        viewer.until("window.cags && !window.before && player?.shown && !player.waiting")
        after = viewer.ask("({ place: window.cags.place, pose: window.cags.camera.pose })")
        assert "graphics processor was lost" in viewer.ask("document.getElementById('toast').textContent")
        assert {**before["place"], "seconds": 1.4, "playing": False} == {
            name: value for name, value in after["place"].items() if name not in ("pose",)
        }
        assert after["place"]["token"] == "sesame"
        assert after["pose"]["position"] == pytest.approx(before["pose"]["position"])
        assert viewer.ask("[player.shown.frame, player.playing, player.loop]") == [7, False, False]
        assert viewer.browser.current_url == address
        assert viewer.ask("sessionStorage.length") == 0
        viewer.do("window.before = true")
        viewer.browser.execute_cdp_cmd("Browser.crashGpuProcess", {})
        viewer.until_true(lambda: "a second time" in viewer.words, "a page that was just loaded anew is not again")
        assert viewer.ask("window.before")
        viewer.browser.find_element("id", "again").click()
        viewer.until("window.cags && !window.before")  # whether there is a device now is up to the browser


@pytest.mark.slow
def test_a_device_that_refuses_a_buffer_ends_the_play_with_a_word(tmp_path: Path, server: Server) -> None:
    with page(tmp_path) as viewer:
        viewer.open(server.url)
        viewer.until("player?.shown && player.pictures > 0")
        viewer.do("window.cags.show.renderer.gpu.device.createBuffer({ size: 2 ** 50, usage: GPUBufferUsage.STORAGE })")
        viewer.until_true(lambda: "The graphics processor" in viewer.words, "the page says why")
        assert "The play has ended" in viewer.words
        viewer.until("document.getElementById('light-text').textContent === 'this device: cannot draw'", 10)
        viewer.browser.find_element("id", "again").click()
        viewer.until("player?.shown && player.pictures > 0 && !window.cags.show.renderer.gpu.lost")


@pytest.mark.slow
def test_two_pages_have_a_camera_each(tmp_path: Path, server: Server, room: Path) -> None:
    with page(tmp_path / "one") as one, page(tmp_path / "two") as two:
        one.open(server.url, "paused")
        two.open(server.url, "paused&t=1")
        one.until(STILL)
        two.until(STILL)
        two.do("window.cags.camera.turn(0.6, 0.1)")
        two.until("player.shown.camera.pose.rotation[0] === window.cags.camera.pose.rotation[0]")
        same_as_python(one, room)
        same_as_python(two, room)
        assert one.shown().values["camera"] != two.shown().values["camera"]
        assert one.complaints() == two.complaints() == []


@pytest.mark.slow
def test_a_window_that_is_turned_keeps_the_play_and_what_is_held(viewer: Page, server: Server, room: Path) -> None:
    viewer.browser.set_window_size(600, 300)
    viewer.browser.get(f"{server.url}#paused")
    viewer.until(WHOLE)
    viewer.do("window.before = player")
    viewer.browser.set_window_size(500, 700)
    viewer.until(f"{WHOLE} && player.shown.camera.intrinsics.heightPx > player.shown.camera.intrinsics.widthPx")
    viewer.until("player.status.link === 'open' && player.shown.reference?.connection === 2")
    assert viewer.ask("player === window.before && player.status.reconnects === 0")
    same_as_python(viewer, room)
