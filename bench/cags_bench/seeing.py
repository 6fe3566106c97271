"""One frame as a client shows it, outside of any session: drawn, corrected or restored by the product's own parts."""

from __future__ import annotations

from dataclasses import dataclass

from cags_client.frame import align
from cags_client.frame.align import Aligned, Aligner, ReferencePicture
from cags_client.frame.restore import RestoreInput, Restorer
from cags_common import correction
from cags_common.correction import Corrected, Corrector, Reference
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions


@dataclass(frozen=True, eq=False)
class Seen:
    """The client's own splats from one camera."""

    scene: RasterScene
    camera: Camera
    view: RenderedView

    @property
    def distorted(self) -> F32:
        """[H, W, 3] in [0, 1]: the picture without a reference."""
        return self.view.rgb.clip(0, 1)

    @property
    def depth(self) -> F32:
        """[H, W] camera-space z."""
        assert self.view.depth is not None
        return self.view.depth

    def own(self, camera: Camera) -> F32:
        """The client's splats from a reference's ``camera`` [h, w, 3], drawn as the server draws references."""
        footprint = Footprint.of(self.camera.intrinsics, camera.intrinsics)
        return self.scene.render(camera, RenderOptions(footprint=footprint, depth=DepthKind.NONE)).rgb

    def corrected(self, reference: Reference, corrector: Corrector | None = None) -> Corrected:
        """The displayed picture after correction by ``reference``."""
        corrector = corrector or correction.create("auto")
        own = self.own(reference.camera) if corrector.needs_own(reference) else None
        return corrector.correct(self.view, self.camera, reference, own)

    def aligned(self, picture: ReferencePicture, aligner: Aligner | None = None, *, colours: bool = False) -> Aligned:
        """``picture`` aligned to this view; its ``colours`` are computed at once or on demand."""
        return (aligner or align.create("fast")).align(picture, self.depth, self.camera, colours=colours)

    def restored(self, picture: ReferencePicture, restorer: Restorer, expected_db: float) -> F32:
        """The picture [H, W, 3] in [0, 1] of a client that restores with an aligned picture."""
        return restorer.restore(RestoreInput(self.distorted, self.aligned(picture), expected_db))


def see(scene: RasterScene, camera: Camera, options: RenderOptions | None = None) -> Seen:
    """Draw a client's splats."""
    return Seen(scene, camera, scene.render(camera, options or RenderOptions()))


def available_restorers() -> list[str]:
    """Restorers of aligned pictures that can run here, cheapest first; networks without weights are left out."""
    from cags_client.frame import restore
    from cags_common.errors import ConfigError

    names = []
    for name in restore.RESTORERS.names():
        try:
            restore.create(name)
        except ConfigError:
            continue
        names.append(name)
    return names
