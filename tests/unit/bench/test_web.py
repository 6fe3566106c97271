"""The experiment on the page in a browser, without one: settings, what a play comes to, the plain web host."""

from __future__ import annotations

import gzip
import itertools
import math
import zlib
from pathlib import Path

import numpy as np
import pytest

from cags_bench.jsonl import JsonObject
from cags_bench.web import hosts
from cags_bench.web.browser import BrowserError, programs
from cags_bench.web.cost import SPLATS, Swarm, answer, cost
from cags_bench.web.experiment import COMPARED, Truth, beside, checks, figures, hosted, least_mbps, needed_mbps
from cags_bench.web.settings import WebBenchSettings
from cags_bench.web.watch import Picture, Watched
from cags_common.bundle import BundleReader
from cags_common.errors import CagsError, ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_encoder import EncodeSettings, encode
from cags_encoder.bundles.publish import built_page
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
        {"frame": frame, "share": share, "lod": lod, "full": lod == 2.0, "gpuMs": 40.0}
        for frame, share, lod in ((0, 0, None), (0, 0, 1.0), (0, 0.5, 1.5), (1, 0, 2.0))
    ]
    at = {"join": 500.0, "device": 600.0, "whole": 900.0, "picture": 1200.0}
    out = figures(Watched(at, shown, 2, 750.0, 0, 1.5, {"bytesTiles": 10}, [], [blank, right]), truth)
    assert (out["asked_s"], out["first_picture_s"], out["seek_s"]) == (0.5, 1.2, 1.5)
    assert [out[name] for name in ("data_s", "device_s", "picture_s")] == pytest.approx([0.4, 0.1, 0.7])
    assert out["full_share"] == 0.25
    assert out.keys() >= {*COMPARED} - {"bytes"}, "what stands beside each other is measured"
    assert (out["pictures"], out["frames_displayed"], out["stalls"], out["stalled_ms"]) == (4, 3, 2, 750.0)
    assert (out["lod_first"], out["lod_last"], out["bytes_tiles"]) == (1.0, 2.0, 10)
    assert out["psnr_worst_db"] == truth.psnr(blank) < 40 < truth.psnr(right)


def test_a_play_that_never_showed_anything_has_no_figures_and_its_reason(truth: Truth) -> None:
    out = figures(Watched({"join": 1.0}, [], 0, 0.0, 0, math.nan, {}, ["no picture within 1 s"], []), truth)
    assert out["pictures"] == 0 and out["complaints"] == ["no picture within 1 s"]
    assert all(np.isnan(out[name]) for name in ("first_picture_s", "psnr_db", "lod_first", "full_share"))


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
    tiles = bytes(range(200))
    (folder / f"gof-{zlib.crc32(tiles):08x}-c8.bin").write_bytes(tiles)
    (folder / "index.html").write_text("<html></html>")
    (folder / "worker.js").write_text("1;" * 500)
    (folder / "worker.js.gz").write_bytes(gzip.compress(b"1;" * 500))
    (folder / "gallery.html").write_text("not of the page")
    try:
        with hosts.nginx(folder, tmp_path / "nginx") as port:
            line = hosted(folder, port)
    except ConfigError as error:
        pytest.skip(str(error))
    assert [line[f"tile_files{of}"] for of in ("", "_by_ranges", "_named_by_content")] == [1, 1, 1]
    assert (line["page_files"], line["page_files_revalidated"]) == (2, 2)
    assert 13 < line["page_bytes"] < 100 and line["page_bytes_of_a_second_visit"] == 0


def play_line(**of: object) -> JsonObject:
    line: JsonObject = {
        **dict.fromkeys(("asked_s", "data_s", "picture_s", "full_share", "seek_s"), 0.5),
        **{"case": "play", "source": "published", "link": "generated:steady-10", "page_bytes": 1_000},
        **{"frames_displayed": 9, "frames_missed": 0, "stalls": 0, "complaints": []},
        **{"needed_mbps": 1.0, "least_mbps": 10.0},
    }
    return {**line, **of}


HOST: JsonObject = {"case": "host", "tile_files": 2, "tile_files_by_ranges": 2, "tile_files_named_by_content": 2}
PAGE = {"page_files": 7, "page_files_revalidated": 7}
COST: list[JsonObject] = [
    {"case": "cost", "frames": kind, "moved_rows": 60_000, "cpu_ms": 3.9} for kind in ("media", "between")
]
SLOW, FAST = "generated:steady-2", "generated:steady-20"


