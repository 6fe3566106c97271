"""Reports of a stream: a plot over time, and a strip of pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

JsonObject = dict[str, Any]

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


def series(frames: Sequence[JsonObject], key: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """One figure over frames [F]; NaN if a frame lacks it."""
    return np.array([np.nan if frame.get(key) is None else float(frame[key]) for frame in frames])


def capacity_series(trace: Any, seconds: float, begin_us: int = 0) -> tuple[list[float], list[float]]:
    """The link's capacity while frames are shown, in steps of 100 ms: (times in s, Mbps).

    ``begin_us`` is the link's time when the first frame is due, at which the times begin.
    """
    step_us = 100_000
    starts = range(0, int(seconds * 1e6) + step_us, step_us)
    rates = [trace.mean_bps(begin_us + start, begin_us + start + step_us) / 1e6 for start in starts]
    return [start / 1e6 for start in starts], rates


def plot_stream(frames: Sequence[JsonObject], capacity: tuple[Any, Any] | None, path: Path) -> None:
    """Plot quality, detail and rate over time. ``capacity`` is (times in s, Mbps) of the link."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    time_s = series(frames, "time_us") / 1e6
    time_s -= time_s[0] if len(time_s) else 0.0
    figure, (quality, detail, rate) = plt.subplots(3, 1, sharex=True, figsize=(10, 8), layout="constrained")
    for key, colour in (
        ("psnr_distorted_db", "tab:red"),
        ("psnr_aligned_db", "tab:orange"),
        ("psnr_restored_db", "tab:green"),
    ):
        values = series(frames, key)
        if np.isfinite(values).any():  # only some restorers align a picture
            quality.plot(time_s, values, color=colour, label=key.split("_")[1])
    quality.set_ylabel("PSNR [dB]")
    quality.legend(loc="lower right")
    detail.plot(time_s, series(frames, "lod_mean"), color="tab:blue")
    detail.set_ylabel("mean LoD shown")
    span_s = np.diff(time_s, append=time_s[-1:] + 1 / 30)
    for key, colour in (("bytes_tiles", "tab:blue"), ("bytes_reference", "tab:purple")):
        rate.step(
            time_s,
            series(frames, key) * 8e-6 / np.maximum(span_s, 1e-3),
            where="post",
            color=colour,
            label=key.split("_")[1],
        )
    if capacity is not None:
        rate.step(*capacity, where="post", color="0.6", label="link")
        rate.set_xlim(0, max(float(time_s[-1]), 0.1))
    rate.set_ylabel("Mbps")
    rate.set_xlabel("time [s]")
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
