"""The default quantiser with one of its features removed at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cags_bench.codec.bjontegaard import bd_psnr_db
from cags_encoder import EncodeSettings
from cags_encoder.quantiser.configs import QuantiserConfig, layered, quantiser_config

Line = dict[str, Any]


@dataclass(frozen=True)
class Variant:
    """Settings of a codec for a ladder."""

    name: str
    settings: EncodeSettings
    config: QuantiserConfig
    weighted: bool = True
    """Codebooks are weighted by the contributions of splats."""
    measured: bool = True
    """The LoD order is measured on renders instead of taken from the paper."""

    @staticmethod
    def named(quantiser: str) -> Variant:
        """A shipped quantiser. Raises :class:`ConfigError`."""
        return Variant(quantiser, EncodeSettings(quantiser=quantiser), quantiser_config(quantiser))


_BITS = {a.attribute: (a.tree_bits, a.refine_bits) for a in quantiser_config("layered").attributes}


def _with(*left_out: str, **bits: tuple[int, int]) -> QuantiserConfig:
    kept = {name: spent for name, spent in _BITS.items() if name not in left_out}
    return layered("layered", {**kept, **bits})


_SHIPPED = EncodeSettings()
VARIANTS = (
    Variant("one tree of 13 bits each", _SHIPPED, _with(scale=(13, 0), rotation=(13, 0), sh0=(13, 0))),
    Variant("quaternion parts apart", _SHIPPED, _with("rotation", rotation_real=(6, 2), rotation_imag=(8, 8))),
    Variant("opacity as drawn", _SHIPPED, _with("opacity", alpha=(6, 0))),
    Variant("unweighted codebooks", _SHIPPED, _with(), weighted=False),
    Variant("the paper's LoD order", _SHIPPED, _with(), measured=False),
    Variant("positions of 14 bits", EncodeSettings(position_bits=14), _with()),
)
"""The default without one feature, named after its replacement."""


def gains(lines: Sequence[Line], scene: str, default: str) -> Iterator[Line]:
    """Gain of each feature: the default's Bjontegaard gain over the variant without it, in total bytes."""

    def curve(codec: str) -> list[tuple[float, float]]:
        return [(x["bytes"], x["psnr_db"]) for x in lines if (x.get("scene"), x.get("codec")) == (scene, codec)]

    for variant in VARIANTS:
        if curve(variant.name):
            gain = bd_psnr_db(curve(default), curve(variant.name))
            yield {"scene": scene, "instead": variant.name, "default_gains_db": gain}
