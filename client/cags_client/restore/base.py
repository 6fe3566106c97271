"""The restoration seam: the colour-distorted picture and the aligned reference in, the picture to show out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from cags_client.align.base import Aligned, ReferencePicture
from cags_client.restore.veil import suspicion
from cags_common.effects import Effect
from cags_common.geometry import F32
from cags_common.raster.base import RenderedView

ALIGNED = frozenset({Effect.ALIGNMENT, Effect.EROSION})
COMPARED = frozenset({Effect.ALIGNMENT, Effect.OWN_VIEW})
"""What restorers need: the aligned colours, or where pixels lie in the reference and the client's own view of it."""


@dataclass(frozen=True, eq=False)
class RestoreInput:
    """What a restorer sees of one frame."""

    distorted: F32  # [H, W, 3] in [0, 1]: the client's own render, premultiplied over black
    alpha: F32  # [H, W] in [0, 1]
    aligned: Aligned
    reference: ReferencePicture
    """As it came, for restorers that work at its resolution."""
    own: RenderedView | None = None
    """The client's own splats seen from the reference's camera through the client's footprint [h, w]."""
    contribution: F32 | None = None
    """Each splat's compositing weights summed over a view like ``own`` [N], for an ``own`` that was drawn without."""
    expected: F32 | None = None
    """What may be wrong in ``own``, as a share of the lowest LoD's error [h, w]; None: anything anywhere."""

    @property
    def veil(self) -> float:
        """How likely it is, in [0, 1], that one splat close to a camera veils a view; 1 where nobody can tell."""
        if self.own is None:
            return 1.0
        contribution = self.contribution if self.own.contribution is None else self.own.contribution
        return suspicion(contribution, self.own.alpha.size)

    def afresh(self) -> RestoreInput:
        """The same, for timing: a restorer that keeps what it made of an own view makes it again."""
        return self if self.own is None else replace(self, own=replace(self.own))


class Restorer(Protocol):
    """Colour restoration. Where ``aligned.confidence`` is 0 the reference says nothing about a pixel."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    @property
    def needs(self) -> frozenset[Effect]:
        """What it looks at: alignment, erosion (of aligned colours), own-view. Nothing: it shows what it is given."""
        ...

    def restore(self, inputs: RestoreInput) -> F32:
        """The picture to show, [H, W, 3] float32, finite, in [0, 1]. The inputs are not changed."""
        ...
