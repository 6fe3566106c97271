"""``cags-bench motion``: bytes a frame and picture quality of moving scenes, motion coded apart and not, in one run."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cags_common.settings import add_settings, check_settings, load_settings, setting

SUMMARY = (
    "Encode moving scenes with motion coded apart and with changed splats sent whole, and compare bytes a frame and "
    "PSNR; time the evaluation of motion."
)

EXAMPLES = """\
  cags-bench motion --shared ../shared --json
  cags-bench motion --scenes 'fourd:frames=100' --json
  cags-bench motion --scenes 'procedural:size=30000;motion:plant.splat' --frames 33
"""

DISGUISE = "shuffle=1,quantise=sog"
"""Options that make any scene's frames what a capture's tool chain hands on."""


@dataclass(frozen=True)
class MotionSettings:
    """What is measured."""

    shared: str = setting("../shared", "folder with scenes/; what is not there is left out")
    scenes: str = setting("", "scenes, separated by ';'; empty: those of --shared and generated ones")
    frames: int = setting(49, "frames of each scene at most", low=3, high=10_000)
    judged: int = setting(7, "frames whose pictures are compared, spread over the clip", low=1, high=1000)
    views: int = setting(3, "views of each judged frame", low=1, high=64)
    workers: int = setting(2, "processes that encode", low=1, high=64)
    whole: bool = setting(True, "whether to encode with changed splats sent whole, too (the state to compare with)")
    repetitions: int = setting(15, "timed evaluations of motion", low=1, high=1000)
    threads: int = setting(2, "threads that evaluate motion", low=1, high=64)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def scene_list(self) -> list[str]:
        """Scene names that open_scene reads."""
        if self.scenes:
            return self.scenes.split(";")
        folder = Path(self.shared) / "scenes"
        ordered = {
            "talking_head/params.npz": f"{folder}/talking_head/params.npz:up=y",
            "plant/plant.splat": f"motion:{folder}/plant/plant.splat",
        }
        known = [spec for name, spec in ordered.items() if (folder / name).exists()]
        known.append("procedural:size=30000")
        captures = [str(folder / name) for name in ("monkey", "wave") if (folder / name).exists()]
        return [*known, *(disguised(spec) for spec in known), *captures, "fourd:shuffle=1"]


def disguised(spec: str) -> str:
    """``spec`` with rows shuffled and attributes quantised as SOG does."""
    return f"{spec}{',' if ':' in spec.rpartition('/')[2] else ':'}{DISGUISE}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's flags."""
    add_settings(parser, MotionSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A line a scene and way to encode, one for the times, then the summary."""
    from cags_bench.motion.experiment import measure

    return measure(load_settings(MotionSettings, arguments))
