"""The bundle's manifest: what a player must know before the first tile, as JSON with a version.

The public part is what a server sends to a client in its welcome; the rest (:attr:`Manifest.gofs`) says where bytes
lie.
"""

from __future__ import annotations

import json
from bisect import bisect_right
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

from cags_common.bundle.fields import Fields
from cags_common.bundle.tracks import MAX_LIFE_CLASSES, ChangedShares, TrackStatistics
from cags_common.bundle.view import AuthorView
from cags_common.errors import BundleError
from cags_common.geometry import DEFAULT_NEAR, Vec3
from cags_common.splats import MAX_SPLATS
from cags_common.tiles.lod import MAX_LODS, LodLayer
from cags_common.tiles.svq import MAX_BASE_BITS

FORMAT = "cags-bundle"
VERSION = 9
MAX_MANIFEST_BYTES = 16 * 2**20
MAX_FRAMES = 1_000_000
MAX_LAGS = 64

MAX_WHOLE_SPLATS = 1 << 20
"""Largest sum of :attr:`Manifest.capacity` of a clip that decoders keep whole."""

MAX_LENGTH = 1e12
"""Largest radius of the focus and largest unit of motion, world units."""


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of a group of frames: name inside the bundle, where its index begins and its CRC-32, size."""

    name: str
    index_offset: int
    index_crc: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class GofFiles:
    """Where one group of frames lies: streamed tiles, and the source frames beside them."""

    tiles: FileEntry
    source: FileEntry


@dataclass(frozen=True, slots=True)
class Pruning:
    """Splats that the encoder left out because they hardly contribute to pictures, and what that costs."""

    share: float
    """Share of the splats that was to go."""
    splats_before: int
    """Splats a frame, mean over the frames that were judged."""
    splats_after: int
    psnr_db: float
    """PSNR of pictures of the pruned splats against all splats, both unquantised, over covered pixels."""
    ssim: float


@dataclass(frozen=True, slots=True)
class MotionSteps:
    """Finest units of motion, by the base code of a splat's scale: a large splat may be off by more."""

    moves: tuple[float, ...]
    """Metres."""
    turns: tuple[float, ...]
    """Steps of a quaternion's imaginary part (half the angle), radians."""


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a bundle holds. All lengths are in the scene's units (metres), world frame."""

    name: str
    fps: float
    frames: int
    gof_starts: tuple[int, ...]
    """First frame of each group of frames, ascending from 0."""
    capacity: tuple[int, ...]
    """For each group, one more than the largest splat id in it."""
    sh_degree: int
    bounds: tuple[Vec3, Vec3]
    """Smallest and largest corner of all means over all frames."""
    lod_order: tuple[LodLayer, ...]
    lod_gains_db: tuple[float, ...]
    """PSNR gained by each level of ``lod_order``, measured on renders of this content; empty when it was not measured.
    """
    codec: str = "svq"
    """Name of the tile codec (:data:`cags_common.bundle.codecs.TILE_CODECS`)."""
    quantiser: str = ""
    """Name of the codec's configuration, such as ``paper-66``; for people."""
    up: Vec3 = (0.0, 1.0, 0.0)
    focus_centre: Vec3 = (0.0, 0.0, 0.0)
    """Point to look at when a walk is placed in the scene."""
    focus_radius: float = 1.0
    near: float = DEFAULT_NEAR
    weights_crc: int | None = None
    """CRC-32 of the restorer's weights that were trained for this content; None where there are none."""
    gofs: tuple[GofFiles, ...] = ()
    """One entry a group, or none in the public part."""
    pruning: Pruning | None = None
    motion: MotionSteps | None = None
    """Units of motion; None where no splat of the bundle moves by itself."""
    tracks: TrackStatistics | None = None
    """How splats continue from frame to frame; for people."""
    view: AuthorView | None = None
    """How the author wants the scene to be opened."""
    base_psnr_db: float | None = None
    """PSNR of level 0 in the renders that ``lod_gains_db`` is from; None when it was not measured."""
    still_psnr_db: tuple[tuple[int, float], ...] = ()
    """(frames, PSNR) by rising frames: renders of a frame against those of the frame so many later, in the mean over
    the clip; empty when it was not measured."""
    outdated_psnr_db: tuple[tuple[int, float], ...] = ()
    """(frames, PSNR) by rising frames: renders that lack updates for so many frames against those that lack none, over
    what the updated splats make up of them; empty when it was not measured, or there are no updates."""
    version: int = VERSION

    @property
    def lods(self) -> int:
        """Number of levels, LoD 0 included."""
        return len(self.lod_order) + 1

    def gof_of(self, frame: int) -> int:
        """The group that ``frame`` belongs to. Raises :class:`BundleError` outside the bundle."""
        if not 0 <= frame < self.frames:
            raise BundleError(f"frame {frame} is outside the bundle's frames 0 to {self.frames - 1}")
        return bisect_right(self.gof_starts, frame) - 1

    def gof_frames(self, gof: int) -> range:
        """The frames of a group."""
        ends = (*self.gof_starts[1:], self.frames)
        return range(self.gof_starts[gof], ends[gof])

    @property
    def kept_whole(self) -> bool:
        """Whether decoders keep all groups of frames, and so can loop the clip and seek in it without new data."""
        return len(self.gof_starts) == 1 or sum(self.capacity) <= MAX_WHOLE_SPLATS

    def to_json(self) -> bytes:
        """UTF-8 JSON; equal manifests give equal bytes."""
        table = {"format": FORMAT, **asdict(self)}
        table["lod_order"] = [[item.attribute, item.layer] for item in self.lod_order]
        for name in ("pruning", "motion", "tracks"):
            if table[name] is None:
                del table[name]
        for name in ("weights_crc", "base_psnr_db"):
            if table[name] is None:
                del table[name]
        for name in ("still_psnr_db", "outdated_psnr_db"):
            if not table[name]:
                del table[name]
        del table["view"]
        if self.view is not None:
            table["view"] = self.view.table()
        return json.dumps(table, separators=(",", ":"), sort_keys=True, allow_nan=False).encode()

    def public_json(self) -> bytes:
        """The part that clients need: everything but where bytes lie in the store."""
        return replace(self, gofs=()).to_json()

    @staticmethod
    def from_json(data: bytes | memoryview) -> Manifest:
        """Parse and check. Raises :class:`BundleError` naming the field; an unknown version is refused."""
        if len(data) > MAX_MANIFEST_BYTES:
            raise BundleError(f"manifest: {len(data)} bytes are more than the allowed {MAX_MANIFEST_BYTES}")
        try:
            table = json.loads(bytes(data))
        except (ValueError, RecursionError) as error:
            raise BundleError(f"manifest: is not JSON ({error})") from error
        if not isinstance(table, dict) or table.get("format") != FORMAT:
            raise BundleError(f"manifest: is not a {FORMAT} manifest")
        if table.get("version") != VERSION:
            raise BundleError(
                f"manifest: version {table.get('version')!r} is unknown; this program reads {VERSION}, encode again"
            )
        return _checked(Fields(table))


