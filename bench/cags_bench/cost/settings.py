"""Settings of ``cags-bench cost``."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting

Size = tuple[int, int]
"""Width and height in pixels."""


@dataclass(frozen=True)
class CostSettings:
    """What is measured, how large, and how often."""

    scenes: str = setting(
        "procedural:size=60000,frames=24",
        "scenes, separated by spaces: files, folders, motion:PATH or procedural[:...]",
    )
    sizes: str = setting("640x480", "client sizes in pixels, separated by commas")
    frames: int = setting(36, "media frames of each session", low=4, high=10_000)
    moments: int = setting(3, "moments of each scene that settings are measured at", low=1, high=100)
    repetitions: int = setting(2, "timed runs of each point a moment, after one that is not timed", low=1, high=100)
    trace: str = setting(
        "generated:steady-6",
        "network trace for 60,000 splats, scaled so that every scene gets the same bits a splat; it must be slow "
        "enough that references are used",
    )
    share: float = setting(1.0, "factor on the trace's rates", low=1e-3, high=10)
    poses: str = setting("synthetic:walking", "head motion")
    seeds: int = setting(
        1,
        "plays of each whole session, each with another walk and part of the trace; 0: no whole sessions",
        low=0,
        high=100,
    )
    workers: int = setting(2, "whole sessions played at the same time, one thread each", low=1, high=64)
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    out: str = setting("", "folder for the page (index.html), points.jsonl and points.csv; empty: none")
    budget_ms: float | None = setting(None, "propose settings that fit this frame time in ms, for example 16.7", low=1)
    config_out: str = setting("", "file for the proposed settings, for cags-client --config and cags-server --config")

    def __post_init__(self) -> None:
        check_settings(self)
        self.scene_list, self.size_list  # noqa: B018 - refuse what does not parse
        if self.config_out and self.budget_ms is None:
            raise ConfigError("config_out needs a budget; give --budget-ms too")

    @property
    def scene_list(self) -> list[str]:
        """Specs of the scenes, each once."""
        found = list(dict.fromkeys(self.scenes.split()))
        if not found:
            raise ConfigError("scenes is empty; name at least one, for example procedural")
        return found

    @property
    def size_list(self) -> list[Size]:
        """Client sizes in pixels, smallest first."""
        try:
            pairs = [text.lower().split("x") for text in self.sizes.split(",")]
            found = sorted({(int(width), int(height)) for width, height in pairs}, key=lambda s: s[0] * s[1])
        except ValueError:
            raise ConfigError(f"sizes = {self.sizes!r} must be like 640x480,1600x1200") from None
        for size in found:
            if not all(64 <= side <= 8192 for side in size):
                raise ConfigError(f"sizes = {self.sizes!r}: sides must lie in 64 to 8192 pixels")
        return found
