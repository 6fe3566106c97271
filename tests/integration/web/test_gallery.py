"""The gallery and what an author sets, in a real browser: choose a scene, bring one, see it as its author wants."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cags_encoder.formats import write_splats
from support.browser import chromium
from support.capture import three_balls
from support.small_bundles import small_bundle
from support.web_page import Page, Server, page, require_built, require_page, served

VIEW = {
    "title": "Three balls",
    "background": "#306090",
    "pose": [0.1, 0, -6, 0, 0, 0, 1],
    "target": [0, 0, 0],
    "radius": 1,
}
SMALL = ("--reference-width", "64", "--reference-height", "48")
CORNER = """
const done = arguments[0], canvas = document.getElementById("picture");
window.cags.show.renderer.present();
canvas.toBlob(async (blob) => {
  const bitmap = await createImageBitmap(blob);
  const copy = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
  copy.drawImage(bitmap, 0, 0);
  done([...copy.getImageData(0, 0, 1, 1).data]);
});
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_page()
    folder = tmp_path_factory.mktemp("scenes")
    view = folder / "view.json"
    view.write_text(json.dumps(VIEW))
    small_bundle(folder / "balls.cags", frames=2, view=str(view))
    small_bundle(folder / "plain.cags", seed=7)
    return folder


@pytest.fixture(scope="module")
def server(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with served(folder, tmp_path_factory.mktemp("server"), "--accept-uploads", *SMALL) as running:
        yield running


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Page]:
    with page(tmp_path) as running:
        yield running
        assert running.complaints() == []


@pytest.mark.slow
def test_a_scene_is_chosen_and_opens_as_its_author_wants(viewer: Page, server: Server) -> None:
    browser = viewer.browser
    browser.get(server.url)
    cards = viewer.until_true(lambda: browser.find_elements("css selector", "#scenes a"), "the list")
    assert [card.find_element("tag name", "h2").text for card in cards] == ["splats", "Three balls"]
    loaded = "return [...document.images].filter((each) => each.naturalWidth === 480).length"
    viewer.until_true(lambda: browser.execute_script(loaded) == 2, "thumbnails")
    cards[1].click()
    viewer.until("player?.shown?.update.full && player.pictures > 1")
    assert browser.title == "Three balls · cags-stream"
    *position, w, x, y, z = viewer.ask("[...cags.camera.pose.position, ...cags.camera.pose.rotation]")
    assert position == pytest.approx(VIEW["pose"][:3], rel=0.2)
    assert [w, x, y, z] == pytest.approx(VIEW["pose"][3:])
    assert np.abs(np.subtract(browser.execute_async_script(CORNER), (0x30, 0x60, 0x90, 255))).max() <= 1
    browser.find_element("id", "scenes").click()
    viewer.until_true(lambda: browser.find_elements("css selector", "#scenes a h2"), "back at the list")


@pytest.mark.slow
def test_the_address_wins_over_the_author(viewer: Page, server: Server) -> None:
    viewer.browser.get(f"{server.url}?scene=balls#paused&background=ffffff&pose=0,0,-5,0,0,0,1")
    viewer.until("player?.shown && player.pictures > 0")
    assert viewer.ask("cags.camera.pose.position") == pytest.approx([0, 0, -5])
    assert viewer.browser.execute_async_script(CORNER) == [255, 255, 255, 255]
    viewer.do("window.cags.player; document.getElementById('home').click()")
    assert viewer.ask("cags.camera.pose.position") == pytest.approx(VIEW["pose"][:3], rel=0.2)


@pytest.mark.slow
def test_a_file_is_brought_and_watched(viewer: Page, server: Server, folder: Path, tmp_path: Path) -> None:
    browser, frames = viewer.browser, []
    for number in (1, 2):
        frames.append(tmp_path / f"frame {number}.ply")
        write_splats(frames[-1], three_balls(40, number))
    browser.get(server.url)
    field = viewer.until_true(lambda: browser.find_element("id", "files"), "the field")
    viewer.until_true(lambda: browser.find_element("id", "upload").is_displayed(), "files are taken")
    field.send_keys("\n".join(map(str, frames)))
    viewer.until_true(lambda: len(browser.find_elements("css selector", "#scenes a")) == 3, "a third scene")
    assert (folder / "frames.cags/manifest.json").is_file()
    browser.get(f"{server.url}?scene=frames#paused")
    viewer.until("player?.shown && player.info.frames === 2")


