"""Pictures of the page for ``docs/images/web``: ``PYTHONPATH=tests python -m support.page_pictures SCENES OUT``.

``SCENES`` is a folder of bundles, of which the first by name is played from its first frame. Of a clip made by
``motion:`` take ``kind=bend``: the default kind carries a part of the scene away, the side of a pot for instance. Names
of pictures after ``OUT`` leave out the others. Pages are shown as they are at full detail, by a headless Chromium on a
software adapter; there a screenshot lacks the canvas, which is therefore read out and put in its place. The last
pictures are of ``cags-client --view``. Pictures are WebP of at most 100 kB.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from cags_bench.demo.processes import ProcessGroup
from cags_bench.web.browser import chromium
from cags_common.bundle.reader import MANIFEST_NAME
from support.web_page import Page, Server, served

PHONE, WIDE, LANDSCAPE = (390, 780), (1120, 630), (780, 360)
PATIENCE_S = 1500.0
"""On a busy machine."""

SETTLED_S = 3.0
MOST_BYTES = 100_000
QUALITIES = (90, 80, 70, 60, 50)
INSPECT = """
if (document.getElementById("inspector").hidden === arguments[0]) document.getElementById("inspect").click();
"""
HEADSET = "document.getElementById('vr').hidden = false"
"""As where there is a headset."""

READ_OUT = """
const done = arguments[0], canvas = document.getElementById("picture");
window.cags.show.renderer.present();
canvas.toBlob((blob) => {
  const copy = new Image();
  copy.onload = () => done();
  copy.style.cssText = "position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain";
  copy.src = URL.createObjectURL(blob);
  canvas.after(copy);
});
"""
DETAILED = "player?.shown && !player.waiting && player.shown.update.lodMean > 0.97 * (player.info.lods - 1)"
"""What is in view is at its highest level."""

LISTED = "document.images.length > 0 && [...document.images].every((each) => each.complete)"
FAILED = "document.querySelector('#stage[data-failed]') !== null"
ASKS = "!document.getElementById('token').hidden"


@dataclass(frozen=True)
class Shot:
    """One picture of the played scene, with or without the inspector; ``before`` is a script of the page."""

    name: str
    size: tuple[int, int]
    theme: str
    inspect: bool = False
    before: str = ""
    phone: bool = False


@dataclass(frozen=True)
class Client(Shot):
    """One picture of the page that a Python client serves, in a window that the client draws for."""


@dataclass(frozen=True)
class Words:
    """One picture of a page without a scene on it, at ``place``, once ``ready`` (an expression) holds."""

    name: str
    size: tuple[int, int]
    theme: str
    place: str
    ready: str
    webgpu: bool = True


OPEN = (
    Words("gallery-dark", WIDE, "dark", "", LISTED),
    Words("gallery-narrow-light", PHONE, "light", "", LISTED),
    Words("error-dark", WIDE, "dark", "?scene=nowhere", FAILED),
    Words("unsupported-dark", WIDE, "dark", "?scene={scene}", FAILED, webgpu=False),
    Shot("wide-dark", WIDE, "dark"),
    Shot("inspector-light", WIDE, "light", inspect=True),
    Shot("narrow-dark", PHONE, "dark", phone=True),
    Shot("narrow-light", PHONE, "light", phone=True),
    Shot("narrow-inspector-dark", PHONE, "dark", inspect=True, phone=True),
    Shot("landscape-dark", LANDSCAPE, "dark", phone=True),
    Shot("headset-dark", LANDSCAPE, "dark", before=HEADSET, phone=True),
)
GUARDED = (Words("token-narrow-light", PHONE, "light", "?scene={scene}", ASKS),)
FIRST_VIEW = "document.getElementById('home').click()"
CLIENTS = (
    Client("client-dark", WIDE, "dark", inspect=True, before=FIRST_VIEW),
    Client("client-narrow-light", PHONE, "light", before=FIRST_VIEW, phone=True),
)
FITTED = """player?.shown && (() => {
  const [{ width, height }] = player.shown.pictures;
  return Math.abs((width * innerHeight) / (height * innerWidth) - 1) < 0.02;
})() && player.steers && performance.now() > 20_000"""
"""The client draws for the window's shape, and its first figures have come."""

