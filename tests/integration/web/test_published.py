"""A published folder behind a plain web host, in a real browser: plays, seeks, adapts to the link; Python's picture."""

from __future__ import annotations

import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from cags_bench.web import hosts
from cags_common.errors import ConfigError
from cags_encoder.bundles.publish import built_page, publish
from support.web_page import SIZE, WHOLE, Page, encoded, page, require_page, same_as_python

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOM = "procedural:size=800,frames=20,seed=1,fps=5,degree=1"
THIN_LINK = "generated:steady-0.4"

PIPELINES = """
window.compiled = { ahead: [], late: [] };
const kinds = [["createComputePipelineAsync", "ahead"], ["createComputePipeline", "late"]];
for (const [name, list] of window.GPUDevice ? kinds : []) {
  const own = GPUDevice.prototype[name];
  GPUDevice.prototype[name] = function (described) {
    window.compiled[list].push(described.label);
    return own.call(this, described);
  };
}
"""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_page()
    return encoded(ROOM, tmp_path_factory.mktemp("room") / "room.cags")


@pytest.fixture(scope="module")
def host(room: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    folder = tmp_path_factory.mktemp("host")
    publish(str(room), folder / "site", built_page())
    try:
        with hosts.nginx(folder / "site", folder / "nginx") as port:
            yield port
    except ConfigError as error:
        pytest.skip(str(error))


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Page]:
    with page(tmp_path) as running:
        yield running
        assert running.complaints() == []


def test_its_pictures_are_pythons_byte_for_byte_after_seeks_too(viewer: Page, host: int, room: Path) -> None:
    viewer.open(f"http://localhost:{host}/", "paused")
    viewer.until(WHOLE)
    same_as_python(viewer, room)
    viewer.do("player.seek(13); window.cags.camera.turn(0.3, 0.05)")
    viewer.until(f"player.shown.frame === 13 && {WHOLE}")
    same_as_python(viewer, room)
    assert viewer.ask("player.status.bytesReference") == 0
    viewer.do("document.getElementById('inspect').click()")
    viewer.until("document.getElementById('figures').textContent.includes('Received')")
    assert viewer.ask("document.getElementById('correct').checkVisibility()") is False
    assert viewer.ask("/orrection/.test(document.getElementById('inspector').innerText)") is False


def test_a_play_can_be_begun_again_while_a_picture_is_being_drawn(viewer: Page, host: int) -> None:
    viewer.open(f"http://localhost:{host}/")
    viewer.until("player?.shown")
    for time in range(3):
        viewer.until("player.drawing")
        viewer.do(f"window.before = player; location.hash = 'size={SIZE[0]}x{SIZE[1]}&t={time}'")
        viewer.until("player !== window.before && player?.shown", 60)
    viewer.until(WHOLE)
    assert viewer.words.splitlines()[0] != "The play has ended"


def test_shaders_of_references_are_not_compiled_and_all_others_beforehand(viewer: Page, host: int) -> None:
    viewer.browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": PIPELINES})
    viewer.open(f"http://localhost:{host}/")
    viewer.until("player?.pictures > 1")
    compiled = viewer.ask("window.compiled")
    assert compiled["late"] == []
    assert "blend.blend" in compiled["ahead"]
    of_references = {label for label in compiled["ahead"] if label.startswith(("correct.", "compare.", "changed."))}
    assert of_references == {"correct.plain"}


def test_what_is_compressed_already_is_handed_out(host: int) -> None:
    for name in ("page.js", "worker.js", "kernels.wasm", "manifest.json"):
        request = urllib.request.Request(f"http://127.0.0.1:{host}/{name}", headers={"Accept-Encoding": "gzip"})
        with urllib.request.urlopen(request, timeout=20) as answer:
            assert answer.headers["Content-Encoding"] == "gzip"
            assert int(answer.headers["Content-Length"]) == len(answer.read()), "known beforehand: it lies there"


def test_over_a_thin_link_it_plays_every_frame_whole(viewer: Page, host: int, room: Path, tmp_path: Path) -> None:
    with hosts.link(THIN_LINK, host, tmp_path / "link") as port:
        viewer.open(f"http://localhost:{port}/", "once")
        viewer.until("player?.shown && !player.playing && player.shown.frame === player.info.frames - 1")
        viewer.until("player.shown.update.full")
        assert viewer.ask("player.missed") == 0, "no frame is shown before its data is there"
        assert viewer.ask("player.status.decodeErrors") == 0
