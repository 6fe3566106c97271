"""Settings of ``cags-bench cost``."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class CostSettings:
    """Inputs of the sweep."""

    scene: str = setting("procedural:size=60000,frames=24", "scene: a file, a folder, motion:PATH or procedural[:...]")
    frames: int = setting(24, "media frames of the session that provides the inputs", low=4, high=10_000)
    trace: str = setting(
        "generated:steady-6", "network trace of that session; it must be slow enough that references are used"
    )
    poses: str = setting("synthetic:walking", "head motion of that session")
    width: int = setting(800, "client width in pixels", low=64, high=8192)
    height: int = setting(600, "client height in pixels", low=64, high=8192)
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    out: str = setting("", "folder for the page (index.html), points.jsonl and points.csv; empty: none")
    budget_ms: float | None = setting(None, "propose settings that fit this frame time in ms, for example 16.7", low=1)
    config_out: str = setting("", "file for the proposed settings, for cags-client --config and cags-server --config")

    def __post_init__(self) -> None:
        check_settings(self)