SERVERS = ((("--accept-uploads", "--visible-px", "0"), OPEN), (("--token", "sesame"), GUARDED))


@dataclass(frozen=True)
class Served:
    """Whoever hands out a page."""

    url: str


def _kept(png: bytes, path: Path) -> str:
    """Write the best WebP that is small enough; says what was written."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    for quality in QUALITIES:
        cv2.imwrite(str(path), picture, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if path.stat().st_size <= MOST_BYTES:
            break
    return f"{path}: {path.stat().st_size} bytes at quality {quality}"


@contextmanager
def viewed(server: Server, scene: str, work: Path) -> Iterator[Served]:
    """A client of ``server`` with a page."""
    with ProcessGroup(work) as group:
        url = server.url.replace("http", "ws") + "stream"
        view = ["--view", "--view-port", "0", "--width", "1600", "--height", "1200", "--json", "-"]
        client = group.start("cags_client", ["--url", url, "--scene", scene, *view])
        yield Served(str(client.ready()["url"]))


class Pictures:
    """Takes them, of one server."""

    def __init__(self, server: Server | Served, scene: str, out: Path) -> None:
        self._server, self._scene, self._out = server, scene, out
        out.mkdir(parents=True, exist_ok=True)

    def take(self, wanted: Sequence[Shot | Words]) -> None:
        """Pictures of one size, in a fresh browser: of one page without a scene, or of one that shows it."""
        first = wanted[0]
        phone = first.size == PHONE or (isinstance(first, Shot) and first.phone)
        webgpu = isinstance(first, Shot) or first.webgpu
        width, height = first.size
        with (
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
            chromium(
                Path(profile), width=width, height=height, theme=first.theme, phone=phone, webgpu=webgpu
            ) as browser,
        ):
            if not phone:  # else the window's own frame is counted in
                metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
                browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
            if isinstance(first, Words):
                browser.get(self._server.url + first.place.format(scene=self._scene))
                Page(browser).until(first.ready)
            elif isinstance(first, Client):
                browser.get(f"{self._server.url}#paused")
                Page(browser).until("player?.pictures > 3")
            else:
                self._scene_in(browser, first)
            for each in wanted:
                self._keep(browser, each)

    def _keep(self, browser: Any, wanted: Shot | Words) -> None:
        scheme = {"features": [{"name": "prefers-color-scheme", "value": wanted.theme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", scheme)
        if isinstance(wanted, Shot):
            browser.execute_script(INSPECT, wanted.inspect)
            browser.execute_script(wanted.before)
        if isinstance(wanted, Client):
            Page(browser).until(FITTED)
        time.sleep(SETTLED_S)
        print(_kept(browser.get_screenshot_as_png(), self._out / f"{wanted.name}.webp"), flush=True)

    def _scene_in(self, browser: Any, shot: Shot) -> None:
        """The played scene, paused at full detail."""
        page = Page(browser)
        pixels = "x".join(str(side) for side in shot.size)
        browser.get(f"{self._server.url}?scene={self._scene}#paused&size={pixels}")
        page.until(DETAILED, PATIENCE_S)
        page.until("player.status.rttMs !== undefined")
        browser.execute_async_script(READ_OUT)


def together(wanted: Sequence[Shot | Words]) -> Iterator[list[Shot | Words]]:
    """Pictures that one page serves: those of the scene by size, each of the others by itself."""
    for _, group in itertools.groupby(wanted, lambda each: each.size if isinstance(each, Shot) else each.name):
        yield list(group)


def main(scenes: Path, out: Path, *only: str) -> None:
    """Take all pictures, or those that are named."""
    played = min(path.name for path in scenes.iterdir() if (path / MANIFEST_NAME).is_file())
    for arguments, all_of_them in SERVERS:
        wanted = [page for page in all_of_them if not only or page.name in only]
        if not wanted:
            continue
        with tempfile.TemporaryDirectory() as work, served(scenes, Path(work), *arguments) as server:
            for pages in together(wanted):
                Pictures(server, played, out).take(pages)
    shots = [shot for shot in CLIENTS if not only or shot.name in only]
    with tempfile.TemporaryDirectory() as work, served(scenes, Path(work), "--visible-px", "0") as server:
        for shot in shots:
            with viewed(server, played, Path(work)) as client:
                Pictures(client, played, out).take([shot])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
