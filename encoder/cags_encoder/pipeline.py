"""Encoding a scene into a bundle."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleWriter, Manifest, Pruning
from cags_common.bundle.first_view import thumbnail
from cags_common.bundle.manifest import MAX_LENGTH, MotionSteps
from cags_common.bundle.quality import LodQuality
from cags_common.bundle.reader import THUMBNAIL_NAME
from cags_common.bundle.view import AuthorView, read_view
from cags_common.errors import ConfigError, SceneError
from cags_common.geometry import F64, Vec3
from cags_common.motion.apply import Steps
from cags_common.raster import create
from cags_common.splats import Splats
from cags_common.tiles.lod import LodLayer
from cags_encoder.clip import ClipEncoder
from cags_encoder.codecs.lod_order import NAMED_ORDERS, order_in_file
from cags_encoder.codecs.registry import CLIP_CODECS, ClipCodec, train_codec
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.execution.executors import INLINE, Shared, Workers, ahead
from cags_encoder.execution.journal import Journal
from cags_encoder.frames.outdated import Outdated
from cags_encoder.frames.tasks import read
from cags_encoder.measuring import (
    VIEWS,
    Levelled,
    LodMeasurement,
    measure,
    measured_levels,
    standing,
    standing_still,
)
from cags_encoder.motion.steps import motion_steps
from cags_encoder.motion.tolerance import Looked, Tolerance, Tolerances, tolerances
from cags_encoder.pruning import prune, prune_within
from cags_encoder.quantiser.importance import VIEWS as IMPORTANCE_VIEWS
from cags_encoder.quantiser.importance import importance
from cags_encoder.sampling import looked_at, training_splats
from cags_encoder.scenes import Focus, FrameSource, focus_of, is_still
from cags_encoder.settings import EncodeSettings
from cags_encoder.views import cameras_around, near_plane

Progress = Callable[[str, int, int], None]
"""Called with the stage's name, completed steps and total steps."""


@dataclass(frozen=True)
class SplatSequence:
    """Frames held in memory, as a :class:`FrameSource`. Row order and counts may differ between frames."""

    held: tuple[Splats, ...]
    name: str = "splats"
    fps: float = 30.0
    up: Vec3 = (0.0, 1.0, 0.0)
    focus: Focus = field(default=Focus((0.0, 0.0, 0.0), 1.0))

    def __len__(self) -> int:
        return len(self.held)

    def frame(self, index: int) -> Splats:
        """Frame ``index``."""
        return self.held[index]

    def ids(self, index: int) -> None:
        """None: identities are unknown, so rows are matched."""


@dataclass(frozen=True)
class Resume:
    """Records for resuming a killed run: their folder, and a key of input and settings."""

    folder: Path
    key: str


def encode(
    frames: FrameSource | Iterable[Splats],
    settings: EncodeSettings,
    out_url: str,
    progress: Progress | None = None,
    *,
    workers: Workers = INLINE,
    resume: Resume | None = None,
) -> Manifest:
    """Encode ``frames`` into a bundle at ``out_url`` (a folder or an fsspec URL) and return its manifest.

    An old bundle there is replaced once everything that the settings can get wrong is known; anything else is refused.

    The same frames and settings give the same bytes with any ``workers`` (frames in memory are copied to them). With
    ``resume`` a killed run continues, to the same bytes. A failed run leaves nothing behind, except for the records in
    ``resume.folder`` if running again may help. Raises :class:`SceneError`, :class:`ConfigError`,
    :class:`BundleError` or :class:`OutputError`.
    """
    source = _as_source(frames)
    tell = progress or (lambda stage, done, total: None)
    encoding = _Encoding(source, settings, workers, tell)
    writer = BundleWriter(out_url)
    with ExitStack() as stack:
        # The journal locks out a second run, so it comes before anything at the URL is changed.
        journal = stack.enter_context(Journal(resume.folder, resume.key)) if resume else None
        stack.enter_context(writer)
        try:
            manifest = encoding.run(writer, journal)
        except (SceneError, ConfigError):  # the input must change first, and the records will not fit then
            if journal:
                journal.discard()
            raise
        if journal:
            journal.discard()
        return manifest


def _as_source(frames: FrameSource | Iterable[Splats]) -> FrameSource:
    if not isinstance(frames, Iterable):
        return frames
    held = tuple(splats.checked(f"frame {i}") for i, splats in enumerate(frames))
    if not held:
        raise SceneError("splats: there are no frames; give at least one")
    return SplatSequence(held, focus=focus_of(held[0]))


