"""``cags-bench stream``: bundles as well as scenes, several seeds, two settings compared, and what is written."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from cags_bench import stream_report
from cags_bench.bundles import cached_bundle
from cags_bench.cli import main
from cags_bench.confidence import Interval, interval
from cags_bench.film import metrics
from cags_bench.jsonl import dump
from cags_bench.sim.bundle import SOURCE, TOP_LEVEL
from cags_bench.stream import experiment
from cags_bench.stream import play as module
from cags_bench.stream.experiment import stream_lines, verdict_of
from cags_bench.stream.figures import FIGURES
from cags_bench.stream.play import Play
from cags_bench.stream.settings import StreamSettings
from cags_bench.stream.tables import print_plays
from cags_client.settings import ClientSettings
from cags_common.errors import CagsError, ConfigError
from cags_encoder import EncodeSettings
from cags_encoder.bundles.publish import publish
from cags_shaper.trace import Trace

FRAMES = 14
FIGURE = {figure.key: figure for figure in FIGURES}


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles")
    settings = EncodeSettings(frames=FRAMES, train_splats=1000, lod_order="paper")
    return cached_bundle(f"procedural:size=600,frames={FRAMES}", str(folder), settings)


@pytest.fixture
def settings(bundle: Path) -> StreamSettings:
    client = ClientSettings(width=96, height=72)
    return StreamSettings(scene=str(bundle), trace="generated:steady-1", client=client, video_metrics="none")


def only(settings: StreamSettings) -> dict:
    [line] = stream_lines(settings)
    return line


# ------------------------------------------------------------------------------------------------------------ bundles


def test_a_ready_bundle_is_played_whole_and_compared_with_its_source(settings: StreamSettings) -> None:
    line = only(settings)
    assert line["summary"] and line["benchmark"] == "stream"
    assert (line["frames"], line["truth"]) == (FRAMES, SOURCE)
    assert line["psnr_restored_db"] > 20
    assert only(replace(settings, frames=5))["frames"] == 5


def test_a_published_folder_is_compared_with_its_top_level(
    settings: StreamSettings, bundle: Path, tmp_path: Path
) -> None:
    publish(str(bundle), tmp_path / "www", None)
    line = only(replace(settings, scene=str(tmp_path / "www"), trace="generated:steady-60"))
    assert (line["frames"], line["truth"]) == (FRAMES, TOP_LEVEL)
    assert line["psnr_distorted_db"] > only(replace(settings, trace="generated:steady-60"))["psnr_distorted_db"] + 3
    said = io.StringIO()
    print_plays([line], said)
    assert "picture, compared with the bundle's top level" in said.getvalue()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": FRAMES + 1}, f"frames = {FRAMES + 1}: .* has {FRAMES}; give fewer"),
        ({"quantiser": "paper-66"}, "quantiser = 'paper-66': .* is encoded already; leave it out"),
    ],
)
def test_what_a_bundle_cannot_give_is_refused(settings: StreamSettings, changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        only(replace(settings, **changes))


def test_a_share_of_the_trace_is_played(settings: StreamSettings) -> None:
    whole = only(replace(settings, trace="generated:steady-20"))
    share = only(replace(settings, trace="generated:steady-20", share=0.05))
    assert share["capacity_mbps"] == pytest.approx(whole["capacity_mbps"] / 20, rel=0.1)
    assert share["first_frame_ms"] > whole["first_frame_ms"]


def test_a_slow_client_drops_frames_and_is_told(settings: StreamSettings) -> None:
    line = only(replace(settings, draw_ms=80.0))
    assert line["frames"] < FRAMES
    assert line["frames"] + line["frames_dropped"] == FRAMES
    assert line["latency_p95_ms"] >= 80
    assert line["even_share"] < 0.5


# ------------------------------------------------------------------------------------------------- seeds, comparisons


def test_seeds_are_other_plays_and_the_first_is_the_one_that_is_named(settings: StreamSettings) -> None:
    *plays, last = stream_lines(replace(settings, seeds=2))
    alone = only(settings)
    assert [play["seed"] for play in plays] == [0, 1]
    assert plays[0]["psnr_restored_db"] == alone["psnr_restored_db"] != plays[1]["psnr_restored_db"]
    assert last["summary"] and not plays[0]["summary"]
    mean = sum(play["psnr_restored_db"] for play in plays) / 2
    assert last["figures"]["psnr_restored_db"]["mean"] == pytest.approx(mean)


def test_a_comparison_pairs_both_states_seed_by_seed(settings: StreamSettings) -> None:
    *plays, last = stream_lines(replace(settings, compare="restore=none,correct", seeds=2))
    assert [(play["case"], play["seed"]) for play in plays] == [
        ("none", 0), ("correct", 0), ("none", 1), ("correct", 1)
    ]  # fmt: skip
    assert last["compare"] == {"name": "restore", "values": ["none", "correct"], "seeds": 2}
    by_seed = [[play["psnr_restored_db"] for play in plays if play["seed"] == seed] for seed in range(2)]
    expected = interval([after - before for before, after in by_seed])
    found = last["figures"]["psnr_restored_db"]
    assert found["difference"]["mean"] == pytest.approx(expected.mean)
    assert found["difference"]["low"] == pytest.approx(expected.low)
    assert last["figures"]["bytes_reference"]["means"]["none"] == 0
    assert {one["name"] for one in last["checks"]} >= {"PSNR [dB]: correct is not worse than none"}
    assert json.loads(dump(last))["summary"] is True


def test_a_state_compared_with_its_equal_shows_no_difference(settings: StreamSettings) -> None:
    """Both spellings of one number: every figure is equal, and the words say so."""
    *_, last = stream_lines(replace(settings, compare="delay_ms=20,20.0", seeds=2))
    assert {found["verdict"] for found in last["figures"].values()} == {experiment.NO_DIFFERENCE}
    assert all(one["ok"] for one in last["checks"])


def test_one_seed_meets_no_target(settings: StreamSettings) -> None:
    """Every check used to be met, because a single play never shows that anything is worse."""
    *_, last = stream_lines(replace(settings, compare="restore=none,correct", seeds=1))
    assert {found["verdict"] for found in last["figures"].values()} == {experiment.UNSURE}
    assert last["checks"] and not any(one["ok"] for one in last["checks"])


@pytest.mark.parametrize("text", ["abr", "abr=", "abr=paper", "abr=paper,", "abr=paper,paper", "abr=a,b,c"])
def test_a_comparison_needs_two_values(settings: StreamSettings, text: str) -> None:
    with pytest.raises(ConfigError, match=r"compare = .* must be NAME=A,B with two values, like abr=paper,utility"):
        next(stream_lines(replace(settings, compare=text)))


def test_both_values_are_checked_before_the_first_play(
    settings: StreamSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Play, "line", lambda self: pytest.fail("it was played"))
    with pytest.raises(ConfigError, match="abr = 'greedy' is unknown"):
        next(stream_lines(replace(settings, compare="abr=utility,greedy")))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"compare": "raster=cpu,foo"}, "rasteriser 'foo' is unknown"),
        ({"compare": "quantiser=,magic", "scene": "procedural"}, "must be NAME=A,B"),
        ({"compare": "quantiser=paper-66,magic", "scene": "procedural"}, "magic"),
        ({"strip": 0, "out": "new", "frames": 10}, "strip = 0: 12 frames from there are not in the film; play more"),
        ({"strip": 3, "out": "new"}, "strip = 3: 12 frames from there are not in the film; give 0 to 2"),
        ({"strip": 0, "out": "new", "scene": "procedural:frames=10"}, "strip = 0: 12 frames from there"),
        ({"out": "taken.mp4"}, r"taken\.mp4: cannot be written"),
        ({"out": "half", "seeds": 2}, r"half/seed1: cannot be written"),
        ({"record": "nodir/x.mp4"}, r"record = 'nodir/x\.mp4': there is no folder nodir; name a file in an existing"),
        ({"record": "folder.mp4"}, r"record = 'folder\.mp4': folder\.mp4 is a folder"),
        ({"lpips": "weights.npz", "client": ClientSettings(width=96, height=20)}, "pictures of 96x20 are too small"),
    ],
)
def test_what_cannot_be_played_or_written_is_refused_before_the_first_play(
    settings: StreamSettings, changes: dict, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Play, "line", lambda self: pytest.fail("it was played"))
    monkeypatch.setattr(module, "Lpips", lambda path: None)
    (tmp_path / "taken.mp4").write_text("a film")
    (tmp_path / "folder.mp4").mkdir()
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "seed1").write_text("no folder")
    with pytest.raises(CagsError, match=message):
        next(stream_lines(replace(settings, **changes)))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("scene", "asked", "frames"), [("frames=10", 0, 10), ("frames=90", 0, 60), ("frames=10", 25, 25)]
)
def test_a_scene_is_played_once_unless_more_is_asked_for(
    settings: StreamSettings, monkeypatch: pytest.MonkeyPatch, scene: str, asked: int, frames: int
) -> None:
    encoded: list[int | None] = []
    monkeypatch.setattr(module, "cached_bundle", lambda spec, cache, encode: encoded.append(encode.frames) or Path())
    Play(replace(settings, scene=f"procedural:size=500,{scene}", frames=asked)).scenario()
    assert encoded == [frames]


@pytest.mark.parametrize(
    ("key", "low", "high", "words"),
    [
        ("psnr_restored_db", 0.1, 0.5, "better"),
        ("psnr_restored_db", -0.5, -0.1, "worse"),
        ("flicker_restored", 0.1, 0.5, "worse"),
        ("flicker_restored", -0.5, -0.1, "better"),
        ("bytes_tiles", 10.0, 20.0, "more"),
        ("bytes_tiles", -20.0, -10.0, "less"),
        ("psnr_restored_db", -0.1, 0.5, experiment.NO_DIFFERENCE),
        ("psnr_restored_db", float("-inf"), float("inf"), experiment.UNSURE),
    ],
)
def test_a_difference_in_words(key: str, low: float, high: float, words: str) -> None:
    assert verdict_of(FIGURE[key], Interval((low + high) / 2, low, high)) == words


def test_a_play_that_lacks_a_figure_takes_it_out_of_the_comparison(
    settings: StreamSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def played(self: Play) -> dict:
        steps = {} if self.seed == 1 else {"psnr_restored_step_p95_db": 1.0}
        return {"frames": 3, "psnr_restored_db": 30.0 + self.seed, **steps, "settings": {}}

    monkeypatch.setattr(Play, "line", played)
    *_, last = stream_lines(replace(settings, compare="abr=paper,utility", seeds=2))
    assert set(last["figures"]) == {"frames", "psnr_restored_db"}


# ----------------------------------------------------------------------------------------------- what people read


def test_people_get_a_row_a_play_and_a_line_a_difference(settings: StreamSettings) -> None:
    lines = list(stream_lines(replace(settings, compare="references=none,auto", seeds=3)))
    said = io.StringIO()
    print_plays(iter(lines), said)
    text = said.getvalue()
    for play in lines[:-1]:
        [row] = [
            r
            for r in text.splitlines()
            if r.lstrip().startswith(f"{play['case']}, seed {play['seed']}") and f"{play['psnr_restored_db']:.2f}" in r
        ]
        assert f"{play['flicker_restored']:.2f}" in row
    assert "auto minus none: mean over 3 seeds" in text
    assert any("references [MB]" in row and "more" in row for row in text.splitlines())
    assert max(len(row) for row in text.splitlines()) <= 130


def test_people_are_told_which_extra_gives_a_missing_figure(
    settings: StreamSettings, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(metrics.ffmpeg, "program", lambda: None)
    monkeypatch.setattr(metrics.ffmpeg, "filters", frozenset)
    assert main(["stream", "--scene", settings.scene, "--width", "96", "--height", "72", "--frames", "4"]) == 0
    said = capsys.readouterr().out
    assert "vmaf, xpsnr not measured: pip install 'cags-stream[video-metrics]'" in said
    assert "VMAF" not in said


def test_the_command_names_what_is_unknown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stream", "--compare", "speed=1,2"]) == 2
    assert capsys.readouterr().err.startswith("cags-bench: compare: 'speed' is not a setting of a play; known: abr,")


# ----------------------------------------------------------------------------------------------- what is written


def recorded(path: Path) -> Iterator[object]:
    with av.open(str(path)) as container:
        yield from container.decode(video=0)


def test_the_film_has_every_frame_though_some_were_dropped(settings: StreamSettings, tmp_path: Path) -> None:
    line = only(replace(settings, record=str(tmp_path / "film.mp4"), draw_ms=80.0))
    assert line["frames"] < FRAMES
    assert len(list(recorded(tmp_path / "film.mp4"))) == FRAMES


def test_a_report_has_a_strip_of_twelve_frames_and_a_film_beside_the_truth(
    settings: StreamSettings, tmp_path: Path
) -> None:
    out, film = tmp_path / "report", tmp_path / "film.mp4"
    only(replace(settings, out=str(out), strip=1, record=str(film), record_truth=True))
    assert {"frames.jsonl", "timeline.png", "strip.png", "film-strip.png"} <= {p.name for p in out.iterdir()}
    assert cv2.imread(str(out / "film-strip.png")).shape[1] == 12 * 96
    frames = list(recorded(film))
    assert len(frames) == FRAMES
    assert (frames[0].width, frames[0].height) == (192, 72)


def test_the_plot_shows_the_link_from_the_connection_on(
    settings: StreamSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It began with the trace at the first frame, so that what the link did was drawn too late."""
    drawn: list[tuple[float, Trace]] = []
    plot = lambda frames, path, *, waited_s, link: drawn.append((waited_s, link))  # noqa: E731
    monkeypatch.setattr(stream_report, "plot_stream", plot)
    played = replace(settings, trace="generated:lte-driving", out=str(tmp_path / "report"))
    line = only(played)
    [(waited_s, link)] = drawn
    assert waited_s == pytest.approx(line["first_frame_ms"] / 1e3, abs=1e-3)
    assert waited_s > 0.2
    assert link.mean_bps(0, 300_000) == Play(played).scenario().link().mean_bps(0, 300_000)


