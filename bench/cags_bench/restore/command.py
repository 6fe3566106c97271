"""``cags-bench restore``: quality and time of every restorer over LoDs and pose errors."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cags_common.errors import ConfigError
from cags_common.settings import add_settings, check_settings, load_settings, setting

SUMMARY = "Measure restorers, the paper's baselines and ablations on one scene: PSNR, SSIM, LPIPS and milliseconds."

EXAMPLES = """\
  cags-bench restore --json
  cags-bench restore --scene capture.ply --sizes 1600x1200 --lods 0,0.5,1 --errors 0/0,5/20
  cags-bench restore --methods affine,lite,lite@openvino --threads 2 --repetitions 9"""

METHODS = "none,reference,affine,lite,srresnet,sr-align-ref,cr-no-ref,affine without PRPA,affine without erosion,paper"


@dataclass(frozen=True)
class RestoreBenchSettings:
    """What is measured."""

    scene: str = setting("procedural:size=60000,seed=3", "scene: a file, a folder, motion:PATH or procedural[:..]")
    sizes: str = setting("800x600,1600x1200", "client pictures, comma-separated WIDTHxHEIGHT")
    lods: str = setting("0,0.25,0.5,1", "depths of all tiles as shares of the LoD ladder")
    errors: str = setting("0/0,2/10,5/20", "pose errors of the reference, DEGREES/CENTIMETRES")
    methods: str = setting(METHODS, "restorers (NAME or NAME@RUNTIME), ablations and 'paper'")
    views: int = setting(2, "moments of a synthetic walk", low=1, high=1000)
    margin: float = setting(0.1, "widening of the reference's field of view", low=0, high=2)
    crf: float = setting(20.0, "H.264 crf of references", low=0, high=51)
    fov: float = setting(60.0, "client's horizontal field of view in degrees", low=1, high=170)
    threads: int = setting(2, "threads of rasteriser and networks", low=1, high=256)
    repetitions: int = setting(3, "timed repetitions of each stage after one to warm up", low=1, high=1000)
    lpips: str = setting("", "file of LPIPS weights (.npz); empty: LPIPS is left out")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    seed: int = setting(0, "seed of directions of pose errors", low=0, high=2**31 - 1)

    def __post_init__(self) -> None:
        check_settings(self)
        self.size_list, self.lod_list, self.error_list  # noqa: B018 - refuse what does not parse now

    @property
    def size_list(self) -> list[tuple[int, int]]:
        """(width, height) in pixels."""
        return [(int(w), int(h)) for w, h in _pairs("sizes", self.sizes, "x", 16, 8192)]

    @property
    def lod_list(self) -> list[float]:
        """Shares of the ladder."""
        return [_number("lods", word, 0, 1) for word in self.lods.split(",")]

    @property
    def error_list(self) -> list[tuple[float, float]]:
        """(degrees, centimetres)."""
        return _pairs("errors", self.errors, "/", 0, 180)

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


def _pairs(name: str, text: str, mark: str, low: float, high: float) -> list[tuple[float, float]]:
    out = []
    for word in text.split(","):
        first, found, second = word.strip().partition(mark)
        if not found:
            raise ConfigError(f"{name} = {text!r}: {word!r} must be two numbers with {mark!r} between them")
        out.append((_number(name, first, low, high), _number(name, second, low, high)))
    return out


def _number(name: str, word: str, low: float, high: float) -> float:
    try:
        value = float(word)
    except ValueError:
        raise ConfigError(f"{name}: {word!r} is not a number") from None
    if not low <= value <= high:
        raise ConfigError(f"{name}: {word} must lie in [{low}, {high}]")
    return value