@pytest.mark.slow
def test_what_cannot_be_encoded_is_said(viewer: Page, server: Server, tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_bytes(b"ply\nnonsense")
    viewer.browser.get(server.url)
    viewer.until_true(lambda: viewer.browser.find_element("id", "upload").is_displayed(), "files are taken")
    viewer.browser.find_element("id", "files").send_keys(str(tmp_path / "bad.ply"))
    viewer.until_true(lambda: "bad.ply" in viewer.browser.find_element("id", "message").text, "why not")
    assert viewer.browser.find_element("id", "invite").is_displayed()


@pytest.mark.slow
def test_a_scene_that_is_not_there_is_said(tmp_path: Path, server: Server) -> None:
    with page(tmp_path) as viewer:
        viewer.browser.get(f"{server.url}?scene=nowhere")
        viewer.until_true(lambda: "no scene 'nowhere' here" in viewer.words, "so it says")
        assert light(viewer) == "nothing to show"
        viewer.browser.find_element("link text", "All scenes").click()
        viewer.until_true(lambda: viewer.browser.find_elements("css selector", "#scenes a h2"), "the list")
        viewer.complaints()


def light(viewer: Page) -> str:
    return str(viewer.ask("document.getElementById('light-text').textContent"))


@pytest.mark.slow
def test_a_token_in_the_address_opens_the_list_and_goes_with_the_visitor_to_a_scene_and_back(tmp_path: Path) -> None:
    require_built()
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    small_bundle(scenes / "balls.cags")
    with (
        served(scenes, tmp_path / "server", "--token", "open sesame", *SMALL) as server,
        chromium(tmp_path / "profile") as browser,
    ):
        viewer = Page(browser)
        browser.get(f"{server.url}?scene=balls")
        viewer.until_true(lambda: "asks for a token" in viewer.words, "the question for a token", 60)
        viewer.until_true(lambda: light(viewer) == "no token yet", "the light", 60)
        browser.get(server.url)
        viewer.until_true(lambda: "asks for a token" in viewer.words, "the question for a token", 60)
        browser.execute_script("location.hash = 'token=open+sesame'")
        cards = viewer.until_true(lambda: browser.find_elements("css selector", "#scenes a"), "the list", 60)
        cards[0].click()
        viewer.until_true(lambda: "scene=balls" in browser.current_url, "the scene's page", 60)
        browser.find_element("id", "scenes").click()
        viewer.until_true(lambda: browser.find_elements("css selector", "#scenes a h2"), "the list again", 60)


TELL = """
window.told = [];
const message = document.getElementById("message");
new MutationObserver(() => message.hidden || told.push(message.textContent))
  .observe(message, { attributes: true, childList: true });
"""


@pytest.mark.slow
def test_a_wrong_token_is_told_once_each_time_and_can_be_written_over(tmp_path: Path) -> None:
    require_built()
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    small_bundle(scenes / "balls.cags")
    with (
        served(scenes, tmp_path / "server", "--token", "sesame", *SMALL) as server,
        chromium(tmp_path / "profile") as browser,
    ):
        viewer = Page(browser)
        browser.get(server.url)
        field = browser.find_element("id", "token-text")
        viewer.until_true(field.is_displayed, "the form", 60)
        browser.execute_script(TELL)
        for number, token in enumerate(("wrong", "wrong again"), 1):
            field.send_keys(token)
            browser.find_element("css selector", "#token button").click()
            viewer.until_true(lambda n=number: browser.execute_script("return told.length") >= n, "the words", 60)
            assert browser.switch_to.active_element == field
        assert browser.execute_script("return told") == ["This token does not open the server."] * 2
        assert field.get_attribute("aria-invalid") == "true"
        field.send_keys("sesame\n")
        viewer.until_true(lambda: browser.find_elements("css selector", "#scenes a"), "the list", 60)
        viewer.until_true(lambda: browser.switch_to.active_element.tag_name == "a", "the focus on the first scene", 60)
