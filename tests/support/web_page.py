"""The viewer in a headless Chromium, a server behind it, and the same frames drawn by Python on the same driver."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import cags_web
from cags_bench.demo.processes import ProcessGroup
from cags_web.build import up_to_date
from support.browser import chromium

ICD = Path("/usr/lib/chromium/vk_swiftshader_icd.json")
SIZE = 160, 120
WAIT_S = 300.0
"""A software adapter on a busy machine draws a picture a second."""

STILL = "player?.shown?.update.full && !player.waiting && player.pictures > 2"
"""Everything is there and shown."""

WHOLE = "player?.shown?.update.full && !player.waiting"
"""Of a published folder, whose play begins once everything may be there."""

QUIET = ("recommendation",)
"""Sources of log entries that are no complaint of the page's own."""

SHOWN = """
const [wanted, done] = arguments;
(async () => {
  const { player, show: { renderer } } = window.cags;
  player.rest(true);  // no further picture, so that this one is what is told
  while (player.drawing) await new Promise((resolve) => setTimeout(resolve, 20));
  const shown = player.shown, { update } = shown;
  const bytes = (coded) => Uint8Array.from(atob(coded), (letter) => letter.charCodeAt(0)).buffer;
  const text = (bytes) => { let s = ""; for (const b of bytes) s += String.fromCharCode(b); return btoa(s); };
  const floats = (array) => array && text(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
  let { options } = shown, positions = floats(update.changed?.positions), radii = floats(update.changed?.radii);
  if (wanted) {
    const reference = { ...wanted.reference, coded: new Float32Array(bytes(wanted.reference.coded)) };
    options = { ...options, reference, changed: new Uint32Array(bytes(wanted.boxes)), stale: wanted.stale };
    ({ positions, radii } = wanted);
    await renderer.draw(shown.camera, options);
  }
  const { reference } = options, { width, height, rgba } = await renderer.pixels();
  player.rest(false);
  return {
    frame: shown.frame, share: shown.share, camera: shown.camera, width, height, pixels: text(rgba),
    full: update.full, missed: update.missed, degree: options.maxShDegree, stale: options.stale ?? 0,
    positions: reference ? positions : null, radii: reference ? radii : null,
    kind: wanted ? null : shown.reference?.kind, idr: !wanted && shown.reference?.idr,
    unit: wanted || !shown.reference ? null : text(shown.reference.data),
    reference: reference && { ...reference, coded: floats(reference.coded) },
  };
})().then(done, (error) => done({ error: String(error.stack) }));
"""


def require_built() -> None:
    """Skip where the page is not built."""
    if cags_web.page_folder() is None:
        pytest.skip(f"the viewer is not built; {cags_web.HOW_TO_BUILD}")
    if not up_to_date():
        pytest.fail(f"the viewer is older than its sources; {cags_web.HOW_TO_BUILD}", pytrace=False)


def require_page() -> None:
    """Skip where the page is not built, or the driver that it draws with is not here."""
    require_built()
    if not ICD.exists():
        pytest.skip(f"no SwiftShader: {ICD} comes with Chromium (apt-get install chromium chromium-driver)")


