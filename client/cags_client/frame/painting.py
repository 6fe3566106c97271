"""Drawing and correcting a frame, in one submission on a device or in steps.

A scene on a graphics processor makes whole frames (:class:`cags_common.correction.FrameScene`) and returns only the
displayed picture. Other scenes are rasterised, and a corrector works on the view. Both give the same frame, within one
level of 255 except in a few pixels of ten thousand.
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
    """Inputs of a frame: scene, camera and options."""

    scene: RasterScene
    changes: int
    """Number of changes of the scene; the client's render for a picture is valid until the next one."""
    display: Camera
    half: bool
    """Whether the frame is rendered at half the width and height."""
    options: RenderOptions

    @property
    def camera(self) -> Camera:
        """The camera of the render."""
        return halved(self.display) if self.half else self.display

    @property
    def drawing(self) -> RenderOptions:
        """The options of the displayed render."""
        options = replace(self.options, displayed=True)
        return replace(options, footprint=options.footprint.at_half_resolution()) if self.half else options


@dataclass(frozen=True, eq=False)
class StagedPictures:
    """The pictures of a frame made in steps; a :class:`~cags_common.correction.FramePictures`."""

    rgb: F32
    drawn: F32
    alpha: F32
    depth: F32 | None = None
    confidence: F32 | None = None

    @classmethod
    def of(cls, view: RenderedView, rgb: F32 | None = None, confidence: F32 | None = None) -> StagedPictures:
        """The pictures of a rendered ``view``; ``rgb`` is the displayed picture (None: the view itself)."""
        return cls(view.rgb if rgb is None else rgb, view.rgb, view.alpha, view.depth, confidence)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the render."""
        height, width = self.drawn.shape[:2]
        return height, width


class Painter:
    """Makes the frames of one client in sequence."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._corrector = correction.create("auto", threads)
        self._compared: tuple[Reference, int] | None = None  # the picture cached by the corrector, and its scene

    def paint(self, canvas: Canvas, given: Correction | None, watch: Stopwatch) -> FramePictures:
        """Make the frame, corrected by ``given``."""
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
        """Enlarge ``made`` to the display's size."""
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
