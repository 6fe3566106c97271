"""Firefox ESR, whose WebGPU is behind a preference on Linux: what it says without, and what it shows with it."""

from __future__ import annotations

import base64
import time
from pathlib import Path

import numpy as np
import pytest

from cags_common.video.h264 import H264Decoder
from support.firefox import WEBGPU, firefox
from support.live_page import BallShow
from support.web_page import ICD, STILL, WHOLE, Page, encoded, require_built, require_page, same_as_python, served

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

SCENE = "procedural:size=800,frames=2,seed=1,fps=5,degree=1"
ROOM = "procedural:size=800,frames=20,seed=1,fps=5,degree=1"
SMALL = ("--reference-width", "64", "--reference-height", "48", "--visible-px", "0")


def test_as_it_comes_it_says_in_one_sentence_what_is_missing(tmp_path: Path) -> None:
    require_built()
    bundle = encoded(SCENE, tmp_path / "clip.cags")
    with served(bundle, tmp_path, *SMALL) as server, firefox(tmp_path / "profile") as browser:
        page = Page(browser)
        page.open(server.url)
        page.until_true(lambda: "cannot show the scene" in page.words, "a word on the page", 60)
        assert "This browser has no WebGPU. Chrome or Edge 113" in page.words
        buttons = (
            "[...document.querySelectorAll('#message button, #message a')].filter((b) => b.checkVisibility()).length"
        )
        assert page.ask(buttons) == 0, "there is nothing to try again"
        assert page.complaints() == []


def test_with_webgpu_its_pictures_are_pythons(tmp_path: Path) -> None:
    require_page()
    bundle = encoded(SCENE, tmp_path / "clip.cags")
    with (
        served(bundle, tmp_path, *SMALL) as server,
        firefox(tmp_path / "profile", WEBGPU, VK_ICD_FILENAMES=str(ICD)) as browser,
    ):
        page = Page(browser)
        page.open(server.url, "paused")
        page.until(WHOLE)
        same_as_python(page, bundle)
        page.do("player.seek(1); window.cags.camera.turn(0.3, 0.1)")
        page.until(f"player.shown?.frame === 1 && {WHOLE}")
        same_as_python(page, bundle)


RECORD = """
if (typeof VideoDecoder !== "undefined") {
  const decode = VideoDecoder.prototype.decode, units = (window.units = []);
  VideoDecoder.prototype.decode = function (chunk) {
    const bytes = new Uint8Array(chunk.byteLength);
    chunk.copyTo(bytes);
    units.push(btoa(String.fromCharCode(...bytes)));
    return decode.call(this, chunk);
  };
}
"""
OTHER_CHROMA = 0.01
"""Mean difference that is allowed, of 1: Firefox makes RGB of 4:2:0 itself, doubles chroma in its own way, and rounds
to bytes. Another matrix, or another range of luma, would be several times as far off."""


def test_references_are_decoded_by_its_webcodecs(tmp_path: Path) -> None:
    require_page()
    bundle = encoded(ROOM, tmp_path / "room.cags")
    with (
        served(bundle, tmp_path, *SMALL[:4], "--references", "picture") as server,
        firefox(tmp_path / "profile", WEBGPU, VK_ICD_FILENAMES=str(ICD)) as browser,
    ):
        browser.before_each_page(RECORD)
        page = Page(browser)
        page.open(server.url, "paused")
        page.until(WHOLE)
        if not page.ask("player.status.references"):
            pytest.skip("this Firefox decodes no H.264, so its page asks for none: apt-get install libavcodec-extra")
        page.until(f"{STILL} && player.shown.options.reference")
        same_as_python(page, bundle, planes=False)
        shown = page.shown()
        units = page.ask("window.units")
        decoder = H264Decoder()
        for unit in units[: units.index(shown.values["unit"]) + 1]:
            expected = decoder.decode(base64.b64decode(unit))
        assert expected is not None
        coded = np.frombuffer(base64.b64decode(shown.values["reference"]["coded"]), np.float32)
        assert np.abs(coded.reshape(expected.shape) - expected).mean() < OTHER_CHROMA
        assert page.ask("player.videoErrors") == 0 and page.complaints() == []


async def test_a_page_with_a_client_behind_it_needs_none(tmp_path: Path) -> None:
    import asyncio

    require_built()
    async with BallShow() as show:
        await asyncio.to_thread(watch, show.view.url, tmp_path)


def watch(url: str, folder: Path) -> None:
    for name in ("", "?h264", "?jpeg"):
        with firefox(folder / f"profile{name[1:]}") as browser:
            page = Page(browser)
            browser.get(url + name)
            page.until("player?.pictures > 5", 60)
            lit = """(() => {
              const canvas = document.getElementById("picture"), { width, height } = canvas;
              const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
              return new Set(new Uint32Array(data.buffer)).size;
            })()"""
            assert page.ask(lit) > 500, "a picture of many colours"
            before = page.ask("player.pictures")
            page.do("player.pause()")
            page.until("!player.playing")
            page.do("window.cags.camera.turn(0.4, 0)")
            page.until(f"player.photonMs.length > 0 && player.pictures > {before}", 60)
            assert page.complaints() == []
        time.sleep(0.2)