def test_a_report_holds_no_pictures_of_an_earlier_play(settings: StreamSettings, tmp_path: Path) -> None:
    out = tmp_path / "report"
    only(replace(settings, out=str(out), strip=1))
    assert (out / "stages" / "frame_0000_restored.png").exists()
    later = replace(settings.client, start_frame=1)
    only(replace(settings, out=str(out), client=later))  # without frame 0, which is the only one with stages
    assert not list((out / "stages").iterdir())
    assert {path.name for path in out.iterdir()} == {"frames.jsonl", "timeline.png", "stages"}


def test_the_strip_names_the_size_of_the_reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles: list[str] = []

    def titled(title: str, image: np.ndarray) -> np.ndarray:
        titles.append(title)
        return image

    monkeypatch.setattr(stream_report, "_titled", titled)
    for stage, width in (("reference", 200), ("restored", 96)):
        cv2.imwrite(str(tmp_path / f"frame_0015_{stage}.png"), np.zeros((72, width, 3), np.uint8))
    assert stream_report.write_strip(tmp_path, 15, tmp_path / "strip.png")
    assert titles == ["reference (sent), 200x72", "restored (shown)"]


@pytest.mark.slow
def test_plays_of_a_comparison_are_written_apart(settings: StreamSettings, tmp_path: Path) -> None:
    out, film = tmp_path / "report", tmp_path / "film.mp4"
    whole = replace(settings, frames=4, compare="abr=paper,utility", seeds=2, out=str(out), record=str(film))
    list(stream_lines(whole))
    labels = {f"{state}-seed{seed}" for state in ("paper", "utility") for seed in range(2)}
    assert {path.name for path in out.iterdir()} == labels
    assert {path.name for path in tmp_path.glob("*.mp4")} == {f"film-{label}.mp4" for label in labels}
