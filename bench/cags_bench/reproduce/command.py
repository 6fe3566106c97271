"""``cags-bench reproduce``: every table and figure that needs no private data, with one command."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cags_common.settings import add_settings, check_settings, load_settings, setting

SUMMARY = "Make the paper's tables and figures again. Resumable: results are kept by content, a second run goes on."

EXAMPLES = """\
  cags-bench reproduce --all --quick --out reproduction
  cags-bench reproduce --figure fixed --frames 150 --width 1600 --height 1200
  cags-bench reproduce --table components
"""


@dataclass(frozen=True)
class ReproduceSettings:
    """What is made, from what, and how large."""

    all: bool = setting(False, "make every table and figure")
    table: str = setting("", "make one table, by name")
    figure: str = setting("", "make one figure, by name")
    quick: bool = setting(False, "fewer frames, rates and levels: under 25 minutes on two cores")
    scenes: str = setting("procedural:size=30000", "scenes, separated by spaces")
    poses: str = setting("synthetic:walking", "head motion: a pose file or synthetic:NAME")
    trace: str = setting("generated:5g-mmwave", "fluctuating network trace")
    frames: int = setting(0, "frames a session; 0: 300, or 45 when quick", low=0, high=100_000)
    width: int = setting(0, "client width in pixels; 0: 1600, or 640 when quick", low=0, high=8192)
    height: int = setting(0, "client height in pixels; 0: 1200, or 480 when quick", low=0, high=8192)
    device: str = setting("auto", "renderer: auto, reference, cpu or gpu", choices=("auto", "reference", "cpu", "gpu"))
    workers: int = setting(0, "sessions simulated at the same time; 0: as many as there are cores", low=0, high=256)
    lpips: str = setting("", "weights of LPIPS (.npz), to measure it too; empty: leave it out")
    out: str = setting("reproduction", "folder for index.html, and a .jsonl and .csv file a table")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    add_settings(parser, ReproduceSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield a line a table row, and the summary."""
    settings = load_settings(ReproduceSettings, arguments)
    from cags_bench.reproduce.run import reproduce

    yield from reproduce(settings)
