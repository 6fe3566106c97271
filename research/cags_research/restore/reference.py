"""Shows the aligned reference, and the client's own picture where it says nothing."""

from __future__ import annotations

import numpy as np

from cags_client.frame.restore import RestorerOptions
from cags_client.frame.restore.base import ALIGNED, RestoreInput
from cags_common.errors import ConfigError
from cags_common.geometry import F32


class ReferenceRestorer:
    """The reference itself, upsampled: what a client without splats of its own colours could show."""

    name = "reference"
    needs = ALIGNED
    replaces = True

    def __init__(self, options: RestorerOptions) -> None:
        if options.runtime:
            raise ConfigError(f"restorer 'reference' runs no network: leave '@{options.runtime}' out")

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.frame.restore.base.Restorer`."""
        share = inputs.aligned.confidence[..., None]
        shown = inputs.distorted + share * (inputs.aligned.rgb - inputs.distorted)
        return np.asarray(np.clip(shown, 0.0, 1.0), dtype=np.float32)
