"""How a frame comes about: drawn and corrected where the splats are, in one go, or step by step.

A scene on a graphics processor makes whole frames (:class:`cags_common.correction.FrameScene`), of which nothing but
the picture to show comes back. Other scenes are rasterised, and a corrector works on the view. Both give the same
frame: within a level of 255 in all but a few pixels in ten thousand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from cags_client.stats import Stopwatch
from cags_common import correction
from cags_common.correction import Correction, FramePictures, FrameScene, Reference
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_common.raster.halving import enlarged, halved


@dataclass(frozen=True, eq=False)
class Canvas:
    """What is drawn from where, and how."""

    scene: RasterScene
    changes: int
    """Counts the scene's changes: the client's view of a picture holds until the next one."""
    display: Camera
    half: bool
    """Whether half the pixels a side are worked out."""
    options: RenderOptions

    @property
    def camera(self) -> Camera:
        """What the frame is worked out at."""
        return halved(self.display) if self.half else self.display

    @property
    def drawing(self) -> RenderOptions:
        """The options of the drawing that is shown."""
        options = replace(self.options, displayed=True)
        return replace(options, footprint=options.footprint.at_half_resolution()) if self.half else options


@dataclass(frozen=True, eq=False)
class StagedPictures:
    """The pictures of a frame that was made step by step: a :class:`~cags_common.correction.FramePictures`."""

    rgb: F32
    drawn: F32
    alpha: F32
    depth: F32 | None = None
    confidence: F32 | None = None

    @classmethod
    def of(cls, view: RenderedView, rgb: F32 | None = None, confidence: F32 | None = None) -> StagedPictures:
        """The stages of rendering ``view``; ``rgb`` is what is shown (None: the view itself)."""
        return cls(view.rgb if rgb is None else rgb, view.rgb, view.alpha, view.depth, confidence)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns that the frame was worked out at."""
        height, width = self.drawn.shape[:2]
        return height, width


class Painter:
    """Makes the frames of one client, one after the other."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._corrector = correction.create("auto", threads)
        self._compared: tuple[Reference, int] | None = None  # the picture that the corrector holds, and of which scene

    def paint(self, canvas: Canvas, given: Correction | None, watch: Stopwatch) -> FramePictures:
        """The frame, with what ``given`` says is lacking."""
        if isinstance(canvas.scene, FrameScene):
            with watch("raster"):
                display = canvas.display if canvas.half else None
                made = canvas.scene.frame(canvas.camera, canvas.drawing, given, display)
            if made is not None:
                return made
        view = self.view(canvas, watch)
        if given is None:
            return self.finished(canvas, StagedPictures.of(view), watch)
        return self.finished(canvas, self._corrected(canvas, view, given, watch), watch)

    def view(self, canvas: Canvas, watch: Stopwatch) -> RenderedView:
        """The client's own render."""
        with watch("raster"):
            return canvas.scene.render(canvas.camera, canvas.drawing)

    def finished(self, canvas: Canvas, made: StagedPictures, watch: Stopwatch) -> StagedPictures:
        """``made``, brought up to the display's size."""
        if not canvas.half:
            return made
        with watch("enlarge"):
            return replace(made, rgb=enlarged(made.rgb, canvas.display, self._threads))

    def _corrected(self, canvas: Canvas, view: RenderedView, given: Correction, watch: Stopwatch) -> StagedPictures:
        own = None
        if given.reference.picture and self._compared != (given.reference, canvas.changes):
            with watch("own"):
                own = canvas.scene.render(given.reference.camera, given.own_drawing(canvas.options)).rgb
            self._compared = given.reference, canvas.changes
        with watch("correct"):
            veto = given.veto(view, canvas.camera)
            out = self._corrector.correct(view, canvas.camera, given.reference, own, given.settings, veto=veto)
        return StagedPictures.of(view, out.rgb, out.confidence)
