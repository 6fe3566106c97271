"""The page in a headset, by WebXR: emulated by npm's ``iwer``, with the frusta of a headset that is sold."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.node import WEB
from support.web_page import WHOLE, Page, Shown, drawn_by_python, encoded, page, served

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

EMULATOR = WEB / "node_modules" / "iwer" / "build" / "iwer.min.js"
SCENE = "procedural:size=800,frames=2,seed=1,fps=5,degree=1"
SMALL = ("--reference-width", "64", "--reference-height", "48", "--visible-px", "0")

HEADSET = """
(() => {
  const device = (window.headset = new IWER.XRDevice(IWER.metaQuest3));
  device.installRuntime({ forceInstall: true });
  device.stereoEnabled = true;
  device.ipd = 0.064;
  // the emulator's frusta are symmetric; a Quest 3 sees farther outwards and downwards
  const wide = { left: [-1.376, 0.839, 0.966, -1.428], right: [-0.839, 1.376, 0.966, -1.428] };
  Object.defineProperty(XRView.prototype, "projectionMatrix", { get() {
    const [l, r, t, b] = wide[this.eye];
    const [x, y] = [2 / (r - l), 2 / (t - b)];
    return new Float32Array([x, 0, 0, 0, 0, y, 0, 0, (r + l) / (r - l), (t + b) / (t - b), -1, -1, 0, 0, -0.2, 0]);
  } });
})();
"""
TURN, PLACE = "0.1, 0.3, 0.05, 0.947365", "0.2, 1.5, -0.1"
"""Of the head, in the headset's space."""
SEES = "JSON.stringify(window.cags.show.immersive.viewpoint.pose)"
STANDS = """JSON.stringify(window.cags.show.immersive.layer.shown.map(({ camera }) => camera.pose)) ===
  JSON.stringify(window.cags.show.immersive.viewpoint.eyes.map(({ pose }) => pose))"""
"""What the eyes see was drawn from where they are."""
OUTER_TAN, LOWER_TAN = 1.376, 1.428
TOLD = f"""(() => {{
  const {{ position }} = window.cags.show.immersive.viewpoint.pose, {{ kind, camera }} = player.shown.reference ?? {{}};
  if (kind !== "nothing") return false;
  const {{ widthPx, fxPx, heightPx, fyPx }} = camera.intrinsics;
  const near = Math.hypot(...camera.pose.position.map((part, axis) => part - position[axis])) < 1e-3;
  return near && widthPx / fxPx > 2 * {OUTER_TAN} - 1e-6 && heightPx / fyPx > 2 * {LOWER_TAN} - 1e-6;
}})()"""
"""The server knows where the head is, and all that both eyes see: nothing is lacking there."""

EYES = """
const done = arguments[0];
const { show, player } = window.cags;
const { gl, shown } = show.immersive.layer;
const text = (bytes) => { let s = ""; for (const b of bytes) s += String.fromCharCode(b); return btoa(s); };
const { options } = player.shown;
const pictures = shown.map(({ texture, camera }) => {
  const { widthPx: width, heightPx: height } = camera.intrinsics;
  const held = gl.createFramebuffer(), pixels = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, held);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(held);
  const nothing = { stale: 0, positions: null, radii: null, kind: null, idr: false, unit: null, reference: null };
  const picture = { camera, width, height, pixels: text(pixels), degree: options.maxShDegree };
  return { frame: player.shown.frame, share: 0, ...picture, ...nothing };
});
const draw = gl.drawArrays.bind(gl);  // the last triangle of a refresh is the right eye's
let eyes = 0;
gl.drawArrays = (...triangle) => {
  draw(...triangle);
  if (++eyes < 2 || eyes % 2) return;
  gl.drawArrays = draw;
  const { drawingBufferWidth: width, drawingBufferHeight: height } = gl, pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  done({ pictures, width, height, pixels: text(pixels) });
};
"""


OF_SOFTWARE = "Automatic fallback to software WebGL", "GPU stall due to ReadPixels"
"""Of WebGL on a processor, and of this test that reads its pictures."""