class _Encoding:
    """One run of the encoder. Raises :class:`ConfigError` at once for a codec or a file that settings misname."""

    def __init__(self, source: FrameSource, settings: EncodeSettings, workers: Workers, tell: Progress) -> None:
        CLIP_CODECS.find(settings.codec)
        if settings.lod_order not in NAMED_ORDERS and not Path(settings.lod_order).is_fifo():  # pipes are read once
            order_in_file(settings.lod_order)
        if source.focus.radius > MAX_LENGTH:
            raise SceneError(
                f"{source.name}: its focus has a radius of {source.focus.radius:g}; bundles hold up to {MAX_LENGTH:g}: "
                "give the scene in larger units"
            )
        self._view: AuthorView | None = read_view(settings.view) if settings.view else None
        self._source, self._settings, self._workers, self._tell = source, settings, workers, tell
        self._journal: Journal | None = None
        self._count = len(source) if settings.frames is None else min(settings.frames, len(source))
        self._pruning: Pruning | None = None
        self._quality: LodQuality | None = None
        self._still: tuple[tuple[int, float], ...] = ()
        self._tolerances = Tolerances()

    def run(self, writer: BundleWriter, journal: Journal | None) -> Manifest:
        """Write the bundle."""
        self._journal = journal
        self._source = self._pruned(self._source)
        codec = self._codec()
        writer.codebooks(codec.codebooks())
        if self._quality is not None:
            writer.quality(self._quality)
        clip = ClipEncoder(self._source, self._settings, codec, writer, self._workers)
        motion = self._motion(codec)
        outdated = None if motion is None or codec.base_psnr_db is None else self._outdated()
        self._tell("encode", 0, self._count)

        def tell(done: int) -> None:
            self._tell("encode", done, self._count)

        clip.run(self._count, self._journal, tell, motion, self._tolerances, outdated=outdated)
        found = () if outdated is None else outdated.psnr_db
        manifest = replace(
            self._manifest(codec, clip), motion=motion, tracks=clip.placer.tracks(), outdated_psnr_db=found
        )
        self._thumbnail(manifest, writer)
        return writer.commit(manifest)

    def _thumbnail(self, manifest: Manifest, writer: BundleWriter) -> None:
        """A thumbnail for galleries, if the rasteriser is fast enough; otherwise servers make one."""
        rasteriser = create("auto")
        if rasteriser.name == "oracle":
            return
        with writer.open_file(THUMBNAIL_NAME) as file:
            file.write(thumbnail(rasteriser.load(self._source.frame(0)), manifest))

    def _motion(self, codec: ClipCodec) -> MotionSteps | None:
        """Units of motion; None for a clip of one frame, in which nothing moves."""
        tracks = self._settings.motion == "tracks" and self._count > 1
        if not tracks or not isinstance(codec, SvqCodec):
            return None
        book = codec.quantiser.books["scale"]
        prepared = codec.prepare(self._source.frame(0))
        base = book.layer(codec.quantise(prepared).codes["scale"], 0)
        steps = motion_steps(prepared, base, 1 << book.layer_bits[0])
        splat_steps = Steps(np.array(steps.moves, np.float32)[base], np.array(steps.turns, np.float32)[base])
        self._tolerances = self._tolerated(codec, prepared, splat_steps)
        return steps

    def _tolerated(self, codec: SvqCodec, prepared: Splats, steps: Steps) -> Tolerances:
        """Accuracy of motion, measured if the rasteriser is fast enough."""
        known = self._journal.note("tolerances") if self._journal else None
        if known is not None:
            return Tolerances(Tolerance(**known["moves"]), Tolerance(**known["turns"]))
        rasteriser = create("auto")
        if rasteriser.name == "oracle":
            return Tolerances()
        cameras = cameras_around(self._source.focus, self._source.up, VIEWS)
        looked = Looked(cameras, rasteriser, self._settings.change_threshold / 2)
        found = tolerances(codec, prepared, steps, looked)
        if self._journal:
            self._journal.write_note("tolerances", asdict(found))
        return found

    def _outdated(self) -> Outdated | None:
        """Looks at what updates replace, if the rasteriser is fast enough."""
        rasteriser = create("auto")
        if rasteriser.name == "oracle":
            return None
        return Outdated(cameras_around(self._source.focus, self._source.up, VIEWS), rasteriser, self._count)

    def _pruned(self, source: FrameSource) -> FrameSource:
        def tell(done: int, total: int) -> None:
            self._tell("prune", done, total)

        share, psnr_db = self._settings.prune, self._settings.prune_psnr_db
        if psnr_db is not None:
            source, self._pruning = prune_within(source, psnr_db, self._count, tell)
        elif share:
            source, self._pruning = prune(source, share, self._count, tell)
        return source

    def _codec(self) -> ClipCodec:
        """The trained codec with its measured LoD order, or the one recorded by a killed run."""
        samples = self._samples()
        codec = train_codec(samples, self._settings, self._weights(samples))
        if isinstance(codec, SvqCodec):
            codec = codec.modelled(self._source.frame(0))
        self._tell("codebooks", 1, 1)
        if self._journal:
            self._journal.codebooks(codec.codebooks())
        if self._settings.lod_order != "measured":
            return codec
        if isinstance(codec, SvqCodec):
            found = self._measurement(codec)
            if found is not None:
                self._quality = found.quality
                return found.applied(codec)
        elif isinstance(codec, Levelled):
            return codec.with_measured(self._measured_levels(codec))
        return codec

    def _measured_levels(self, codec: Levelled) -> tuple[float, ...]:
        """PSNR of each LoD of a codec of fixed levels; nothing is known with a slow rasteriser."""
        known = self._journal.note("levels") if self._journal else None
        if known is not None:
            return tuple(known["psnr_db"])
        rasteriser = create("auto")
        if rasteriser.name == "oracle":
            return ()
        cameras = cameras_around(self._source.focus, self._source.up, VIEWS)
        found = measured_levels(codec, self._source.frame(0), cameras, rasteriser)
        if self._journal:
            self._journal.write_note("levels", {"psnr_db": found})
        return found

    def _weights(self, samples: Splats) -> F64 | None:
        """Weights of the samples, if the rasteriser is fast enough to measure contributions."""
        rasteriser = create("auto")
        if rasteriser.name == "oracle" or self._settings.codec != "svq":
            return None
        return importance(samples, cameras_around(self._source.focus, self._source.up, IMPORTANCE_VIEWS), rasteriser)

    def _samples(self) -> Splats:
        looks = looked_at(self._count)
        shared = Shared(self._source)

        def frames() -> Iterator[tuple[int, Splats]]:
            workers = INLINE if is_still(self._source) else self._workers
            coming = ahead(workers, read, looks, lambda index: (shared, index))
            for done, item in enumerate(coming, start=1):
                yield item
                self._tell("sample", done, len(looks))

        settings = self._settings
        samples = training_splats(self._source.name, len(looks), frames(), settings.train_splats, settings.seed)
        self._tell("codebooks", 0, 1)
        return samples

    def _standing(self, codec: SvqCodec, first: Splats) -> NDArray[np.bool_]:
        """Which splats of the first frame are shown where their looks say, without chunks of motion."""
        if self._count == 1 or self._settings.motion == "none":
            return np.ones(len(first), np.bool_)
        return standing(first, self._source.frame(min(self._settings.motion_span, self._count - 1)), codec)

    def _measurement(self, codec: SvqCodec) -> LodMeasurement | None:
        """The measured LoD order, if the rasteriser is fast enough for dozens of renders."""
        known = self._journal.note("order") if self._journal else None
        if known is not None:
            order = tuple(LodLayer(attribute, layer) for attribute, layer in known["order"])
            quality = LodQuality.from_json(known["quality"].encode())
            self._still = tuple((int(frames), float(psnr_db)) for frames, psnr_db in known["still"])
            return LodMeasurement(order, tuple(known["gains_db"]), quality, known["position_step"])
        rasteriser = create("auto")
        if rasteriser.name == "oracle":
            return None
        cameras = cameras_around(self._source.focus, self._source.up, VIEWS)
        first = self._source.frame(0)
        still, refine = self._standing(codec, first), self._settings.measures_positions

        def tell(done: int, total: int) -> None:
            self._tell("order", done, total)

        later = (self._source.frame(at) for at in sorted({self._count // 2, self._count - 1} - {0}))
        found = measure(codec, first, cameras, rasteriser, tell, still=still, refine=refine, later=later)
        self._still = standing_still(self._source.frame, self._count, cameras, rasteriser)
        if self._journal:
            order_note = [[item.attribute, item.layer] for item in found.order]
            note = {
                "order": order_note,
                "gains_db": found.gains_db,
                "quality": found.quality.to_json().decode(),
                "position_step": found.position_step,
                "still": self._still,
            }
            self._journal.write_note("order", note)
        return found

    def _manifest(self, codec: ClipCodec, clip: ClipEncoder) -> Manifest:
        source, focus = self._source, self._source.focus
        return Manifest(
            name=source.name,
            fps=self._settings.fps or source.fps,
            frames=self._count,
            gof_starts=tuple(clip.placer.starts),
            capacity=tuple(clip.capacity),
            sh_degree=clip.placer.degree or 0,
            bounds=(_vector(clip.placer.low), _vector(clip.placer.high)),
            lod_order=codec.lod_order,
            lod_gains_db=codec.lod_gains_db,
            base_psnr_db=codec.base_psnr_db,
            still_psnr_db=self._still,
            codec=self._settings.codec,
            quantiser=self._settings.quantiser if self._settings.codec == "svq" else "",
            up=_vector(np.asarray(source.up)),
            focus_centre=_vector(np.asarray(focus.centre)),
            focus_radius=float(focus.radius),
            near=near_plane(focus),
            pruning=self._pruning,
            view=self._view,
        )


def _vector(values: np.ndarray) -> Vec3:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
