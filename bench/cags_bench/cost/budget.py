"""Chooses settings of client and server that fit a frame time, from the measured points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cags_bench.cost.engine import Measured
from cags_bench.cost.settings import CostSettings
from cags_common.errors import ConfigError
from cags_common.files import write_whole

CLIENT_STAGE, SERVER_STAGE = "client frame", "whole reference"
"""Stages that proposals are based on: all work of a client for a frame, and drawing and coding a reference."""

HEADROOM = 0.8
"""Share of the frame time for drawing; decoding, the network and the display need the rest."""


@dataclass(frozen=True)
class Proposal:
    """The best points that fit the budget, at one picture size."""

    client: Measured
    server: Measured

    def line(self) -> dict[str, Any]:
        """The proposal as an entry of the summary."""
        size: dict[str, Any] = {"size": self.client.size}
        return size | {
            side: {"point": one.label, "median_ms": one.median_ms, one.stage.quality: one.quality}
            for side, one in (("client", self.client), ("server", self.server))
        }


def proposed(groups: Sequence[Sequence[Measured]], budget_ms: float) -> Proposal:
    """The proposal for the largest picture size at which something fits. Raises :class:`ConfigError` if nothing does.

    ``groups`` are in ascending order of size.
    """
    by_size = {(group[0].stage.name, group[0].size): group for group in groups}
    sizes = [size for name, size in by_size if name == CLIENT_STAGE]
    refusal: ConfigError | None = None
    for size in reversed(sizes):
        try:
            return propose(by_size[CLIENT_STAGE, size], by_size[SERVER_STAGE, size], budget_ms)
        except ConfigError as error:
            refusal = error
    assert refusal is not None, "a sweep has at least one size"
    raise refusal


def propose(client: Sequence[Measured], server: Sequence[Measured], budget_ms: float) -> Proposal:
    """The best quality within ``HEADROOM`` of the budget. Raises :class:`ConfigError` if nothing fits."""
    return Proposal(_best(client, budget_ms), _best(server, budget_ms))


def _best(points: Sequence[Measured], budget_ms: float) -> Measured:
    fitting = [one for one in points if one.median_ms <= HEADROOM * budget_ms]
    if not fitting:
        fastest = min(one.median_ms for one in points)
        raise ConfigError(
            f"budget_ms = {budget_ms}: the fastest {points[0].stage.name} takes {fastest:.1f} ms at {points[0].size}, "
            f"and {HEADROOM:.0%} of the budget is for drawing; give a larger budget, or a smaller one of --sizes"
        )
    return max(fitting, key=lambda one: (one.quality, -one.median_ms))


def write_config(path: Path, proposal: Proposal, settings: CostSettings) -> None:
    """Write the proposal as TOML for ``cags-client --config`` and ``cags-server --config``.

    Raises :class:`OutputError` if the file cannot be written.
    """
    exactness, resolution, way = proposal.client.label.split(" / ")
    size, crf = proposal.server.label.split(" / crf ")
    (width, height), (reference_width, reference_height) = proposal.client.size.split("x"), size.split("x")
    text = (
        f"# proposed by cags-bench cost --budget-ms {settings.budget_ms:g}\n\n"
        f"[client]  # {_summary(proposal.client)}\n"
        f"width = {width}\nheight = {height}\n"
        f'exactness = "{exactness}"\nresolution = "{resolution}"\nrestore = "{way}"\n\n'
        f"[server]  # {_summary(proposal.server)}\n"
        f"reference_width = {reference_width}\nreference_height = {reference_height}\n"
        f"reference_crf = {float(crf)}\n"
    )
    write_whole(path, text.encode())


def _summary(one: Measured) -> str:
    return f"{one.median_ms:.1f} ms a frame, {one.quality:.2f} dB"
