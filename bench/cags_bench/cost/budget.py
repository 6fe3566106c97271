"""From the measured client frame to settings that fit a frame time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cags_bench.cost.command import CostSettings
from cags_bench.cost.engine import Measured
from cags_common.errors import ConfigError

HEADROOM = 0.8
"""Share of the frame time that drawing may take: decoding, the network and the display need the rest."""


def propose(frames: Sequence[Measured], budget_ms: float) -> Measured:
    """The best picture that fits ``HEADROOM`` of the budget. Raises :class:`ConfigError` when none fits."""
    fitting = [one for one in frames if one.median_ms <= HEADROOM * budget_ms]
    if not fitting:
        fastest = min(one.median_ms for one in frames)
        raise ConfigError(
            f"budget_ms = {budget_ms}: the fastest settings take {fastest:.1f} ms here, and {HEADROOM:.0%} of the "
            "budget is for drawing; give more, or a smaller picture by --width and --height"
        )
    return max(fitting, key=lambda one: (one.outcome[one.stage.quality], -one.median_ms))


def write_config(path: Path, proposal: Measured, settings: CostSettings) -> None:
    """Write the proposal as TOML that ``cags-client --config`` accepts."""
    exactness, iterations, tier = proposal.point.label.split(" / ")
    path.write_text(
        f"# proposed by cags-bench cost --budget-ms {settings.budget_ms:g}: "
        f"{proposal.median_ms:.1f} ms a frame, {proposal.outcome[proposal.stage.quality]:.2f} dB\n"
        f"width = {settings.width}\nheight = {settings.height}\n"
        f'exactness = "{exactness}"\nerosion = {"true" if iterations != "0" else "false"}\nrestore = "{tier}"\n',
        encoding="utf-8",
    )