def encoded(scene: str, out: Path) -> Path:
    """The bundle of a scene."""
    command = [sys.executable, "-m", "cags_encoder", scene, str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return out


@dataclass
class Server:
    """A server process; ``url`` is the page's."""

    group: ProcessGroup
    arguments: Sequence[str]
    port: int = 0
    process: Any = None

    def start(self) -> None:
        self.process = self.group.start("cags_server", [*self.arguments, "--port", str(self.port), "--json"])
        self.port = int(self.process.ready()["port"])

    def stop(self) -> None:
        self.process.stop()

    @property
    def url(self) -> str:
        return f"http://localhost:{self.port}/"


@contextmanager
def served(bundle: Path, folder: Path, *arguments: str) -> Iterator[Server]:
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessGroup(folder) as group:
        server = Server(group, ["--bundle", str(bundle), *arguments])
        server.start()
        yield server


@dataclass
class Page:
    """The page in a browser."""

    browser: Any

    def open(self, url: str, place: str = "") -> None:
        self.browser.get("about:blank")
        self.browser.get(f"{url}#size={SIZE[0]}x{SIZE[1]}&{place}")

    def ask(self, expression: str) -> Any:
        return self.browser.execute_script(f"const player = window.cags?.player; return {expression}")

    def do(self, script: str) -> None:
        self.browser.execute_script(f"const player = window.cags.player; {script}")

    def until(self, expression: str, seconds: float = WAIT_S) -> Any:
        """Wait until an expression over ``player`` holds; its value."""
        return self.until_true(lambda: self.ask(expression), expression, seconds)

    def until_true(self, condition: Callable[[], Any], what: str, seconds: float = WAIT_S) -> Any:
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            if value := condition():
                return value
            time.sleep(0.1)
        raise AssertionError(f"not within {seconds:g} s: {what}; the page says {self.words!r}, {self.complaints()}")

    @property
    def words(self) -> str:
        return str(self.browser.execute_script("return document.getElementById('message')?.innerText ?? ''"))

    def shown(self, wanted: dict[str, Any] | None = None) -> Shown:
        """What is on the canvas, with what it was made of; with ``wanted`` (reference, boxes, positions, radii, stale),
        once it is drawn anew so."""
        answer = self.browser.execute_async_script(SHOWN, wanted)
        assert "error" not in answer, answer["error"]
        return Shown(answer)

    def complaints(self) -> list[str]:
        entries = self.browser.get_log("browser")
        return [e["message"] for e in entries if e["level"] in ("SEVERE", "WARNING") and e["source"] not in QUIET]


@dataclass
class Shown:
    """A picture of the page."""

    values: dict[str, Any]

    @property
    def frame(self) -> int:
        return int(self.values["frame"])

    @property
    def pixels(self) -> NDArray[np.uint8]:
        height, width = self.values["height"], self.values["width"]
        return np.frombuffer(base64.b64decode(self.values["pixels"]), np.uint8).reshape(height, width, 4)


def drawn_by_python(shown: Sequence[Shown], bundle: Path, planes: bool = True) -> list[NDArray[np.uint8]]:
    """The same pictures by the ``gpu`` backend on SwiftShader, of the bundle at its highest level. References are those
    of the page; where the browser hands out ``planes``, they must be FFmpeg's to the bit."""
    environment = {**os.environ, "VK_ICD_FILENAMES": str(ICD), "CAGS_GPU_SOFTWARE": "1"}
    pictures = [{k: v for k, v in one.values.items() if k != "pixels"} | {"planes": planes} for one in shown]
    command = [sys.executable, str(Path(__file__).with_name("web_page_drawn.py"))]
    job = json.dumps({"bundle": str(bundle), "pictures": pictures}).encode()
    done = subprocess.run(command, input=job, env=environment, capture_output=True, timeout=480, check=False)
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    return [one.reshape(shown[0].pixels.shape) for one in np.split(np.frombuffer(done.stdout, np.uint8), len(shown))]


def same_as_python(viewer: Page, bundle: Path, planes: bool = True) -> None:
    """What the page shows is what Python draws, byte for byte; ``planes`` as for :func:`drawn_by_python`."""
    shown = viewer.shown()
    assert shown.values["full"] and not shown.values["missed"]
    assert shown.pixels[..., :3].any(), "there is a picture"
    np.testing.assert_array_equal(shown.pixels, drawn_by_python([shown], bundle, planes)[0])


@contextmanager
def page(profile: Path, **options: Any) -> Iterator[Page]:
    """A page in a fresh browser."""
    require_page()
    with chromium(profile, width=900, height=700, webgpu=True, **options) as browser:
        browser.set_script_timeout(120)
        yield Page(browser)
