"""One frame as a client sees it: drawn, aligned and restored by the product's own parts, outside of any session."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cags_client import align
from cags_client.align import Aligned, Aligner, ReferencePicture
from cags_client.carry import carried
from cags_client.restore import RestoreInput, Restorer
from cags_common.geometry import F32, Camera
from cags_common.raster.base import Footprint, RasterScene, RenderedView, RenderOptions


@dataclass(frozen=True, eq=False)
class Seen:
    """The client's own splats from one camera."""

    scene: RasterScene
    camera: Camera
    view: RenderedView

    @property
    def distorted(self) -> F32:
        """[H, W, 3] in [0, 1]: what is shown without restoration."""
        return self.view.rgb.clip(0, 1)

    @property
    def depth(self) -> F32:
        """[H, W] camera-space z."""
        assert self.view.depth is not None
        return self.view.depth

    def aligned(self, reference: ReferencePicture, aligner: Aligner | None = None, *, colours: bool = False) -> Aligned:
        """``reference`` brought to this view, its ``colours`` at once or when they are looked at."""
        return (aligner or align.create("auto")).align(reference, self.depth, self.camera, colours=colours)

    def inputs(self, reference: ReferencePicture, aligned: Aligned) -> RestoreInput:
        """What a restorer gets: the client's own splats from the reference's camera are drawn for it."""
        return RestoreInput(self.distorted, self.view.alpha, aligned, reference, self.own(reference))

    def own(self, reference: ReferencePicture) -> RenderedView:
        """The client's own splats from the reference's camera, drawn as the server draws references."""
        footprint = Footprint.of(self.camera.intrinsics, reference.camera.intrinsics)
        return self.scene.render(reference.camera, RenderOptions(footprint=footprint, contribution=True))

    def carried(self, reference: ReferencePicture, then: Seen, frame: int) -> ReferencePicture:
        """``reference`` as it would look at ``frame``; ``then`` is what the client drew at the reference's own."""
        if reference.frame == frame:
            return reference
        before, now = (view.own(reference).rgb.clip(0, 1) for view in (then, self))
        return replace(reference, rgb=carried(reference.rgb, before, now, frame - reference.frame))

    def restored(self, reference: ReferencePicture, restorer: Restorer) -> F32:
        """The picture that is shown."""
        return restorer.restore(self.inputs(reference, self.aligned(reference)))


def see(scene: RasterScene, camera: Camera, options: RenderOptions | None = None) -> Seen:
    """Draw the splats that a client holds."""
    return Seen(scene, camera, scene.render(camera, options or RenderOptions()))


def available_restorers() -> list[str]:
    """Restorers that can run here, cheapest first: networks without weights are left out."""
    from cags_client import restore
    from cags_common.errors import ConfigError

    names = []
    for name in restore.RESTORERS:
        try:
            restore.create(name)
        except ConfigError:
            continue
        names.append(name)
    return names
