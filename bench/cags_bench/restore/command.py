"""``cags-bench restore``: quality and time of every restorer over LoDs, pose errors and kinds of reference."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cags_bench.restore.conditions import Conditions
from cags_common.settings import add_settings, load_settings, setting

SUMMARY = "Measure restorers, the paper's baselines and ablations on one scene: PSNR, SSIM, LPIPS and milliseconds."

EXAMPLES = """\
  cags-bench restore --json
  cags-bench restore --scene capture.ply --sizes 1600x1200 --lods 0,0.5,1 --errors 0/0,5/20
  cags-bench restore --scene capture.ply --poses walk.csv --errors predicted --lpips lpips_alex.npz
  cags-bench restore --methods affine,lite,lite@openvino --references footprint,plain,2x,full"""

METHODS = (
    "none,aligned,aligned without erosion,affine,sirt,sirt + affine,lite,srresnet,sr-align-ref,cr-no-ref,"
    "affine without PRPA,affine with own depth,paper"
)


@dataclass(frozen=True)
class RestoreBenchSettings(Conditions):
    """What is measured."""

    methods: str = setting(METHODS, "restorers (NAME or NAME@RUNTIME), ablations and 'paper'")

    @property
    def method_list(self) -> list[str]:
        """Names."""
        return [word.strip() for word in self.methods.split(",") if word.strip()]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    add_settings(parser, RestoreBenchSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line a case and method, then the summary."""
    settings = load_settings(RestoreBenchSettings, arguments)
    from cags_bench.restore.experiment import restoration

    yield from restoration(settings)
