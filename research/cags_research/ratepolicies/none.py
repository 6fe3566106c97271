"""No tiles at all: the baseline that streams nothing but the reference."""

from __future__ import annotations

from cags_server.ratecontrol.base import Decision, Observation


class NoTilesPolicy:
    """Leaves the budget unused."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.ratecontrol.base.RatePolicy`."""
        return Decision((), 0)
