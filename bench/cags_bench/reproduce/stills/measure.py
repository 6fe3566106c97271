"""What a first frame looks like from a few views, by every way to code it: units of work beside the sessions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import mean
from typing import Any

import numpy as np

from cags_bench.jsonl import JsonObject
from cags_bench.reproduce.cache import content_of
from cags_bench.reproduce.cases import Encoding, Runner, scene_key
from cags_bench.reproduce.stills.flat import CONFIGS, quantised
from cags_bench.seeing import see
from cags_client.frame import restore
from cags_client.frame.align import ReferencePicture
from cags_client.frame.restore import RestoreInput
from cags_client.settings import ClientSettings
from cags_common import correction, raster
from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import dequantise_tiles
from cags_common.bundle.player import BundlePlayer
from cags_common.correction import Reference
from cags_common.geometry import F32, Camera
from cags_common.lpips import Lpips
from cags_common.metrics import psnr, ssim
from cags_common.poses import Focus, open_poses
from cags_common.raster.base import Footprint, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.dequantise import Dequantiser
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import decode_base
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from cags_encoder import EncodeSettings
from cags_encoder.formats.sog import parse_sog_bytes
from cags_encoder.formats.sog_writer import sog_bytes
from cags_encoder.formats.spz import parse_spz, spz_bytes

VIEWS = 4
WINDOW_US = 4_000_000
"""Part of the walk that the views are spread over."""

DEFAULT = EncodeSettings().quantiser

SPZ, SOG = "SPZ", "SOG"
FORMATS: dict[str, tuple[Callable[[Splats], bytes], Callable[[bytes], Splats]]] = {
    SPZ: (spz_bytes, lambda data: parse_spz(data, "spz")),
    SOG: (sog_bytes, lambda data: parse_sog_bytes(data, "sog")),
}
"""Other formats, written and read by this program."""


@dataclass(frozen=True)
class StillCase:
    """One measurement on the first frame of a scene."""

    kind: str
    """One of :data:`KINDS`."""
    scene: str
    poses: str
    width: int
    height: int
    steps: int = 0
    """About how many levels of a ladder are measured; 0: all."""
    lpips: str = ""

    @property
    def encodings(self) -> tuple[Encoding, ...]:
        """See :class:`cags_bench.reproduce.cases.Work`."""
        return tuple(encoding(self.scene, name) for name in KINDS[self.kind].quantisers)

    def key(self, device: str) -> JsonObject:
        """What the result depends on, files by their content."""
        return {
            "still": asdict(self) | {"poses": content_of(self.poses), "lpips": content_of(self.lpips)},
            "scenes": [scene_key(one) for one in self.encodings],
            "device": device,
        }

    def compute(self, runner: Runner) -> JsonObject:
        """The measurement."""
        stills = Stills.of(runner, self)
        return {"result": KINDS[self.kind].measure(runner, self, stills)}

    def __str__(self) -> str:
        return f"{self.scene}, {self.kind}"


def encoding(scene: str, quantiser: str) -> Encoding:
    """The first frame of ``scene``."""
    # A measured order ends at the last visible level; tables of the paper's quantisers show every level.
    order = "measured" if quantiser == DEFAULT else "paper"
    return Encoding(scene, EncodeSettings(frames=1, quantiser=quantiser, lod_order=order))


@dataclass(frozen=True)
class Stills:
    """Views of a first frame: the truth, and cameras to judge from."""

    source: Splats
    cameras: tuple[Camera, ...]
    truths: tuple[F32, ...]
    device: str

    @staticmethod
    def of(runner: Runner, case: StillCase) -> Stills:
        """The first frame of the case's scene, seen along its walk."""
        reader = BundleReader.open(str(runner.bundle(case.encodings[0])))
        manifest, source = reader.manifest, reader.source(0).splats
        reader.close()
        focus = Focus(manifest.focus_centre, manifest.focus_radius, manifest.up)
        walk = open_poses(case.poses, focus, window_us=WINDOW_US)
        client = ClientSettings(width=case.width, height=case.height).intrinsics
        cameras = tuple(Camera(client, walk.pose_at(i * WINDOW_US // VIEWS), manifest.near) for i in range(VIEWS))
        loaded = raster.create(runner.device).load(source)
        truths = tuple(loaded.render(camera, RenderOptions()).rgb.clip(0, 1) for camera in cameras)
        return Stills(source, cameras, truths, runner.device)

    def views(self, splats: Splats) -> list[F32]:
        """The splats from every camera."""
        scene = raster.create(self.device).load(splats)
        return [scene.render(camera, RenderOptions()).rgb.clip(0, 1) for camera in self.cameras]

    def quality(self, splats: Splats, lpips: Lpips | None = None) -> JsonObject:
        """PSNR of each view; mean SSIM and LPIPS."""
        pairs = list(zip(self.views(splats), self.truths, strict=True))
        return {
            "psnr_db": [psnr(view, truth) for view, truth in pairs],
            "ssim": mean(ssim(view, truth) for view, truth in pairs),
            "lpips": mean(lpips.distance(view, truth) for view, truth in pairs) if lpips else None,
        }


def _levels(reader: BundleReader, steps: int) -> list[int]:
    top = reader.manifest.lods - 1
    return sorted({*range(0, top + 1, max(1, (top + 1) // steps) if steps else 1), top})


def _size(reader: BundleReader, lod: int) -> int:
    """Bytes of the first frame up to ``lod``."""
    return sum(sum(tile.lod_bytes[: lod + 1]) for tile in reader.frame(0).tiles)


def _svq(runner: Runner, case: StillCase, stills: Stills) -> list[JsonObject]:
    """The highest level of each configuration, and other formats."""
    lpips = Lpips(case.lpips) if case.lpips else None
    out = []
    for one in case.encodings:
        with BundleReader.open(str(runner.bundle(one))) as reader:
            decoded = BundlePlayer(reader).frame(0).splats
            size = _size(reader, reader.manifest.lods - 1)
        out.append({"codec": one.settings.quantiser, "bytes": size, **stills.quality(decoded, lpips)})
    for name, (write, read) in FORMATS.items():
        data = write(stills.source)
        out.append({"codec": name, "bytes": len(data), **stills.quality(read(data), lpips)})
    return [line | {"splats": len(stills.source)} for line in out]


def _ladder(runner: Runner, case: StillCase, stills: Stills) -> list[JsonObject]:
    """Quality against size as LoDs are added in their order."""
    out = []
    for one in case.encodings:
        with BundleReader.open(str(runner.bundle(one))) as reader:
            for lod in _levels(reader, case.steps):
                found = stills.quality(BundlePlayer(reader, lod).frame(0).splats)
                size = _size(reader, lod) / len(stills.source)
                out.append({"quantiser": one.settings.quantiser, "lod": lod, "bytes_a_splat": size, **found})
    return out


def _layers(runner: Runner, case: StillCase, stills: Stills) -> list[JsonObject]:
    """Each attribute decoded with more layers while the others are whole."""
    out: list[JsonObject] = []
    with BundleReader.open(str(runner.bundle(case.encodings[0]))) as reader:
        books = CodebookSet.from_bytes(reader.codebooks())
        for attribute in dict.fromkeys(item.attribute for item in reader.manifest.lod_order):
            own = [item for item in reader.manifest.lod_order if item.attribute == attribute]
            for depth in range(len(own) + 1):
                size, shown = _without(reader, books, own[depth:])
                figures = {"bytes_a_splat": size / len(stills.source), **stills.quality(shown)}
                out.append({"attribute": attribute, "layers": depth, **figures})
    return out


def _without(reader: BundleReader, books: CodebookSet, left_out: Sequence[LodLayer]) -> tuple[int, Splats]:
    """Bytes and splats when these layers are not sent."""
    tiles, size, dequantiser = [], 0, Dequantiser(books)
    for entry in reader.frame(0).tiles:
        if entry.kind is not TileKind.LOOKS:
            continue
        base = reader.payload(0, entry.tile, 0)
        state = TileState(decode_base(base, books), dequantiser, reader.manifest.lod_order)
        size += len(base)
        for lod, item in enumerate(reader.manifest.lod_order, start=1):
            if item not in left_out:
                payload = reader.payload(0, entry.tile, lod)
                state.add_layer(lod, payload)
                size += len(payload)
        tiles.append(state)
    return size, dequantise_tiles(tiles, reader.manifest.sh_degree)


UPSAMPLED, SUPER_RESOLVED = "reference upsampled", "reference super-resolved (network)"
DISTORTED, RECOLOURED = "distorted", "colours restored (network)"
EXAMPLE, OURS = "by example (the paper's network)", "by example (ours)"
WAYS = (UPSAMPLED, SUPER_RESOLVED, DISTORTED, RECOLOURED, EXAMPLE, OURS)
NETWORKS = {SUPER_RESOLVED: "sr-align-ref", RECOLOURED: "cr-no-ref", EXAMPLE: "srresnet"}


def _motivation(runner: Runner, case: StillCase, stills: Stills) -> list[JsonObject]:
    """PSNR of every view, by flat quantiser and by what is shown."""
    examples = [_example(stills, *view) for view in zip(stills.cameras, stills.truths, strict=True)]
    networks = {way: restore.create(name, threads=runner.threads) for way, name in NETWORKS.items()}
    out = []
    for number, config in enumerate(CONFIGS, start=1):
        flat = quantised(stills.source, config)
        out.append(
            {
                "config": number,
                "bytes_a_splat": flat.bytes / len(stills.source),
                "codebook_bytes": flat.codebook_bytes,
                "lossless": list(flat.lossless),
                "psnr_db": _ways(stills, flat.splats, examples, networks),
            }
        )
    return out


@dataclass(frozen=True)
class Example:
    """What is known of a view before any splats arrive."""

    camera: Camera
    truth: F32
    reference: Reference
    enlarged: F32
    """The reference at the client's size."""


def _example(stills: Stills, camera: Camera, truth: F32) -> Example:
    """A picture of 400x300 for the exact pose, as in the paper."""
    import cv2

    small = replace(camera, intrinsics=camera.intrinsics.resized(400, 300))
    footprint = Footprint.of(camera.intrinsics, small.intrinsics)
    rgb = raster.create(stills.device).load(stills.source).render(small, RenderOptions(footprint=footprint)).rgb
    reference = Reference(rgb.clip(0, 1), small, picture=True)
    size = (camera.width_px, camera.height_px)
    up: Any = cv2.resize(reference.coded, size, interpolation=cv2.INTER_LINEAR)
    return Example(camera, truth, reference, np.asarray(up, np.float32))


def _ways(
    stills: Stills, splats: Splats, examples: Sequence[Example], networks: Mapping[str, restore.Restorer]
) -> dict[str, list[float]]:
    """PSNR of each view, by way. Networks expect the mean over all views, which an encoder would have measured."""
    scene, corrector = raster.create(stills.device).load(splats), correction.create("auto")
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    views = [see(scene, one.camera) for one in examples]
    off = [np.square(seen.distorted - one.truth).mean() for seen, one in zip(views, examples, strict=True)]
    expected_db = -10 * math.log10(max(float(np.mean(off)), 1e-9))
    for seen, one in zip(views, examples, strict=True):
        aligned = seen.aligned(ReferencePicture(one.reference.coded, one.reference.camera, 0), colours=True)
        pictures = {UPSAMPLED: one.enlarged, DISTORTED: seen.distorted}
        pictures |= {
            way: net.restore(RestoreInput(seen.distorted, aligned, expected_db)) for way, net in networks.items()
        }
        pictures[OURS] = seen.corrected(one.reference, corrector).rgb
        for way, picture in pictures.items():
            found[way].append(psnr(picture, one.truth))
    return found


@dataclass(frozen=True)
class Kind:
    """A measurement, and the quantisers whose bundles it needs."""

    measure: Callable[[Runner, StillCase, Stills], list[JsonObject]]
    quantisers: tuple[str, ...]


KINDS: dict[str, Kind] = {
    "svq": Kind(_svq, ("paper-66", "paper-76", DEFAULT)),
    "ladder": Kind(_ladder, ("paper-66", DEFAULT)),
    "layers": Kind(_layers, (DEFAULT,)),
    "motivation": Kind(_motivation, (DEFAULT,)),
}
"""Measurements by name."""