def with_headset(viewer: Page) -> None:
    """Pages that are opened from now on find a headset."""
    if not EMULATOR.is_file():
        pytest.skip("npm's iwer is not here: run npm ci in web/")
    source = f"{EMULATOR.read_text(encoding='utf-8')};{HEADSET}"
    viewer.browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": source})


def press(viewer: Page, control: str) -> None:
    viewer.browser.find_element("id", control).click()


def seen_by_eyes(viewer: Page) -> dict[str, Any]:
    answer: dict[str, Any] = viewer.browser.execute_async_script(EYES)
    return answer


def pixels_of(values: dict[str, Any]) -> NDArray[np.uint8]:
    size = values["height"], values["width"], 4
    return np.frombuffer(base64.b64decode(values["pixels"]), np.uint8).reshape(size)


def test_both_eyes_see_the_scene_and_the_server_learns_of_the_head(tmp_path: Path) -> None:
    bundle = encoded(SCENE, tmp_path / "clip.cags")
    with served(bundle, tmp_path, *SMALL) as server, page(tmp_path / "profile") as viewer:
        with_headset(viewer)
        viewer.browser.set_window_size(480, 420)  # of which each eye has a half
        viewer.open(server.url, "paused")
        viewer.until(WHOLE)
        before = viewer.ask("({ pose: window.cags.camera.pose, camera: JSON.stringify(player.shown.camera) })")
        press(viewer, "vr")
        viewer.until("window.cags.show.immersive?.layer.shown.length === 2 && player.status.link === 'open'")
        viewer.until_true(lambda: "In virtual reality" in viewer.words, "a word on the page")
        entered = viewer.ask("window.cags.show.immersive.viewpoint.pose")
        np.testing.assert_allclose(entered["position"], before["pose"]["position"], atol=1e-6)
        viewer.browser.execute_script(f"headset.quaternion.set({TURN}); headset.position.set({PLACE})")
        viewer.until(f"{WHOLE} && {STANDS} && {SEES} !== '{json.dumps(entered)}'")
        viewer.until(TOLD)
        eyes = viewer.browser.execute_async_script(EYES)
        viewpoint = viewer.ask("window.cags.show.immersive.viewpoint")
        viewer.do("window.cags.show.immerse()")
        viewer.until(f"!cags.show.immersed && {WHOLE} && JSON.stringify(player.shown.camera) === '{before['camera']}'")
        assert [word for word in viewer.complaints() if not any(known in word for known in OF_SOFTWARE)] == []
    check_pictures(eyes, bundle)
    check_viewpoint(viewpoint)


def check_pictures(eyes: dict[str, Any], bundle: Path) -> None:
    """Each eye's picture is the renderer's for its camera, and the headset is given it where it was drawn."""
    shown = [Shown(picture) for picture in eyes["pictures"]]
    given = pixels_of(eyes)[::-1]  # WebGL counts rows from below
    halves = given[:, : given.shape[1] // 2], given[:, given.shape[1] // 2 :]
    drawn = drawn_by_python(shown, bundle)
    assert not np.array_equal(*drawn), "the eyes see two pictures"
    for one, right, half in zip(shown, drawn, halves, strict=True):
        np.testing.assert_array_equal(one.pixels[..., :3], right[..., :3])
        assert one.pixels[..., :3].any()
        assert np.abs(half[..., :3].astype(int) - right[..., :3]).max() <= 1


def check_viewpoint(viewpoint: dict[str, Any]) -> None:
    """What the server is told: the middle of the eyes, and angles that hold those of both."""
    left, right = (np.asarray(eye["pose"]["position"]) for eye in viewpoint["eyes"])
    np.testing.assert_allclose(viewpoint["pose"]["position"], (left + right) / 2, atol=1e-9)
    assert np.linalg.norm(left - right) == pytest.approx(0.064, abs=1e-4)
    i = viewpoint["intrinsics"]
    assert i["widthPx"] / 2 / i["fxPx"] == pytest.approx(OUTER_TAN, abs=1e-3)
    assert i["heightPx"] / 2 / i["fyPx"] == pytest.approx(LOWER_TAN, abs=1e-3)
