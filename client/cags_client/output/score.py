"""Scoring displayed frames against the truth: the same keys in real and in virtual time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from cags_client.frame.presented import PresentedFrame
from cags_common.geometry import F32
from cags_common.metrics import covered_mask, flicker, psnr_also_in, ssim


def score(presented: PresentedFrame, truth_rgb: F32, truth_alpha: F32) -> dict[str, float]:
    """PSNR (dB; over the frame and over covered pixels) and SSIM of the distorted, aligned and restored pictures.

    ``truth_rgb`` [H, W, 3] and ``truth_alpha`` [H, W] are the source frame seen from the same camera. The aligned
    reference is scored only where there is one.
    """
    return score_pictures(presented.distorted, presented.aligned_rgb, presented.rgb, truth_rgb, truth_alpha)


def score_pictures(
    distorted: F32, aligned: F32 | None, restored: F32, truth_rgb: F32, truth_alpha: F32
) -> dict[str, float]:
    """:func:`score` of plain pictures [H, W, 3]."""
    truth = np.clip(truth_rgb, 0.0, 1.0)
    covered = covered_mask(truth_alpha)
    out: dict[str, float] = {"covered": float(covered.mean())}
    scored: dict[int, tuple[float, float, float]] = {}  # what nothing restored is one picture
    for name, picture in (("distorted", distorted), ("aligned", aligned), ("restored", restored)):
        if picture is None:
            continue
        if id(picture) not in scored:
            scored[id(picture)] = *psnr_also_in(picture, truth, covered), ssim(picture, truth)
        out[f"psnr_{name}_db"], out[f"psnr_covered_{name}_db"], out[f"ssim_{name}"] = scored[id(picture)]
    return out


class FlickerScore:
    """Temporal stability of a session's distorted and restored pictures; frames must come in order."""

    def __init__(self) -> None:
        self._before: tuple[int, F32, F32, F32] | None = None

    def __call__(self, presented: PresentedFrame, truth_rgb: F32) -> dict[str, float]:
        """``flicker_*`` (see :func:`cags_common.metrics.flicker`) of a frame that follows the one before; else none."""
        now = presented.frame, presented.distorted, presented.rgb, truth_rgb
        before, self._before = self._before, now
        if before is None or before[0] + 1 != now[0]:
            return {}
        distorted = flicker(now[1], before[1], truth_rgb, before[3])
        same = now[1] is now[2] and before[1] is before[2]
        restored = distorted if same else flicker(now[2], before[2], truth_rgb, before[3])
        return {"flicker_distorted": distorted, "flicker_restored": restored}


def averages(records: Iterable[dict[str, Any]]) -> dict[str, float]:
    """Mean over records of every numeric entry that they hold; entries that are not finite are left out."""
    values: dict[str, list[float]] = {}
    for record in records:
        for key, value in record.items():
            if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                values.setdefault(key, []).append(float(value))
    return {key: sum(found) / len(found) for key, found in values.items()}
