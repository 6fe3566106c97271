"""A film strip: consecutive frames of one scene over one link, with whole splats above and separate motion below.

It shows the client's own splats before references correct them, so that only the coding of motion differs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject, provenance
from cags_bench.sim.session import Scenario, simulate
from cags_client.frame.presented import PresentedFrame
from cags_client.output.files import write_png
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings

WAYS = {"none": "changed splats sent whole", "tracks": "motion coded apart"}
WIDTH_PX, HEIGHT_PX = 320, 240
FIRST, COUNT = 36, 6
"""First frame of the strip (1.2 s into the play), and number of frames."""


def write_film(path: Path, scene: str, trace: str, cache: str) -> JsonObject:
    """Play ``scene`` over ``trace`` with both codings, write the strip to ``path``, and return the PSNR.

    Raises :class:`OutputError` if the file cannot be written.
    """
    rows, figures = [], {}
    for way, title in WAYS.items():
        pictures, found = _played(scene, trace, way, cache)
        rows.append(_row(title, pictures, found))
        figures[way] = [round(value, 2) for value in found]
    write_png(path, np.concatenate(rows, axis=0))
    return {"benchmark": "motion", "part": "film", "scene": scene, "trace": trace, "psnr_db": figures, **provenance()}


def _played(scene: str, trace: str, way: str, cache: str) -> tuple[list[NDArray[np.uint8]], list[float]]:
    """The drawn frames of the strip, and their PSNR over covered pixels."""
    frames = FIRST + COUNT + 1
    bundle = cached_bundle(scene, cache, EncodeSettings(frames=frames, motion=way), progress=False)
    pictures: list[NDArray[np.uint8]] = []
    found: list[float] = []

    def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
        if FIRST <= presented.frame < FIRST + COUNT:
            pictures.append((presented.distorted.clip(0, 1) * 255 + 0.5).astype(np.uint8))
            found.append(float(record["psnr_covered_distorted_db"]))

    client = ClientSettings(width=WIDTH_PX, height=HEIGHT_PX)
    simulate(Scenario(bundle, trace, "synthetic:walking", client=client), watch)
    return pictures, found


def _row(title: str, pictures: list[NDArray[np.uint8]], found: list[float]) -> NDArray[np.uint8]:
    labelled = []
    for number, (picture, value) in enumerate(zip(pictures, found, strict=True)):
        bar = np.full((26, WIDTH_PX, 3), 24, np.uint8)
        text = f"{title}, frame {FIRST}: {value:.1f} dB" if number == 0 else f"{value:.1f} dB"
        cv2.putText(bar, text, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
        labelled.append(np.concatenate([bar, picture], axis=0))
    return np.concatenate(labelled, axis=1)
