"""Inputs of the stages: moments of a real session."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.sim.session import Scenario, simulate
from cags_client.frame.presented import PresentedFrame
from cags_client.frame.restore import level_of
from cags_client.output.truth import BundleTruth
from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_common.splats import Splats

MOMENTS = 3

JUDGED_LOD = 4
"""Level of the splats for corrections: low, so that there is something to correct."""


@dataclass(frozen=True, eq=False)
class Moment:
    """One displayed frame: its cameras, the client's splats, and the true picture."""

    frame: int
    camera: Camera
    reference_camera: Camera
    """The server's prediction of the client's camera."""
    true: RasterScene
    """The unquantised splats."""
    held: RasterScene
    """The client's splats with everything up to LoD ``JUDGED_LOD``."""
    level: float
    """Level of the held splats, as restorers get it."""
    truth: F32  # [H, W, 3] in [0, 1]
    source: Splats

    def view(self, options: RenderOptions | None = None) -> RenderedView:
        """The client's render from its camera."""
        return self.held.render(self.camera, options or RenderOptions())


@dataclass(frozen=True)
class Workbench:
    """Moments of one session, and its bundle."""

    bundle: Path
    scenario: Scenario
    moments: tuple[Moment, ...]

    @property
    def moment(self) -> Moment:
        """The middle moment."""
        return self.moments[len(self.moments) // 2]


def capture(bundle: Path, width: int, height: int, trace: str, poses: str) -> Workbench:
    """Play ``bundle`` in virtual time and keep a few moments with a reference.

    Raises :class:`ConfigError` if the link is so fast that nothing is ever corrected.
    """
    scenario = Scenario(bundle, trace, poses, client=ClientSettings(width=width, height=height), scored=False)
    kept: list[PresentedFrame] = []

    def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
        if presented.confidence is not None:
            kept.append(presented)

    simulate(scenario, watch)
    if not kept:
        raise ConfigError(
            f"trace = {trace!r}: the whole scene arrives at once, so no reference is used; give a slower trace"
        )
    chosen = kept[len(kept) // 4 :: max(len(kept) // (MOMENTS + 1), 1)][:MOMENTS]
    truth = BundleTruth(str(bundle), replace(scenario.client, exactness="exact"))
    reader = BundleReader.open(str(bundle))
    held_lod = min(JUDGED_LOD, reader.manifest.lods - 1)
    decoder = BundlePlayer(reader, held_lod)
    rasteriser = raster.create("auto")
    moments = []
    for presented in chosen:
        assert presented.reference is not None
        frame, source = presented.frame, reader.source(presented.frame).splats
        moments.append(
            Moment(
                frame=frame,
                camera=presented.camera,
                reference_camera=presented.reference.camera,
                true=rasteriser.load(source),
                held=rasteriser.load(decoder.frame(frame).splats),
                level=level_of(held_lod, reader.manifest),
                truth=truth(frame, presented.camera)[0].clip(0, 1),
                source=source,
            )
        )
    reader.close()
    return Workbench(bundle, scenario, tuple(moments))
