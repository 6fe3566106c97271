"""Stages of the codec: precision of positions, quantiser, training sample, and number of layers."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench, psnr
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RasterScene, RenderOptions
from cags_common.splats import Splats
from cags_encoder import EncodeSettings, encode
from cags_encoder.pipeline import SplatSequence
from cags_encoder.quantiser.configs import quantiser_config
from cags_encoder.settings import QUANTISERS

SPLATS = 20_000
"""Codec stages encode at most this many splats (every n-th of the scene); results are per splat."""

COSTS = ("bytes_per_splat",)


@dataclass(frozen=True)
class Coder:
    """Encodes one key frame and measures the result."""

    splats: Splats
    bench: Workbench
    folder: Path

    def encode(self, settings: EncodeSettings) -> Path:
        """The bundle of the key frame."""
        out = self.folder / "bundle"
        shutil.rmtree(out, ignore_errors=True)
        encode(SplatSequence((self.splats,)), settings, str(out))
        return out

    def judge(self, bundle: Path) -> list[Outcome]:
        """Bytes a splat and quality of the decoded key frame with all layers, for each moment."""
        reader = BundleReader.open(str(bundle))
        try:
            sizes = [sum(tile.lod_bytes) for tile in reader.frame(0).tiles]
            decoded = BundlePlayer(reader).frame(0).splats
        finally:
            reader.close()
        return self.outcomes(sum(sizes), decoded)

    def outcomes(self, size_bytes: int, decoded: Splats) -> list[Outcome]:
        """Bytes a splat, and PSNR of the decoded splats' picture against that of the originals, for each moment."""
        rasteriser = raster.create("auto")
        truth, seen = rasteriser.load(self.splats), rasteriser.load(decoded)
        return [
            {
                "bytes_per_splat": size_bytes / len(self.splats),
                "psnr_db": psnr(*self._views(seen, truth, moment.camera)),
            }
            for moment in self.bench.moments
        ]

    @staticmethod
    def _views(seen: RasterScene, truth: RasterScene, camera: Camera) -> tuple[F32, F32]:
        return seen.render(camera, RenderOptions()).rgb, truth.render(camera, RenderOptions()).rgb


def coding_stages(bench: Workbench, scratch: Path) -> list[Stage]:
    """Encoder settings on the moment's key frame, and decoding by number of layers, seen from all moments' cameras.

    Bundles are written to a new folder in ``scratch``.
    """
    source, shipped = bench.moment.source, EncodeSettings()
    folder = Path(tempfile.mkdtemp(dir=scratch))
    coder = Coder(source.take(slice(None, None, max(1, len(source) // SPLATS))), bench, folder)
    quantisers = [(name, replace(shipped, quantiser=name)) for name in QUANTISERS]
    own = shipped.position_step or quantiser_config(shipped.quantiser).position_step
    steps = [
        (f"1/{round(1 / step)}", shipped if step == own else replace(shipped, position_step=step))
        for step in sorted({1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, own}, reverse=True)
    ]
    sizes = sorted({1024, 4096, 16_384, shipped.train_splats})
    samples = [(str(n), replace(shipped, train_splats=n)) for n in sizes]
    return [
        _encoding(coder, "positions", "step in splat radii", steps, shipped),
        _encoding(coder, "quantiser", "configuration", quantisers, shipped),
        _encoding(coder, "codebook training", "sample, splats", samples, shipped),
        _depth(coder),
    ]


def _encoding(
    coder: Coder, name: str, knob: str, choices: list[tuple[str, EncodeSettings]], shipped: EncodeSettings
) -> Stage:
    def run_of(settings: EncodeSettings) -> Callable[[], Path]:
        return lambda: coder.encode(settings)

    points = tuple(Point(label, run_of(s), coder.judge, default=s == shipped) for label, s in choices)
    return Stage(
        name, knob, "encoder", "psnr_db", points, costs=COSTS, sized=False, moments=coder.bench.keys, warm=False
    )


def _depth(coder: Coder) -> Stage:
    bundle = coder.encode(EncodeSettings())
    kept = bundle.with_name("kept")
    bundle.rename(kept)
    reader = BundleReader.open(str(kept))
    top = len(reader.manifest.lod_order)

    def point(share: float) -> Point:
        lod = round(top * share)

        def run() -> Splats:
            return BundlePlayer(reader, lod).frame(0).splats

        def judge(decoded: Splats) -> list[Outcome]:
            sizes = [sum(tile.lod_bytes[: lod + 1]) for tile in reader.frame(0).tiles]
            return coder.outcomes(sum(sizes), decoded)

        label = {0.0: "base alone", 1.0: "all"}.get(share, f"{share:.0%} of the layers")
        return Point(label, run, judge, default=share == 1)

    points = tuple(map(point, (0.0, 0.25, 0.5, 0.75, 1.0)))
    return Stage("decoding", "LoD", "client", "psnr_db", points, costs=COSTS, sized=False, moments=coder.bench.keys)
