"""A browser that decodes H.264 in 4:2:0 only: the server is told, and the picture is still Python's byte for byte."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest

from support.web_page import STILL, drawn_by_python, encoded, page, served

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOM = "procedural:size=800,frames=20,seed=1,fps=5,degree=1"
SMALL = ("--reference-width", "64", "--reference-height", "48", "--references", "picture")

HALF_CHROMA_ONLY = """
const [asked, configure] = [VideoDecoder.isConfigSupported, VideoDecoder.prototype.configure];
const full = ({ codec }) => /^avc1[.]F4/i.test(codec);
VideoDecoder.isConfigSupported = (config) =>
  full(config) ? Promise.resolve({ supported: false, config }) : asked.call(VideoDecoder, config);
VideoDecoder.prototype.configure = function (config) {
  if (full(config)) throw new DOMException("4:4:4 is not decoded here", "NotSupportedError");
  configure.call(this, config);
};
"""

HIGH_PROFILE = 100  # of 4:2:0; High 4:4:4 Predictive is 244


def _profile(unit: bytes) -> int:
    """Of an access unit's sequence parameter set."""
    at = next(i for i in range(len(unit)) if unit[i : i + 3] == b"\0\0\1" and unit[i + 3] & 31 == 7)
    return unit[at + 4]


def test_a_browser_without_full_chroma_gets_half_of_it_and_shows_pythons_picture(tmp_path: Path) -> None:
    bundle = encoded(ROOM, tmp_path / "room.cags")
    with served(bundle, tmp_path / "server", *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": HALF_CHROMA_ONLY})
        viewer.open(server.url, "paused")
        viewer.until(f"{STILL} && player.shown.reference?.idr")
        shown = viewer.shown()
        assert _profile(base64.b64decode(shown.values["unit"])) == HIGH_PROFILE
        assert shown.values["reference"] is not None and shown.pixels[..., :3].any()
        assert (shown.pixels == drawn_by_python([shown], bundle)[0]).all()
        assert viewer.ask("player.videoErrors") == 0 and viewer.complaints() == []
