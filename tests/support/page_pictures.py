"""Pictures of the page for ``docs/images/web``: ``PYTHONPATH=tests python -m support.page_pictures SCENES OUT``.

``SCENES`` is a folder of bundles, of which the first by name is played. Pages are shown as they are at full detail, by a
headless Chromium on a software adapter; there a screenshot lacks the canvas, which is therefore read out and put in its
place.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cags_bench.web.browser import chromium
from cags_common.bundle.reader import MANIFEST_NAME
from support.web_page import STILL, Page, Server, served

UPLOADS = ("--accept-uploads",)
PHONE, WIDE, LANDSCAPE = (390, 780), (1120, 630), (780, 360)

READ_OUT = """
const done = arguments[0], canvas = document.getElementById("picture");
window.cags.renderer.present();
canvas.toBlob((blob) => {
  const copy = new Image();
  copy.onload = () => done();
  copy.style.cssText = "position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain";
  copy.src = URL.createObjectURL(blob);
  canvas.after(copy);
});
"""


@dataclass(frozen=True)
class Shot:
    """One picture of the played scene; ``before`` is a script of the page."""

    name: str
    size: tuple[int, int]
    theme: str
    before: str = ""
    phone: bool = False


SHOTS = (
    Shot("wide-dark", WIDE, "dark"),
    Shot("wide-light", WIDE, "light"),
    Shot("inspector-dark", WIDE, "dark", "document.getElementById('inspect').click()"),
    Shot("inspector-light", WIDE, "light", "document.getElementById('inspect').click()"),
    Shot("narrow-dark", PHONE, "dark", phone=True),
    Shot("narrow-light", PHONE, "light", phone=True),
    Shot("narrow-inspector-dark", PHONE, "dark", "document.getElementById('inspect').click()", phone=True),
    Shot("landscape-dark", LANDSCAPE, "dark", phone=True),
)


class Pictures:
    """Takes them, of one server."""

    def __init__(self, server: Server, scene: str, out: Path) -> None:
        self._server, self._scene, self._out = server, scene, out
        out.mkdir(parents=True, exist_ok=True)

    def scene(self, shot: Shot) -> None:
        """The played scene, paused at full detail."""
        with self._browser(shot.size, shot.theme, phone=shot.phone) as browser:
            page = Page(browser)
            pixels = "x".join(str(round(side)) for side in shot.size)
            browser.get(f"{self._server.url}?scene={self._scene}#paused&size={pixels}")
            page.until(STILL)
            page.do(shot.before)
            page.until("player.status.rttMs !== undefined")
            browser.execute_async_script(READ_OUT)
            self._save(browser, shot.name)

    def words(self, name: str, size: tuple[int, int], theme: str, *, place: str, ready: str, webgpu: bool = True) -> None:
        """A page without a picture, once ``ready`` (an expression) holds."""
        with self._browser(size, theme, phone=size == PHONE, webgpu=webgpu) as browser:
            browser.get(self._server.url + place)
            Page(browser).until(ready)
            self._save(browser, name)

    def _browser(self, size: tuple[int, int], theme: str, *, phone: bool, webgpu: bool = True) -> Any:
        profile = Path(tempfile.mkdtemp(prefix="cags-pictures-"))
        return chromium(profile, width=size[0], height=size[1], theme=theme, phone=phone, webgpu=webgpu)

    def _save(self, browser: Any, name: str) -> None:
        browser.save_screenshot(str(self._out / f"{name}.png"))
        print(self._out / f"{name}.png", flush=True)


def main(scenes: Path, out: Path, only: str = "") -> None:
    """Take all pictures, or those whose names begin with ``only``."""
    names = sorted(path.name for path in scenes.iterdir() if (path / MANIFEST_NAME).is_file())
    with tempfile.TemporaryDirectory() as work, served(scenes, Path(work), *UPLOADS) as server:
        pictures = Pictures(server, names[0], out)
        said = "document.querySelector('#stage[data-failed]') !== null"
        listed = f"document.querySelectorAll('#scenes img').length === {len(names)} && [...document.images].every((i) => i.complete)"
        if "gallery".startswith(only):
            pictures.words("gallery-dark", WIDE, "dark", place="", ready=listed)
            pictures.words("gallery-narrow-light", PHONE, "light", place="", ready=listed)
        if "error".startswith(only):
            pictures.words("error-dark", WIDE, "dark", place="?scene=nowhere", ready=said)
            pictures.words("unsupported-dark", WIDE, "dark", place=f"?scene={names[0]}", ready=said, webgpu=False)
        for shot in SHOTS:
            if shot.name.startswith(only):
                pictures.scene(shot)
    if "token".startswith(only):
        with tempfile.TemporaryDirectory() as work, served(scenes, Path(work), "--token", "sesame") as server:
            asks = "!document.getElementById('token').hidden"
            place = f"?scene={names[0]}"
            Pictures(server, names[0], out).words("token-narrow-light", PHONE, "light", place=place, ready=asks)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:4])
