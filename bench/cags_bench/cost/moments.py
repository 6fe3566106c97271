"""What the stages work on: moments of a real session, kept with all that made them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.seeing import Seen, see
from cags_bench.sim.session import Scenario, simulate
from cags_client.align import ReferencePicture
from cags_client.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_client.truth import BundleTruth
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.splats import Splats

MOMENTS = 3

JUDGED_LOD = 4
"""Depth of the splats that alignment and restoration are judged on: low, where there is something to put right."""


@dataclass(frozen=True, eq=False)
class Moment:
    """One displayed frame: what was sent for it, what the client drew, and what it should have seen."""

    frame: int
    camera: Camera
    reference: ReferencePicture
    """The one that was at hand, carried to this frame."""
    seen: Seen
    """What the client draws when all has come up to LoD ``JUDGED_LOD``."""
    truth: F32  # [H, W, 3] in [0, 1]
    truth_alpha: F32  # [H, W]
    source: Splats


@dataclass(frozen=True)
class Workbench:
    """Moments of one session, and its bundle."""

    bundle: Path
    scenario: Scenario
    moments: tuple[Moment, ...]

    @property
    def moment(self) -> Moment:
        """The middle one."""
        return self.moments[len(self.moments) // 2]


def capture(bundle: Path, width: int, height: int, trace: str, poses: str) -> Workbench:
    """Play ``bundle`` in virtual time and keep a few moments at which a reference was at hand.

    Raises :class:`ConfigError` where the link brings everything at once, so that nothing is ever restored.
    """
    scenario = Scenario(bundle, trace, poses, client=ClientSettings(width=width, height=height), scored=False)
    kept: list[PresentedFrame] = []

    def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
        if presented.aligned is not None:
            kept.append(presented)

    simulate(scenario, watch)
    if not kept:
        raise ConfigError(
            f"trace = {trace!r}: all of the scene arrives at once and no reference is used; name a slower"
        )
    chosen = kept[len(kept) // 4 :: max(len(kept) // (MOMENTS + 1), 1)][:MOMENTS]
    truth = BundleTruth(str(bundle), replace(scenario.client, exactness="exact"))
    reader = BundleReader.open(str(bundle))
    decoder = BundlePlayer(reader, min(JUDGED_LOD, reader.manifest.lods - 1))
    rasteriser = raster.create("auto")
    moments = []
    for presented in chosen:
        reference = presented.reference
        assert reference is not None
        rgb, alpha = truth(presented.frame, presented.camera)
        source = reader.source(presented.frame).splats
        then, seen = (
            see(rasteriser.load(decoder.frame(frame).splats), presented.camera)
            for frame in (reference.frame, presented.frame)
        )
        reference = seen.carried(reference, then, presented.frame)
        moments.append(Moment(presented.frame, presented.camera, reference, seen, rgb.clip(0, 1), alpha, source))
    reader.close()
    return Workbench(bundle, scenario, tuple(moments))