def _checked(fields: Fields) -> Manifest:
    manifest = Manifest(
        name=fields.text("name"),
        fps=fields.number("fps", 1e-3, 1000.0),
        frames=fields.integer("frames", 1, MAX_FRAMES),
        gof_starts=fields.many("gof_starts", lambda f: f.integer("", 0, MAX_FRAMES), MAX_FRAMES),
        capacity=fields.many("capacity", lambda f: f.integer("", 0, MAX_SPLATS), MAX_FRAMES),
        sh_degree=fields.integer("sh_degree", 0, 3),
        bounds=_bounds(fields),
        lod_order=fields.many("lod_order", _lod_layer, MAX_LODS - 1),
        lod_gains_db=fields.many("lod_gains_db", lambda f: f.number("", -1e3, 1e3), MAX_LODS - 1),
        base_psnr_db=fields.number("base_psnr_db", -1e3, 1e3) if fields.has("base_psnr_db") else None,
        still_psnr_db=_by_frames(fields, "still_psnr_db"),
        outdated_psnr_db=_by_frames(fields, "outdated_psnr_db"),
        codec=fields.text("codec"),
        quantiser=fields.text("quantiser"),
        up=fields.vector("up"),
        focus_centre=fields.vector("focus_centre"),
        focus_radius=fields.number("focus_radius", 0.0, MAX_LENGTH),
        near=fields.number("near", 1e-9, 1e9),
        pruning=_pruning(fields.inner("pruning")) if fields.has("pruning") else None,
        motion=_motion(fields.inner("motion")) if fields.has("motion") else None,
        tracks=_tracks(fields.inner("tracks")) if fields.has("tracks") else None,
        view=AuthorView.read(fields.inner("view")) if fields.has("view") else None,
        weights_crc=fields.integer("weights_crc", 0, 2**32 - 1) if fields.has("weights_crc") else None,
        gofs=fields.many("gofs", lambda f: GofFiles(_file(f.inner("tiles")), _file(f.inner("source"))), MAX_FRAMES),
    )
    starts = manifest.gof_starts
    if not starts or starts[0] != 0 or any(a >= b for a, b in zip(starts, (*starts[1:], manifest.frames), strict=True)):
        raise BundleError(
            f"manifest: gof_starts {starts[:8]} must rise from 0 and stay below frames = {manifest.frames}"
        )
    if len(manifest.capacity) != len(starts) or len(manifest.gofs) not in (0, len(starts)):
        raise BundleError(f"manifest: capacity and gofs must have one entry for each of the {len(starts)} groups")
    if len(manifest.lod_gains_db) not in (0, len(manifest.lod_order)):
        raise BundleError("manifest: lod_gains_db must be empty or have one entry for each LoD of lod_order")
    return manifest


