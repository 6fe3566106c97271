"""The linear LoD order: which enhancement layer of which attribute each level adds.

LoD 0 of a tile is its ids, coarse positions and all base layers. LoD ``L >= 1`` adds ``order[L - 1]``. Levels are sent
in order, so the order decides what a limited link shows first (paper, supplement, "LoD Assignment").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cags_common.errors import BundleError

MAX_LODS = 64
"""Levels of one tile, LoD 0 included, in bundles and on the wire; the finest quantiser, ``layered-fine``, has 56."""

MAX_POSITION_LAYERS = 8
"""Bits an axis that layers of positions may add."""


POSITION = "position"
"""What layers of positions are called in an order; positions have no codebook."""


@dataclass(frozen=True, slots=True)
class LodLayer:
    """One enhancement layer; ``layer`` counts from 1 (0 is the base, which LoD 0 holds for every attribute)."""

    attribute: str
    layer: int


def depths_at(order: Sequence[LodLayer], lod: int) -> dict[str, int]:
    """Enhancement layers that each attribute has once levels 0 to ``lod`` are there; attributes without any are left
    out.
    """
    depths: dict[str, int] = {}
    for item in order[:lod]:
        depths[item.attribute] = max(depths.get(item.attribute, 0), item.layer)
    return depths


def position_layers(order: Sequence[LodLayer]) -> int:
    """Layers of positions in ``order``."""
    return depths_at(order, len(order)).get(POSITION, 0)


def check_order(order: Sequence[LodLayer], layers: Mapping[str, int]) -> None:
    """Raise :class:`BundleError` unless ``order`` holds every attribute's layers 1 to ``layers[attribute]`` once,
    ascending; of positions any number up to :data:`MAX_POSITION_LAYERS`.
    """
    seen = dict.fromkeys((*layers, POSITION), 0)
    for lod, item in enumerate(order, start=1):
        if item.attribute not in seen:
            raise BundleError(f"LoD {lod} refines attribute {item.attribute!r}, which has no codebook")
        if item.layer != seen[item.attribute] + 1:
            raise BundleError(
                f"LoD {lod} is layer {item.layer} of {item.attribute!r}, expected layer {seen[item.attribute] + 1}"
            )
        seen[item.attribute] += 1
    if seen[POSITION] > MAX_POSITION_LAYERS:
        raise BundleError(f"LoD order has {seen[POSITION]} layers of positions; at most {MAX_POSITION_LAYERS} exist")
    for attribute, count in layers.items():
        if seen[attribute] != count:
            raise BundleError(f"LoD order has {seen[attribute]} of the {count} layers of {attribute!r}")
