"""Reports of a stream: a plot over time, and a strip of pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.geometry import F64
from cags_shaper.trace import Trace

JsonObject = dict[str, Any]

WINDOW_S, MOST_WINDOWS = 0.1, 200
"""Length of the windows over which rates are averaged, and the largest number of them: in longer plays they are longer.
"""

PICTURES = {
    "psnr_distorted_db": ("tab:red", "own splats"),
    "psnr_aligned_db": ("tab:orange", "aligned"),
    "psnr_restored_db": ("tab:green", "shown"),
}
"""What is plotted of the pictures' quality: its colour and its name."""

CENTRED: Mapping[str, Any] = {"ha": "center", "va": "center", "color": "0.4"}

STAGES_EVERY = 15
"""Interval of frames whose stages are saved."""

STRIP_STAGES = ("reference", "distorted", "correction", "aligned", "restored", "truth")
STRIP_TITLES = {
    "reference": "reference (sent)",
    "distorted": "distorted (decoded splats)",
    "correction": "change by the reference, around grey",
    "aligned": "aligned picture",
    "restored": "restored (shown)",
    "truth": "truth (never sent)",
}


def read_lines(path: Path) -> tuple[list[JsonObject], JsonObject]:
    """Frames and summary from a client's ``--json`` file."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]
    return [line for line in lines if not line.get("summary")], next(line for line in lines if line.get("summary"))


def series(frames: Sequence[JsonObject], key: str) -> F64:
    """One figure over frames [F]; NaN if a frame lacks it."""
    return np.array([np.nan if frame.get(key) is None else float(frame[key]) for frame in frames])


@dataclass(frozen=True)
class StreamTimes:
    """The windows over which the rates of a play are averaged, in seconds from its first frame.

    The first window is the time from the connection to that frame, in which most of a short play's bytes arrive.
    """

    frames_s: F64
    """[F] times of the frames."""
    edges_s: F64
    """[W + 1] boundaries of the windows."""

    @staticmethod
    def of(frames: Sequence[JsonObject], waited_s: float) -> StreamTimes:
        """The windows of ``frames`` [F], the first of which is displayed ``waited_s`` after the connection."""
        frames_s = series(frames, "time_us") / 1e6
        frames_s -= frames_s[0]
        end_s = max(float(frames_s[-1]), WINDOW_S)
        windows = min(round(end_s / WINDOW_S), MOST_WINDOWS)
        began = [-waited_s] if waited_s > 0 else []
        return StreamTimes(frames_s, np.concatenate([began, np.linspace(0.0, end_s, windows + 1)]))

    def spans(self, held: Sequence[bool]) -> list[tuple[float, float]]:
        """Begin and end in s of each run of frames of which ``held`` [F] is true: up to the next frame that is not."""
        ends_s = np.append(self.frames_s[1:], self.edges_s[-1])
        changes = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]])))
        return [(float(self.frames_s[a]), float(ends_s[b - 1])) for a, b in changes.reshape(-1, 2)]

    def rates_mbps(self, frame_bytes: F64) -> F64:
        """Mean rates [W] of what each frame [F] found to have arrived since the one before; NaN counts nothing."""
        arrived_s = self.frames_s - np.diff(self.frames_s, prepend=self.edges_s[0]) / 2
        received, _ = np.histogram(arrived_s, self.edges_s, weights=np.nan_to_num(frame_bytes))
        return 8e-6 * received / np.diff(self.edges_s)

    def link_mbps(self, link: Trace) -> tuple[F64, F64]:
        """The ``link``'s capacity in windows of equal length, from the connection on: edges [N + 1] in s, Mbps [N]."""
        begin_s, end_s = self.edges_s[[0, -1]]
        edges_s = np.linspace(begin_s, end_s, min(round((end_s - begin_s) / WINDOW_S), MOST_WINDOWS) + 1)
        edges_us = np.rint(1e6 * (edges_s - begin_s)).astype(int).tolist()
        return edges_s, np.array([link.mean_bps(*window) / 1e6 for window in pairwise(edges_us)])


