"""Inputs of the stages: moments of a real session of each scene, at one picture size."""

from __future__ import annotations

import functools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle, default_cache, identified
from cags_bench.cost.engine import BEST_DB
from cags_bench.cost.settings import CostSettings, Size
from cags_bench.sim.session import Scenario, simulate
from cags_bench.traces import link_share, scaled_trace
from cags_client.frame.presented import PresentedFrame
from cags_client.frame.restore import expected_psnr_db
from cags_client.output.truth import BundleTruth
from cags_client.settings import ClientSettings
from cags_common import metrics, raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_encoder import EncodeSettings

JUDGED_LOD = 4
"""Level of the splats for corrections: low, so that there is something to correct."""

LIKE_SPLATS = 60_000
"""Number of splats that the trace's rates are for."""

LINK_S = 60.0
"""Length of the part of the trace; it repeats."""


def psnr(picture: F32, truth: F32) -> float:
    """PSNR of a picture [H, W, 3] in dB, at most :data:`BEST_DB`."""
    return min(metrics.psnr(picture, truth), BEST_DB)


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
    expected_db: float
    """Level of the held splats, as restorers get it."""
    truth: F32  # [H, W, 3] in [0, 1]
    source: Splats

    def view(self, options: RenderOptions | None = None) -> RenderedView:
        """The client's render from its camera."""
        return self.held.render(self.camera, options or RenderOptions())


@dataclass(frozen=True)
class Workbench:
    """One of the moments of a session, and its bundle."""

    bundle: Path
    number: int
    """Number of the scene."""
    poses: str
    moments: tuple[Moment, ...]
    at: int = 0
    """Number of the moment that is measured."""

    @property
    def moment(self) -> Moment:
        """The moment that is measured."""
        return self.moments[self.at]

    @property
    def keys(self) -> tuple[Hashable, ...]:
        """Names of the moments among those of all scenes; the same for every size."""
        return tuple((self.number, at) for at in range(len(self.moments)))

    @property
    def key(self) -> Hashable:
        """Name of the moment that is measured."""
        return self.keys[self.at]

    @property
    def walk_seed(self) -> int:
        """Selects a walk for what looks at poses alone: another for each moment."""
        return self.number * 100 + self.at

    def each(self) -> Sequence[Workbench]:
        """A workbench for every moment."""
        return [replace(self, at=at) for at in range(len(self.moments))]


def bundle_of(scene: str, settings: CostSettings, encode: EncodeSettings | None = None) -> Path:
    """The encoded scene; splats are linked once for all of its encodings."""
    shipped = encode or EncodeSettings()
    folder = Path(settings.cache) if settings.cache else default_cache()
    source = functools.partial(identified, scene, settings.frames, folder / "identities")
    return cached_bundle(scene, settings.cache, replace(shipped, frames=settings.frames), progress=False, source=source)


def link_of(bundle: Path, settings: CostSettings) -> str:
    """The trace with the rates for this scene."""
    return str(scaled_trace(settings.trace, settings.share * link_share(bundle, LIKE_SPLATS), LINK_S))


def capture(settings: CostSettings, number: int, scene: str, size: Size) -> Workbench:
    """Play a scene in virtual time and keep a few moments with a reference, evenly spaced.

    Raises :class:`ConfigError` if the link is so fast that nothing is ever corrected.
    """
    bundle = bundle_of(scene, settings)
    client = ClientSettings(width=size[0], height=size[1])
    scenario = Scenario(bundle, link_of(bundle, settings), settings.poses, client=client, scored=False)
    kept: list[PresentedFrame] = []

    def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
        if presented.confidence is not None:
            kept.append(presented)

    simulate(scenario, watch)
    if not kept:
        raise ConfigError(
            f"trace = {settings.trace!r}: all of {scene} arrives at once, so no reference is used; give a slower one, "
            "or a smaller --share"
        )
    chosen = _evenly(kept, settings.moments)
    truth = BundleTruth(str(bundle), replace(client, exactness="exact"))
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
                expected_db=expected_psnr_db(held_lod, reader.manifest),
                truth=truth(frame, presented.camera)[0].clip(0, 1),
                source=source,
            )
        )
    reader.close()
    return Workbench(bundle, number, settings.poses, tuple(moments))


def _evenly(frames: Sequence[PresentedFrame], count: int) -> list[PresentedFrame]:
    """Up to ``count`` of the frames, from the middles of equal parts."""
    parts = min(count, len(frames))
    return [frames[len(frames) * (2 * part + 1) // (2 * parts)] for part in range(parts)]
