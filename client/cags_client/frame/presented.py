"""One displayed frame, as sinks and scores see it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cags_client.frame.align import Aligned
from cags_client.store.references import Received
from cags_common.correction import FramePictures
from cags_common.geometry import F32, Camera
from cags_common.passes import Pass, PassPlan
from cags_common.raster.halving import enlarged

PIXEL_STAGES = ("raster", "correct", "align", "restore", "enlarge")
"""Stages whose time is one of pixels."""

THREADS = 1
"""Of pictures that are brought up for those who look at them, beside the display."""


@dataclass(frozen=True, eq=False)
class PresentedFrame:
    """One displayed frame and how it came about."""

    frame: int
    camera: Camera
    pictures: FramePictures
    """What is shown, and what it was made of: looked at through the properties below."""
    aligned: Aligned | None
    """The aligned picture [h, w] that a restorer worked with; None where there was none."""
    reference: Received | None
    """The reference at hand, whether or not the frame's effects use it."""
    lod_mean: float
    """Mean LoD of the splats in view; NaN where none is held."""
    missed: bool
    """The frame's own data had not all come: something older is shown."""
    stages_ms: dict[str, float]
    effects: PassPlan
    """What was done for this frame, and by that what was left out."""
    buffer_ms: float = 0.0
    """Media that has come whole and is not yet due: how long the link may fail unseen."""
    share: float = 0.0
    """Media frames after ``frame``, where it is a picture between two of them."""
    tier: str = "none"
    """What is done with references, whether or not the frame's effects needed it."""

    @property
    def rgb(self) -> F32:
        """[H, W, 3] in [0, 1]: what is shown."""
        return self.pictures.rgb

    @property
    def drawn(self) -> F32:
        """[h, w, 3] in [0, 1]: the client's own render, of the display's size or of half of it."""
        return self.pictures.drawn

    @property
    def alpha(self) -> F32:
        """[h, w] in [0, 1]: of the client's own render."""
        return self.pictures.alpha

    @property
    def depth(self) -> F32 | None:
        """[h, w] camera-space z; +inf where void. None where nothing needed it."""
        return self.pictures.depth

    @property
    def confidence(self) -> F32 | None:
        """[h, w] in [0, 1]: how much of what the reference says was used; None where none was."""
        return self.pictures.confidence

    @property
    def corrected(self) -> bool:
        """Whether the reference was used."""
        return Pass.CORRECTION in self.effects or self.aligned is not None

    @property
    def pixels_ms(self) -> float:
        """What its pixels took."""
        return sum(self.stages_ms.get(name, 0.0) for name in PIXEL_STAGES)

    @property
    def half(self) -> bool:
        """Whether it was worked out at half the pixels a side, and brought up."""
        i = self.camera.intrinsics
        return self.pictures.size != (i.height_px, i.width_px)

    @cached_property
    def distorted(self) -> F32:
        """[H, W, 3]: the client's own render at the display's size. Made when it is first looked at."""
        return self._whole(self.drawn)

    @cached_property
    def aligned_rgb(self) -> F32 | None:
        """[H, W, 3]: the aligned picture at the display's size. Made when it is first looked at."""
        return None if self.aligned is None else self._whole(self.aligned.rgb)

    @property
    def correction(self) -> F32 | None:
        """[H, W, 3] in [0, 1]: what the reference changed in the picture, half of it around grey; None: nothing."""
        if not self.corrected:
            return None
        return np.asarray((self.rgb - self.distorted) / 2 + 0.5, np.float32)

    def _whole(self, picture: F32) -> F32:
        return picture if picture.shape == self.rgb.shape else enlarged(picture, self.camera, THREADS)