def failed(*lines: JsonObject) -> list[str]:
    return [one["name"] for one in checks(lines) if not one["ok"]]


def test_every_target_is_a_check_that_can_fail() -> None:
    good = [*COST, {**HOST, **PAGE}, play_line()]
    assert len(checks(good)) == 13 and not failed(*good)
    bad = [
        *({**line, "moved_rows": 59_999, "cpu_ms": 4.1} for line in COST),
        {**HOST, **PAGE, "tile_files_by_ranges": 1, "tile_files_named_by_content": 1, "page_files_revalidated": 6},
        play_line(
            page_bytes=1_500_001,
            frames_displayed=1,
            stalls=1,
            seek_s=math.nan,
            data_s=1.1,
            picture_s=math.nan,
            complaints=["no"],
        ),
    ]
    assert len(failed(*bad)) == 13


@pytest.mark.parametrize(
    ("source", "short", "words"),
    [("published", "stalls", "waits for data"), ("server", "frames_missed", "frames shown without their data")],
)
def test_only_links_that_suffice_must_carry_everything(source: str, short: str, words: str) -> None:
    suffices = play_line(source=source, **{short: 1})
    assert failed(suffices) == [f"{words} on a link that suffices, {source}, generated:steady-10"]
    assert not failed({**suffices, "needed_mbps": 5.1})
    assert not failed({**suffices, short: 0, ("stalls" if source == "server" else "frames_missed"): 1})


def test_what_a_clip_needs_and_what_a_link_carries(tmp_path: Path) -> None:
    scene, settings = open_scene("procedural:size=500,frames=6,fps=2"), EncodeSettings(motion="none", lod_order="paper")
    encode(scene, settings, str(tmp_path / "b"))
    with BundleReader.open(str(tmp_path / "b")) as reader:
        frames = [reader.frame(index) for index in range(1, 6)]
        sizes = [frame.removed_bytes + sum(tile.lod_bytes[0] for tile in frame.tiles) for frame in frames]
    most = max(first + second for first, second in itertools.pairwise(sizes))
    assert needed_mbps(tmp_path / "b") == pytest.approx(most * 8 / 1e6)
    assert 0 < most < sum(sizes)
    assert least_mbps("generated:steady-10", 12) == pytest.approx(10, rel=0.01)
    link = tmp_path / "link.csv"
    link.write_text("time_s,mbps\n0,10\n3,1\n6,1\n")
    assert least_mbps(str(link), 3) == pytest.approx(10, rel=0.05)
    assert least_mbps(str(link), 5) == pytest.approx(1, rel=0.05)


def test_a_faster_link_shows_no_less() -> None:
    slow, fast = play_line(link=SLOW, full_share=0.4), play_line(link=FAST, full_share=0.9)
    assert not failed(slow, fast)
    assert failed({**slow, "full_share": 0.95}, fast) == [
        "published adapts: share of pictures at full detail at 2 and at 20 Mbps"
    ]


def test_the_clip_of_the_cost_moves_every_splat_in_every_frame() -> None:
    swarm = Swarm(300, 4)
    frames = [swarm.frame(index) for index in range(len(swarm))]
    for before, after in itertools.pairwise(frames):
        assert (np.abs(after.means - before.means).max(axis=1) > 1e-3).all()
        assert (np.abs(after.quats - before.quats).max(axis=1) > 1e-3).all()
        np.testing.assert_array_equal(before.sh0, after.sh0)
    assert np.allclose(np.linalg.norm(frames[-1].quats, axis=1), 1, atol=1e-6)


def test_a_worker_that_complains_ends_the_measurement() -> None:
    with pytest.raises(BrowserError, match="no memory"):
        answer({"error": "no memory"})


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_workers_frames_are_timed_in_chromium(tmp_path: Path) -> None:
    page = built_page()
    try:
        programs()
    except ConfigError as error:
        pytest.skip(str(error))
    if page is None:
        pytest.skip("the viewer is not built")
    media, between = cost(tmp_path, page)
    for line in (media, between):
        assert line["moved_rows"] == SPLATS and line["upload_bytes_a_frame"] == 36 * SPLATS
        assert 0.3 < line["cpu_ms"] < 100 and line["cpu_p10_ms"] <= line["cpu_ms"] <= line["cpu_p90_ms"]
