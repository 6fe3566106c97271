"""Restorers that run a network."""

from __future__ import annotations

import numpy as np

from cags_client.frame.restore.base import ALIGNED, RestoreInput
from cags_client.frame.restore.networks.inputs import filled, reach
from cags_client.frame.restore.networks.runtimes import Runtime
from cags_common.geometry import F32


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
        """See :class:`cags_client.frame.restore.base.Restorer`."""
        distorted, aligned = inputs.distorted, inputs.aligned
        if self._fall_back and not aligned.confidence.any():
            return distorted
        shown = self._runtime.run(filled(aligned.rgb, aligned.confidence, distorted), distorted)
        if self._fall_back:
            shown = distorted + reach(aligned.confidence)[..., None] * (shown - distorted)
        return np.clip(shown, 0.0, 1.0)
