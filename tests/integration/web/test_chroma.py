"""A browser that decodes H.264 in 4:2:0 only: the server is told, and the picture is still Python's byte for byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.web_page import STILL, drawn_by_python, encoded, page, served

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOM = "procedural:size=800,frames=20,seed=1,fps=5,degree=1"
SMALL = ("--reference-width", "64", "--reference-height", "48", "--references", "picture")

HALF_CHROMA_ONLY = """
if (typeof VideoDecoder !== "undefined") {  // not on the blank page before
  const [asked, configure] = [VideoDecoder.isConfigSupported, VideoDecoder.prototype.configure];
  const full = ({ codec }) => /^avc1[.]F4/i.test(codec);
  VideoDecoder.isConfigSupported = (config) =>
    full(config) ? Promise.resolve({ supported: false, config }) : asked.call(VideoDecoder, config);
  VideoDecoder.prototype.configure = function (config) {
    if (full(config)) throw new DOMException("4:4:4 is not decoded here", "NotSupportedError");
    (window.decoded ??= []).push(config.codec);
    configure.call(this, config);
  };
}
"""

HIGH = "avc1.64"
"""Profile of 4:2:0; High 4:4:4 Predictive is F4."""


def test_a_browser_without_full_chroma_gets_half_of_it_and_shows_pythons_picture(tmp_path: Path) -> None:
    bundle = encoded(ROOM, tmp_path / "room.cags")
    with served(bundle, tmp_path / "server", *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": HALF_CHROMA_ONLY})
        viewer.open(server.url, "paused")
        viewer.until(f"{STILL} && player.shown.options.reference")
        shown = viewer.shown()
        assert all(codec.startswith(HIGH) for codec in viewer.ask("window.decoded"))
        assert shown.values["reference"] is not None and shown.pixels[..., :3].any()
        assert (shown.pixels == drawn_by_python([shown], bundle)[0]).all()
        assert viewer.ask("player.videoErrors") == 0 and viewer.complaints() == []
