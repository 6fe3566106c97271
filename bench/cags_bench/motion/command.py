"""``cags-bench motion``: bytes per frame and quality of moving scenes, with separate motion and with whole splats."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.motion.settings import MotionSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Encode moving scenes with motion coded separately and with changed splats sent whole; compare bytes per frame and "
    "PSNR; measure the time to evaluate motion; play sessions of moving scenes over thin links in virtual time."
)

EXAMPLES = """\
  cags-bench motion --shared ../shared --json
  cags-bench motion --parts sessions --seeds 5 --json
  cags-bench motion --scenes 'fourd:frames=100' --json
  cags-bench motion --scenes 'procedural:size=30000;motion:plant.splat' --frames 33
  cags-bench motion --scenes wave --film strip.png --film-scene motion:plant.splat
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, MotionSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line per scene and coding, one for the times, one per session, then the summary."""
    from cags_bench.motion.experiment import measure

    return measure(load_settings(MotionSettings, arguments))