def _by_frames(fields: Fields, name: str) -> tuple[tuple[int, float], ...]:
    """Optional pairs of frames and decibels."""
    if not fields.has(name):
        return ()

    def pair(field: Fields) -> tuple[int, float]:
        read = field.many("", lambda f: f.number("", -1e3, 1e9), 2)
        if len(read) != 2 or read[0] != int(read[0]) or not 1 <= read[0] <= MAX_FRAMES:
            raise BundleError(f"manifest: {name} must be pairs of frames from 1 on and decibels, found {read}")
        return int(read[0]), read[1]

    pairs = fields.many(name, pair, MAX_LAGS)
    lags = [frames for frames, _ in pairs]
    if any(a >= b for a, b in pairwise(lags)):
        raise BundleError(f"manifest: {name} must rise in frames, found {lags}")
    return pairs


def _bounds(fields: Fields) -> tuple[Vec3, Vec3]:
    corners = fields.many("bounds", lambda f: f.vector(""), 2)
    if len(corners) != 2:
        raise BundleError("manifest: bounds must be two corners")
    return corners[0], corners[1]


def _pruning(fields: Fields) -> Pruning:
    return Pruning(
        share=fields.number("share", 0.0, 1.0),
        splats_before=fields.integer("splats_before", 1, MAX_SPLATS),
        splats_after=fields.integer("splats_after", 1, MAX_SPLATS),
        psnr_db=fields.number("psnr_db", -1e3, 1e3),
        ssim=fields.number("ssim", -1.0, 1.0),
    )


def _motion(fields: Fields) -> MotionSteps:
    def step(field: Fields) -> float:
        return field.number("", 0.0, MAX_LENGTH)

    moves, turns = (fields.many(name, step, 1 << MAX_BASE_BITS) for name in ("moves", "turns"))
    if len(moves) != len(turns):
        raise BundleError(f"manifest: motion has {len(moves)} units of moves and {len(turns)} of turns")
    return MotionSteps(moves, turns)


def _tracks(fields: Fields) -> TrackStatistics:
    most, changed = MAX_FRAMES * MAX_SPLATS, fields.inner("changed")
    return TrackStatistics(
        frames=fields.integer("frames", 1, MAX_FRAMES),
        tracks=fields.integer("tracks", 1, most),
        linked_share=fields.number("linked_share", 0.0, 1.0),
        life_mean_frames=fields.number("life_mean_frames", 1.0, MAX_FRAMES),
        life_histogram=fields.many("life_histogram", lambda f: f.integer("", 0, most), MAX_LIFE_CLASSES),
        changed=ChangedShares(*(changed.number(name, 0.0, 1.0) for name in ChangedShares.__slots__)),
    )


def _lod_layer(field: Fields) -> LodLayer:
    parts = field.sequence("")
    if len(parts) != 2:
        raise BundleError(f"manifest: lod_order entry {parts!r} must be [attribute, layer]")
    return LodLayer(Fields(parts[0], "lod_order").text(""), Fields(parts[1], "lod_order").integer("", 1, MAX_LODS))


def _file(fields: Fields) -> FileEntry:
    name = fields.text("name")
    if not name or name.startswith("/") or ".." in name.split("/") or "\\" in name or ":" in name:
        raise BundleError(f"manifest: file name {name!r} must stay inside the bundle")
    size = fields.integer("size_bytes", 0, 2**50)
    return FileEntry(name, fields.integer("index_offset", 0, size), fields.integer("index_crc", 0, 2**32 - 1), size)
