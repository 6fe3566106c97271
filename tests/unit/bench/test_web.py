"""The experiment on the page in a browser, without one: settings, what a play comes to, the plain web host."""

from __future__ import annotations

import urllib.request
from pathlib import Path

import numpy as np
import pytest

from cags_bench.web import hosts
from cags_bench.web.experiment import COMPARED, Truth, beside, figures
from cags_bench.web.settings import WebBenchSettings
from cags_bench.web.watch import Picture, Watched
from cags_common.errors import CagsError, ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_encoder.scenes import open_scene

CAMERA = Camera(Intrinsics(32, 24, 24.0, 24.0, 16.0, 12.0), Pose((0.0, 0.0, -3.0), (1.0, 0.0, 0.0, 0.0)), 0.1)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth(open_scene("procedural:size=500,frames=3,fps=5"))


def test_what_cannot_be_played_is_refused_before_anything_is_started() -> None:
    with pytest.raises(ConfigError, match="sources: 'cdn' is unknown; known: published, server"):
        WebBenchSettings(sources="published,cdn")
    with pytest.raises(CagsError):
        WebBenchSettings(links="generated:nothing-like-it")


def test_a_play_comes_to_when_things_came_and_how_good_they_were(truth: Truth) -> None:
    blank = Picture(0, CAMERA, np.zeros((24, 32, 3), np.uint8))
    right = Picture(1, CAMERA, truth.drawn(Picture(1, CAMERA, blank.pixels)))
    assert right.pixels.any()
    shown = [
        {"frame": frame, "share": share, "lod": lod, "gpuMs": 40.0}
        for frame, share, lod in ((0, 0, None), (0, 0, 1.0), (0, 0.5, 1.5), (1, 0, 2.0))
    ]
    at = {"join": 500.0, "whole": 900.0, "picture": 1200.0}
    out = figures(Watched(at, shown, 2, 750.0, 0, {"bytesTiles": 10}, [], [blank, right]), truth)
    assert (out["asked_s"], out["data_s"], out["first_picture_s"]) == (0.5, pytest.approx(0.4), 1.2)
    assert (out["pictures"], out["frames_displayed"], out["stalls"], out["stalled_ms"]) == (4, 3, 2, 750.0)
    assert (out["lod_first"], out["lod_last"], out["bytes_tiles"]) == (1.0, 2.0, 10)
    assert out["psnr_worst_db"] == truth.psnr(blank) < 40 < truth.psnr(right)


def test_a_play_that_never_showed_anything_has_no_figures_and_its_reason(truth: Truth) -> None:
    out = figures(Watched({"join": 1.0}, [], 0, 0.0, 0, {}, ["no picture within 1 s"], []), truth)
    assert out["pictures"] == 0 and out["complaints"] == ["no picture within 1 s"]
    assert all(np.isnan(out[name]) for name in ("first_picture_s", "psnr_db", "lod_first", "drawing_ms"))


def test_both_sources_of_a_link_stand_beside_each_other() -> None:
    def play(source: str, link: str, psnr_db: float) -> dict[str, object]:
        counted = dict.fromkeys(("bytes_tiles", "bytes_reference", "bytes_other"), 5)
        return {**dict.fromkeys(COMPARED, 1.0), **counted, "source": source, "link": link, "psnr_db": psnr_db}

    (line,) = beside([play("published", "a", 30.0), play("published", "b", 31.0), play("server", "b", 33.0)])
    assert (line["case"], line["link"], line["psnr_gain_of_server_db"]) == ("beside", "b", 2.0)
    assert line["psnr_db"] == {"published": 31.0, "server": 33.0} and line["bytes"]["server"] == 15


def test_a_plain_host_answers_ranges(tmp_path: Path) -> None:
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "gof.bin").write_bytes(bytes(range(200)))
    try:
        with hosts.nginx(folder, tmp_path / "nginx") as port:
            request = urllib.request.Request(f"http://127.0.0.1:{port}/gof.bin", headers={"Range": "bytes=10-19"})
            with urllib.request.urlopen(request, timeout=10) as answer:
                assert (answer.status, answer.read()) == (206, bytes(range(10, 20)))
    except ConfigError as error:
        pytest.skip(str(error))
