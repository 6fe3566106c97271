"""``cags-bench align``: what alignment, the closed-form restorer and the colour adapter cost, and what they bring."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cags_bench.restore.conditions import Conditions
from cags_common.errors import ConfigError
from cags_common.settings import add_settings, load_settings, setting

SUMMARY = "time and quality of alignment, closed-form restoration and colour adaptation"
EXAMPLES = """\
  cags-bench align --json
  cags-bench align --scene procedural:size=12000,frames=36 --sizes 400x300 --ages 1,3,10 --json
  cags-bench align --scene ../shared/scenes/guitar/guitar.compressed.ply --sizes 1600x1200 --views 2 --json
  cags-bench align --scene capture.ply --poses walk.csv --errors predicted --lpips lpips_alex.npz --json
  cags-bench align --device cuda --sizes 1600x1200 --repetitions 20 --json
"""


@dataclass(frozen=True)
class AlignBenchSettings(Conditions):
    """What is measured."""

    scene: str = setting("procedural:size=60000", "scene: a file, a folder, motion:PATH, procedural[:..] or fourd[:..]")
    ages: str = setting(
        "", "instead: a moving scene at the first size with references this many media frames old, such as 1,3,10"
    )

    device: str = setting(
        "",
        "instead: the times of the paper's client table (render, PRPA, networks) on this device",
        choices=("", "cpu", "cuda"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.age_list  # noqa: B018 - refuse what does not parse now

    @property
    def age_list(self) -> list[int]:
        """Media frames, each once, rising."""
        if not self.ages:
            return []
        if re.fullmatch(r"[1-9]\d{0,2}(,[1-9]\d{0,2})*", self.ages) is None:
            raise ConfigError(f"ages {self.ages!r} must be whole numbers from 1 to 999, such as 1,3,10")
        return sorted({int(part) for part in self.ages.split(",")})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the subcommand."""
    add_settings(parser, AlignBenchSettings)


def run(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line a case, then a summary with its checks. Raises :class:`CagsError`."""
    settings = load_settings(AlignBenchSettings, args)
    if settings.ages:
        from cags_bench.align.ages import measure_ages

        yield from measure_ages(settings)
        return
    if settings.device:
        from cags_bench.align.device import client_table

        yield from client_table(settings)
        return
    from cags_bench.align.measure import measure

    yield from measure(settings)
