"""Restorers that run a network."""

from __future__ import annotations

import numpy as np

from cags_client.frame.restore.base import ALIGNED, RestoreInput
from cags_common.geometry import F32
from cags_research.restore.networks.inputs import filled, reach
from cags_research.restore.networks.runtimes import Runtime


class PictureRestorer:
    """The paper's network and its one-input variants, at full resolution.

    One that only corrects shows the distorted picture where the reference says nothing near a pixel. Those that
    replace it go without: they show what the paper's configurations show.
    """

    needs = ALIGNED

    def __init__(self, runtime: Runtime, name: str, *, replaces: bool, gated: bool = False) -> None:
        """``gated``: the network is given the expected PSNR as a third input."""
        self.name, self.replaces = name, replaces
        self._runtime, self._gated = runtime, gated

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.frame.restore.base.Restorer`."""
        distorted, aligned = inputs.distorted, inputs.aligned
        if not self.replaces and not aligned.confidence.any():
            return distorted
        expected = (np.full((1, 1, 1), inputs.expected_db, np.float32),) if self._gated else ()
        shown = self._runtime.run(filled(aligned.rgb, aligned.confidence, distorted), distorted, *expected)
        if not self.replaces:
            shown = distorted + reach(aligned.confidence)[..., None] * (shown - distorted)
        return np.clip(shown, 0.0, 1.0)
