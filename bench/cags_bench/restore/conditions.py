"""Under what conditions restoration is measured: ``cags-bench restore`` and ``cags-bench align`` share these."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting

PREDICTED = (math.nan, math.nan)
"""The pose error of a reference whose pose the server's predictor guesses along the walk."""

REFERENCES = ("footprint", "plain", "2x", "full")


@dataclass(frozen=True)
class Conditions:
    """Scene, pictures, depths of the ladder, and references."""

    scene: str = setting(
        "procedural:size=60000,seed=3", "scene: a file, a folder, motion:PATH, procedural[:..] or fourd[:..]"
    )
    poses: str = setting("synthetic:walking:seed=1", "head motion: a recorded walk's CSV file or synthetic:NAME")
    sizes: str = setting("800x600,1600x1200", "client pictures, comma-separated WIDTHxHEIGHT")
    lods: str = setting("0,0.25,0.5,1", "depths of all tiles as shares of the LoD ladder")
    errors: str = setting(
        "0/0,2/10,5/0,5/20",
        "pose errors of the reference, DEGREES/CENTIMETRES, or 'predicted': by the server's predictor along the walk",
    )
    references: str = setting(
        "footprint",
        "how references are drawn: footprint (shipped), plain (the paper), 2x or full (averaged down from twice the "
        "pixels a side, or from the client's own); comma-separated",
    )
    views: int = setting(2, "moments of the walk", low=1, high=1000)
    margin: float = setting(0.1, "widening of the reference's field of view", low=0, high=2)
    crf: float = setting(20.0, "H.264 crf of references", low=0, high=51)
    history: int = setting(
        0, "references of the walk before this one that the adapter has learnt from, 100 ms apart", low=0, high=100
    )
    fov: float = setting(60.0, "client's horizontal field of view in degrees", low=1, high=170)
    threads: int = setting(2, "threads of rasteriser and networks", low=1, high=256)
    repetitions: int = setting(
        3, "timed repetitions of each stage after one to warm up; 0: time the warm-up", low=0, high=1000
    )
    lpips: str = setting("", "file of LPIPS weights (.npz); empty: LPIPS is left out")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    seed: int = setting(0, "seed of directions of pose errors", low=0, high=2**31 - 1)

    def __post_init__(self) -> None:
        check_settings(self)
        self.size_list, self.lod_list, self.error_list, self.reference_list  # noqa: B018 - refuse what does not parse

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
        """(degrees, centimetres), or :data:`PREDICTED`."""
        words = [word.strip() for word in self.errors.split(",")]
        return [PREDICTED if word == "predicted" else _pairs("errors", word, "/", 0, 180)[0] for word in words]

    @property
    def reference_list(self) -> list[str]:
        """Of :data:`REFERENCES`."""
        words = [word.strip() for word in self.references.split(",")]
        for word in words:
            if word not in REFERENCES:
                raise ConfigError(f"references: {word!r} is unknown; known: {', '.join(REFERENCES)}")
        return words


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
        raise ConfigError(f"{name}: {word!r} is no number; give one in [{low:g}, {high:g}]") from None
    if not low <= value <= high:
        raise ConfigError(f"{name}: {word} must lie in [{low:g}, {high:g}]")
    return value
