"""No restoration: the client's own picture is shown."""

from __future__ import annotations

from cags_client.restore.base import RestoreInput
from cags_common.effects import Effect
from cags_common.geometry import F32


class NoRestorer:
    """Shows the distorted picture."""

    name = "none"
    needs: frozenset[Effect] = frozenset()

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        return inputs.distorted
