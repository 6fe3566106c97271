"""Quantiser configurations by name: how each attribute is clustered, and with how many bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.errors import ConfigError
from cags_common.geometry import F32

RAW_LIMIT = 30.0
"""Largest magnitude of log scales and opacity logits; beyond exp(30) metres and 1 - 1e-13 nothing changes visibly."""

LOGIT_RANGE = (-5.6, 5.0)
"""Range of opacity logits for clustering. Below 1/255 nothing is drawn; above 0.993, where captures have logits of 20,
clusters would be wasted (measured in docs/lab/codec.md)."""

COARSE_STEP = 1.0
"""Step of positions of which further bits follow, in radii of a tile's smaller splats."""


@dataclass(frozen=True, slots=True)
class AttributeQuantiser:
    """How one attribute is clustered."""

    attribute: str
    tree_bits: int
    """Bits of the tree, which has 2**tree_bits clusters."""
    activated: bool = False
    """Whether to cluster drawn values (scale in metres, opacity in 0..1) instead of the stored logarithm or logit."""
    refine_bits: int = 0
    """Bits of the second tree, which refines the leaves of the first."""

    def to_space(self, values: F32) -> F32:
        """Values [n, dim] as clustered."""
        if self.attribute not in ("scale", "opacity"):
            return values
        if self.attribute == "opacity" and not self.activated:
            return np.clip(values, *LOGIT_RANGE)
        raw = np.clip(values, -RAW_LIMIT, RAW_LIMIT)
        if not self.activated:
            return raw
        return np.exp(raw) if self.attribute == "scale" else (1.0 / (1.0 + np.exp(-raw))).astype(np.float32)

    def from_space(self, points: F32) -> F32:
        """Inverse of :meth:`to_space`."""
        if not self.activated:
            return points
        wide = points.astype(np.float64)
        if self.attribute == "scale":
            raw = np.log(np.maximum(wide, np.exp(-RAW_LIMIT)))
        else:
            inside = np.clip(wide, 1e-13, 1 - 1e-13)
            raw = np.log(inside / (1.0 - inside))
        return raw.astype(np.float32)


@dataclass(frozen=True, slots=True)
class QuantiserConfig:
    """One way to quantise all attributes."""

    name: str
    attributes: tuple[AttributeQuantiser, ...]
    as_printed: bool = False
    """Whether to use k-means and merging by the paper's distance instead of splitting."""
    base_bits: int = 4
    """Bits of the base layer."""
    layer_bits: int = 2
    """Bits of the largest enhancement layer."""
    position_step: float = 0.125
    """Step of positions, in radii of a tile's smaller splats."""
    coarse_step: float | None = None
    """Their step in LoD 0, if further bits are levels of their own."""


def _paper(name: str, bits: tuple[int, ...]) -> QuantiserConfig:
    names = ("scale", "rotation_real", "rotation_imag", "opacity", "sh0", "sh1", "sh2", "sh3")
    activated = {"scale", "opacity"}
    parts = [AttributeQuantiser(a, b, a in activated) for a, b in zip(names, bits, strict=True)]
    return QuantiserConfig(name, tuple(parts), as_printed=True)


def layered(name: str, bits: dict[str, tuple[int, int]], position_step: float = 0.125) -> QuantiserConfig:
    """A configuration of our own: attribute -> (tree bits, refinement bits)."""
    parts = tuple(AttributeQuantiser(a, tree, False, more) for a, (tree, more) in bits.items())
    return QuantiserConfig(name, parts, position_step=position_step, coarse_step=COARSE_STEP)


# One code per splat and attribute, as in the paper's text; the authors' code has one SH code per colour channel.
# The paper does not say where the ten additional bits of the second configuration go: geometry gets most of them here.
_CONFIGS = {
    config.name: config
    for config in (
        layered(
            "layered",
            {
                "scale": (10, 10),
                "rotation": (10, 11),
                "opacity": (6, 4),
                "sh0": (10, 10),
                "sh1": (8, 8),
                "sh2": (8, 8),
                "sh3": (8, 8),
            },
        ),
        _paper("paper-66", (10, 8, 10, 8, 9, 8, 7, 6)),
        _paper("paper-76", (12, 9, 12, 9, 10, 9, 8, 7)),
        layered(  # as accurate as SPZ files
            "layered-fine",
            {
                "scale": (10, 12),
                "rotation": (10, 14),
                "opacity": (8, 2),
                "sh0": (10, 12),
                "sh1": (8, 12),
                "sh2": (8, 12),
                "sh3": (8, 12),
            },
            position_step=1 / 64,
        ),
    )
}


def quantiser_config(name: str) -> QuantiserConfig:
    """The configuration of this name. Raises :class:`ConfigError`."""
    try:
        return _CONFIGS[name]
    except KeyError:
        raise ConfigError(f"quantiser = {name!r} is unknown; known: {', '.join(_CONFIGS)}") from None
