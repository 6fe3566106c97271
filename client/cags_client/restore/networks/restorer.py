"""Restorers that run a network."""

from __future__ import annotations

import cv2
import numpy as np

from cags_client.restore.base import ALIGNED, COMPARED, RestoreInput
from cags_client.restore.networks.inputs import HALF, filled, half_features, reach
from cags_client.restore.networks.runtimes import Runtime
from cags_common.geometry import F32


class LiteRestorer:
    """Adds the change that :class:`~cags_client.restore.networks.lite.Lite` finds to the distorted picture."""

    needs = COMPARED

    def __init__(self, runtime: Runtime, name: str = "lite") -> None:
        self.name = name
        self._runtime = runtime

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        aligned = inputs.aligned
        if not aligned.confidence.any():
            return inputs.distorted
        h, w = inputs.distorted.shape[:2]
        change = self._runtime.run(half_features(inputs))
        size = (HALF * change.shape[1], HALF * change.shape[0])
        restored = np.asarray(cv2.resize(change, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)[:h, :w]
        restored += inputs.distorted
        return np.clip(restored, 0.0, 1.0, out=restored)


class PictureRestorer:
    """The paper's network and its one-input variants, at full resolution.

    With ``fall_back`` the distorted picture is shown where the reference says nothing near a pixel. The baselines go
    without: they show what the paper's configurations show.
    """

    needs = ALIGNED

    def __init__(self, runtime: Runtime, name: str, *, fall_back: bool) -> None:
        self.name = name
        self._runtime, self._fall_back = runtime, fall_back

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        distorted, aligned = inputs.distorted, inputs.aligned
        if self._fall_back and not aligned.confidence.any():
            return distorted
        shown = self._runtime.run(filled(aligned.rgb, aligned.confidence, distorted), distorted)
        if self._fall_back:
            shown = distorted + reach(aligned.confidence)[..., None] * (shown - distorted)
        return np.clip(shown, 0.0, 1.0)
