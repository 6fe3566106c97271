"""VMAF, XPSNR and JOD: the best for equal films; flicker and freezes cost something; what is missing is told."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from cags_bench.film import ffmpeg, metrics
from cags_bench.film.film import Film, FilmMaker
from cags_bench.film.jod import available, jod
from cags_client.settings import ClientSettings
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera, Pose
from cags_common.metrics import MAX_PSNR_DB

WIDTH, HEIGHT, FRAMES = 160, 120, 15
CAMERA = Camera(ClientSettings(width=WIDTH, height=HEIGHT).intrinsics, Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
needs_ffmpeg = pytest.mark.skipif(ffmpeg.program() is None, reason="the extra video-metrics is not installed")
needs_jod = pytest.mark.skipif(not available(), reason="the extra jod is not installed")


def scene(frame: int) -> F32:
    """Stripes of several widths that move."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    wave = np.sin((x + 3 * frame) / 5) * np.cos((y - frame) / 9) + 0.4 * np.sin((x - y) / 23)
    return np.repeat((0.5 + 0.25 * wave)[..., None], 3, axis=2).astype(np.float32)


@contextmanager
def film(shown: list[np.ndarray]) -> Iterator[Film]:
    with FilmMaker(lambda frame, _: (scene(frame), np.ones((HEIGHT, WIDTH), np.float32)), 30.0) as maker:
        for frame, picture in enumerate(shown):
            maker.show(frame, CAMERA, np.asarray(np.rint(picture.clip(0, 1) * 255), np.uint8))
        yield maker.film()


SAME = [scene(frame) for frame in range(FRAMES)]
FROZEN = [scene(min(frame, 4)) for frame in range(FRAMES)]
STEADY = [scene(frame) + np.float32(0.02) for frame in range(FRAMES)]
FLICKERING = [scene(frame) + np.float32(0.02 * (1 if frame // 2 % 2 else -1)) for frame in range(FRAMES)]
"""The same error as in ``STEADY``, but its sign changes 7.5 times a second."""


def scores(pictures: list[np.ndarray], *names: str) -> dict[str, float]:
    with film(pictures) as one:
        return metrics.measure(one, names)


@needs_ffmpeg
def test_equal_films_have_the_best_vmaf_and_xpsnr() -> None:
    found = scores(SAME, "vmaf", "xpsnr")
    assert found["vmaf"] >= 97
    assert found["xpsnr_db"] == MAX_PSNR_DB


@needs_ffmpeg
def test_a_frozen_film_is_worse() -> None:
    same, frozen = scores(SAME, "vmaf", "xpsnr"), scores(FROZEN, "vmaf", "xpsnr")
    assert frozen["vmaf"] < same["vmaf"] - 10
    assert frozen["xpsnr_db"] < 40


@needs_ffmpeg
def test_a_film_with_less_signal_than_noise_has_a_negative_xpsnr() -> None:
    """It ended a whole reproduction: figures below zero were not read."""
    white, black = np.ones((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    with FilmMaker(lambda frame, _: (white, white[..., 0]), 30.0) as maker:
        for frame in range(FRAMES):
            maker.show(frame, CAMERA, black)
        assert metrics.measure(maker.film(), ["xpsnr"])["xpsnr_db"] < 0


@needs_ffmpeg
def test_only_what_is_asked_for_is_measured() -> None:
    assert set(scores(SAME, "xpsnr")) == {"xpsnr_db"}
    assert scores(SAME) == {}


@needs_ffmpeg
def test_a_colour_error_alone_is_seen_by_xpsnr() -> None:
    tinted = [picture + np.array([0.06, 0.0, -0.2], np.float32) for picture in SAME]
    assert scores(tinted, "xpsnr")["xpsnr_db"] < 35


@needs_jod
@pytest.mark.slow
def test_equal_films_have_ten_jod() -> None:
    with film(SAME) as same:
        assert jod(same) == pytest.approx(10.0)


@needs_jod
@pytest.mark.slow
def test_flicker_costs_jod_and_a_steady_error_of_the_same_size_less() -> None:
    with film(STEADY) as steady, film(FLICKERING) as flickering:
        assert jod(flickering) < jod(steady) - 0.2


@needs_jod
@pytest.mark.slow
def test_a_frozen_film_has_less_jod() -> None:
    with film(FROZEN) as frozen:
        assert jod(frozen) < 9


def test_what_is_missing_is_told_with_the_extra_that_gives_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ffmpeg, "program", lambda: None)
    monkeypatch.setattr(ffmpeg, "filters", frozenset)
    monkeypatch.setattr(metrics, "available", lambda: False)
    assert metrics.lacking(("vmaf", "xpsnr", "jod")) == {
        "vmaf": "pip install 'cags-stream[video-metrics]'",
        "xpsnr": "pip install 'cags-stream[video-metrics]'",
        "jod": "pip install 'cags-stream[jod]'",
    }
    assert scores(SAME[:2], "vmaf", "xpsnr", "jod") == {}


def test_an_ffmpeg_without_the_filter_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ffmpeg, "program", lambda: "/ffmpeg")
    monkeypatch.setattr(ffmpeg, "filters", lambda: frozenset({"xpsnr"}))
    assert metrics.lacking(("vmaf", "xpsnr")) == {
        "vmaf": "the ffmpeg of imageio-ffmpeg was built without libvmaf; try another release"
    }


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("none", ()),
        ("auto", ("vmaf", "xpsnr")),
        ("jod,vmaf", ("vmaf", "jod")),
        ("auto,jod", ("vmaf", "xpsnr", "jod")),
    ],
)
def test_metrics_are_chosen_by_name(text: str, found: tuple[str, ...]) -> None:
    assert metrics.chosen(text) == found


def test_an_unknown_metric_is_refused() -> None:
    with pytest.raises(ConfigError, match="video_metrics: 'ssimulacra' is unknown; known: vmaf, xpsnr, jod"):
        metrics.chosen("vmaf,ssimulacra")
