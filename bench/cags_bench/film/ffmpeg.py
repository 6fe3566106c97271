"""VMAF and XPSNR, measured with the ffmpeg of the package ``imageio-ffmpeg``.

VMAF (Li et al., Netflix 2016; model v0.6.1) predicts viewers' ratings from 0 to 100 on a television at three screen
heights. XPSNR (Helmrich et al., 2020) is a PSNR in dB whose errors are weighted by their visibility in the picture and
its motion. Both get the films without loss, as raw pictures.
"""

from __future__ import annotations

import functools
import json
import re
import subprocess
import tempfile
from collections.abc import Collection
from pathlib import Path

from cags_bench.film.film import Film, RawVideo
from cags_common.errors import CagsError
from cags_common.metrics import MAX_PSNR_DB

VMAF, XPSNR = "vmaf", "xpsnr"
FILTERS = {VMAF: "libvmaf", XPSNR: "xpsnr"}
"""Names of the metrics, and ffmpeg's filters."""

SMALLEST_SIDE_PX = 32
"""Smallest side for libvmaf, which uses four scales of the picture."""

VMAF_LOG, XPSNR_LOG = "vmaf.json", "xpsnr.txt"
MINIMUM = re.compile(r"minimum: (inf|[0-9.]+)")


@functools.cache
def program() -> str | None:
    """The ffmpeg of the package imageio-ffmpeg; None if it is not installed."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        return None
    try:
        return str(get_ffmpeg_exe())
    except RuntimeError:  # the package has no ffmpeg for this system
        return None


@functools.cache
def filters() -> frozenset[str]:
    """Metrics supported by this ffmpeg."""
    ffmpeg = program()
    if ffmpeg is None:
        return frozenset()
    listed = subprocess.run([ffmpeg, "-hide_banner", "-filters"], capture_output=True, text=True, check=False).stdout
    names = {words[1] for line in listed.splitlines() if len(words := line.split()) > 2}
    return frozenset(metric for metric, name in FILTERS.items() if name in names)


def measured(film: Film, metrics: Collection[str]) -> dict[str, float]:
    """The requested ``metrics`` (:data:`VMAF`, :data:`XPSNR`) of a film, without those that :func:`filters` lacks.

    XPSNR is the minimum over the three colour planes, at most :data:`MAX_PSNR_DB`. Raises :class:`CagsError` if ffmpeg
    fails.
    """
    wanted = [metric for metric in FILTERS if metric in metrics and metric in filters()]
    if not wanted or not film.frames or min(film.size) < SMALLEST_SIDE_PX:
        return {}
    with tempfile.TemporaryDirectory(prefix="cags-ffmpeg-") as folder:
        _run(film, wanted, Path(folder))
        found = {VMAF: _vmaf, XPSNR: _xpsnr}
        return {metric: found[metric](Path(folder)) for metric in wanted}


def _run(film: Film, metrics: list[str], folder: Path) -> None:
    graph = {
        VMAF: f"libvmaf=log_fmt=json:log_path={VMAF_LOG}:n_threads=1",
        XPSNR: f"xpsnr=stats_file={XPSNR_LOG}",
    }
    count = len(metrics)
    planes = "format=yuv444p,split=" + str(count)
    shown, true = ("".join(f"[{side}{n}]" for n in range(count)) for side in "st")
    chains = [f"[0:v]{planes}{shown}", f"[1:v]{planes}{true}"]
    chains += [f"[s{n}][t{n}]{graph[metric]}[o{n}]" for n, metric in enumerate(metrics)]
    outputs = [word for n in range(count) for word in ("-map", f"[o{n}]")]
    command = [
        *(program() or "", "-hide_banner", "-nostdin", "-loglevel", "error"),
        *(*_input(film.shown, film.fps), *_input(film.truth, film.fps)),
        *("-filter_complex", ";".join(chains), *outputs, "-f", "null", "-"),
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["nothing"])[-1]
        raise CagsError(
            f"ffmpeg cannot measure {', '.join(metrics)}: its message: {said}; leave them out of --video-metrics"
        )


def _input(video: RawVideo, fps: float) -> list[str]:
    height, width, _ = video.shape
    shape = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}", "-framerate", f"{fps:g}")
    return [*shape, "-i", str(video.path)]


def _vmaf(folder: Path) -> float:
    return float(json.loads((folder / VMAF_LOG).read_text(encoding="utf-8"))["pooled_metrics"]["vmaf"]["mean"])


def _xpsnr(folder: Path) -> float:
    found = MINIMUM.findall((folder / XPSNR_LOG).read_text(encoding="utf-8"))
    return min(float(found[-1]), MAX_PSNR_DB)
