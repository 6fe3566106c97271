"""Metrics of whole films: which there are, which can be had here, and which extra gives the others."""

from __future__ import annotations

from collections.abc import Collection
from typing import TypeAlias

from cags_bench.film import ffmpeg
from cags_bench.film.ffmpeg import VMAF, XPSNR
from cags_bench.film.film import Film
from cags_bench.film.jod import JOD, available, jod
from cags_common.settings import names_in

Scores: TypeAlias = dict[str, float]

METRICS = VMAF, XPSNR, JOD
EXTRAS = {VMAF: "video-metrics", XPSNR: "video-metrics", JOD: "jod"}
"""Metric, and the extra of the distribution that brings it."""

AUTO, NONE = "auto", "none"
AUTOMATIC = VMAF, XPSNR
"""What :data:`AUTO` measures: JOD takes ten times as long as all the rest of a play."""


def chosen(text: str) -> tuple[str, ...]:
    """Metrics that a setting names: some of :data:`METRICS` by commas, :data:`AUTO` or :data:`NONE`.

    Raises :class:`ConfigError` for unknown ones.
    """
    if text == NONE:
        return ()
    if text == AUTO:
        return AUTOMATIC
    names = names_in(text, "video_metrics", (*METRICS, AUTO, NONE))
    return tuple(metric for metric in METRICS if metric in names or (AUTO in names and metric in AUTOMATIC))


def lacking(metrics: Collection[str]) -> dict[str, str]:
    """Those of ``metrics`` that cannot be measured here, and why, with the way out."""
    out = {}
    for metric in metrics:
        here = available() if metric == JOD else metric in ffmpeg.filters()
        if here:
            continue
        if metric != JOD and ffmpeg.program() is not None:
            out[metric] = (
                f"the ffmpeg of imageio-ffmpeg was built without {ffmpeg.FILTERS[metric]}; try another release"
            )
        else:
            out[metric] = f"pip install 'cags-stream[{EXTRAS[metric]}]'"
    return out


def measure(film: Film, metrics: Collection[str]) -> Scores:
    """``vmaf``, ``xpsnr_db`` and ``jod`` of a film, as far as asked for and to be had.

    Raises :class:`CagsError` where a program that is there fails.
    """
    out = ffmpeg.measured(film, metrics)
    if XPSNR in out:
        out["xpsnr_db"] = out.pop(XPSNR)
    if JOD in metrics and available() and film.frames:
        out[JOD] = jod(film)
    return out
