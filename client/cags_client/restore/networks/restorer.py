"""Restorers that run a network."""

from __future__ import annotations

import numpy as np

from cags_client.align.base import ReferencePicture
from cags_client.restore.affine import AffineSettings, corrected, fields_of, own_view
from cags_client.restore.base import ALIGNED, COMPARED, RestoreInput
from cags_client.restore.networks.inputs import even, filled, noise_features, reach
from cags_client.restore.networks.runtimes import Runtime
from cags_client.restore.pair import OncePerPair
from cags_common.geometry import F32


class LiteRestorer:
    """The closed form, by the fields that :class:`~cags_client.restore.networks.lite.Lite` makes of its own."""

    needs = COMPARED

    def __init__(self, runtime: Runtime, name: str = "lite", threads: int | None = None) -> None:
        self.name = name
        self._runtime = runtime
        self._settings = AffineSettings(threads=threads) if threads else AffineSettings()
        self._fields = OncePerPair(self._made)

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        if not inputs.aligned.confidence.any():
            return inputs.distorted
        own = own_view(inputs)
        return corrected(inputs, own, self._settings, self._fields.of(inputs, own))

    def _made(self, own: F32, reference: ReferencePicture) -> F32:
        """The closed form's fields [h, w, 4], improved where they change anything."""
        fields = fields_of(own, reference, self._settings)
        if not fields.any():
            return fields
        images = (even(image) for image in (own, reference.rgb, fields))
        h, w = fields.shape[:2]
        return self._runtime.run(*images, noise_features(reference.noise)[None, None])[:h, :w]


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
