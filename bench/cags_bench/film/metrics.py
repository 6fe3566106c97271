"""Metrics of whole films: names, availability, and the extras that provide them."""

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
"""Metric -> extra that provides it."""

AUTO, NONE = "auto", "none"
AUTOMATIC = VMAF, XPSNR
"""Metrics of :data:`AUTO`: without JOD, which takes ten times as long as the rest of a play."""


def chosen(text: str) -> tuple[str, ...]:
    """Metrics named by a setting: names from :data:`METRICS`, comma separated, or :data:`AUTO` or :data:`NONE`.

    Raises :class:`ConfigError` for unknown names.
    """
    if text == NONE:
        return ()
    if text == AUTO:
        return AUTOMATIC
    names = names_in(text, "video_metrics", (*METRICS, AUTO, NONE))
    return tuple(metric for metric in METRICS if metric in names or (AUTO in names and metric in AUTOMATIC))


def lacking(metrics: Collection[str]) -> dict[str, str]:
    """The ``metrics`` that cannot be measured on this machine, with the reason and remedy."""
    out = {}
    for metric in metrics:
        usable = available() if metric == JOD else metric in ffmpeg.filters()
        if usable:
            continue
        if metric != JOD and ffmpeg.program() is not None:
            out[metric] = (
                f"the ffmpeg of imageio-ffmpeg was built without {ffmpeg.FILTERS[metric]}; try another release"
            )
        else:
            out[metric] = f"pip install 'cags-stream[{EXTRAS[metric]}]'"
    return out


def measure(film: Film, metrics: Collection[str]) -> Scores:
    """The requested metrics of a film, as far as they are available: ``vmaf``, ``xpsnr_db`` and ``jod``.

    Raises :class:`CagsError` if an installed program fails.
    """
    out = ffmpeg.measured(film, metrics)
    if XPSNR in out:
        out["xpsnr_db"] = out.pop(XPSNR)
    if JOD in metrics and available() and film.frames:
        out[JOD] = jod(film)
    return out
