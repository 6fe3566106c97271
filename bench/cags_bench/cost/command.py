"""``cags-bench cost``: sweep every accuracy knob, measure time, bytes and quality, draw the fronts."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cags_common.settings import add_settings, check_settings, load_settings, setting

SUMMARY = "Measure what each step of accuracy costs in milliseconds and bytes, stage by stage, in one interleaved run."

EXAMPLES = """\
  cags-bench cost --out cost-page
  cags-bench cost --scene motion:plant.splat --width 1600 --height 1200 --json
  cags-bench cost --budget-ms 33.3 --config-out client.toml
"""


@dataclass(frozen=True)
class CostSettings:
    """What the sweep works on."""

    scene: str = setting("procedural:size=60000,frames=24", "scene: a file, a folder, motion:PATH or procedural[:...]")
    frames: int = setting(24, "media frames of the session that inputs are taken from", low=4, high=10_000)
    trace: str = setting(
        "generated:steady-6", "network trace of that session; slow, so that there is something to correct"
    )
    poses: str = setting("synthetic:walking", "head motion of that session")
    width: int = setting(800, "client width in pixels", low=64, high=8192)
    height: int = setting(600, "client height in pixels", low=64, high=8192)
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    out: str = setting("", "folder for the page (index.html), points.jsonl and points.csv; empty: none")
    budget_ms: float | None = setting(None, "propose the client's settings that fit this frame time, e.g. 16.7", low=1)
    config_out: str = setting("", "file for the proposed settings, which cags-client --config accepts")

    def __post_init__(self) -> None:
        check_settings(self)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    add_settings(parser, CostSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield a line a point and the summary."""
    settings = load_settings(CostSettings, arguments)
    from cags_bench.cost.sweep import sweep

    yield from sweep(settings)