def plot_stream(frames: Sequence[JsonObject], path: Path, *, waited_s: float, link: Trace) -> None:
    """Plot quality, detail and rate of ``frames`` over time, beside the capacity of the ``link``.

    The link's time begins with the connection, ``waited_s`` before the first frame. Without frames nothing is drawn.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    if not frames:
        return
    times = StreamTimes.of(frames, waited_s)
    figure, (quality, detail, rate) = plt.subplots(3, 1, sharex=True, figsize=(10, 8), layout="constrained")
    for key, (colour, label) in PICTURES.items():
        values = series(frames, key)
        if np.isfinite(values).any():  # only some restorers align a picture
            quality.plot(times.frames_s, values, color=colour, label=label)
    quality.set_ylabel("PSNR [dB]")
    for number, span in enumerate(times.spans([frame["half"] for frame in frames])):
        quality.axvspan(*span, color="tab:orange", alpha=0.15, label=None if number else "at half resolution")
    if quality.get_legend_handles_labels()[0]:
        quality.legend(loc="lower right")
    detail.plot(times.frames_s, series(frames, "lod_mean"), color="tab:blue")
    detail.set_ylabel("mean LoD shown")
    detail.set_ylim(bottom=0)
    for key, colour in (("bytes_tiles", "tab:blue"), ("bytes_reference", "tab:purple")):
        rate.stairs(times.rates_mbps(series(frames, key)), times.edges_s, color=colour, label=key.split("_")[1])
    edges_s, mbps = times.link_mbps(link)
    rate.stairs(mbps, edges_s, color="0.6", label="link", baseline=None)
    rate.set_xlim(*times.edges_s[[0, -1]])
    rate.set_ylim(bottom=0)
    rate.set_ylabel("Mbps")
    rate.set_xlabel("time from the first frame [s]")
    if waited_s > 0:
        for axes in (quality, detail, rate):
            axes.axvspan(-waited_s, 0.0, color="0.94", zorder=0)
        detail.text(-waited_s / 2, 0.5, "before the\nfirst frame", transform=detail.get_xaxis_transform(), **CENTRED)
    rate.legend(loc="upper right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def telling_frame(frames: Sequence[dict[str, Any]]) -> int | None:
    """The saved frame with the largest gain from its reference; None if none was saved."""
    saved = [frame for frame in frames if frame["frame"] % STAGES_EVERY == 0]
    return max(saved, key=gain_db, default={"frame": None})["frame"]


def gain_db(frame: Mapping[str, Any]) -> float:
    """What the reference gained in a frame; 0 where nothing was corrected or measured."""
    before, after = frame.get("psnr_distorted_db"), frame.get("psnr_restored_db")
    return 0.0 if before is None or after is None else after - before


def write_strip(stages: Path, frame: int, path: Path) -> bool:
    """Put one frame's stages side by side with titles. Returns False if the client saved none."""
    import cv2

    panels = []
    for stage in STRIP_STAGES:
        file = stages / f"frame_{frame:04d}_{stage}.png"
        image = cv2.imread(str(file)) if file.exists() else None
        if image is not None:
            size = f", {image.shape[1]}x{image.shape[0]}" if stage == "reference" else ""
            panels.append((STRIP_TITLES[stage] + size, image))
    if not panels:
        return False
    height = max(image.shape[0] for _, image in panels)
    columns = [_titled(title, _to_height(image, height)) for title, image in panels]
    return bool(cv2.imwrite(str(path), np.concatenate(columns, axis=1)))


def _to_height(image: Any, height: int) -> Any:
    import cv2

    if image.shape[0] == height:
        return image
    width = round(image.shape[1] * height / image.shape[0])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_NEAREST)


def _titled(title: str, image: Any) -> Any:
    import cv2

    scale = image.shape[0] / 600
    bar = np.full((max(16, round(36 * scale)), image.shape[1], 3), 24, np.uint8)
    cv2.putText(
        bar,
        title,
        (6, bar.shape[0] - max(4, round(11 * scale))),
        cv2.FONT_HERSHEY_SIMPLEX,
        0.8 * scale,
        (235, 235, 235),
        1,
        cv2.LINE_AA,
    )
    return np.concatenate([bar, image], axis=0)
