"""Encoding a scene into a bundle."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from cags_common.bundle import BundleWriter, Manifest
from cags_common.bundle.source import encode_source
from cags_common.bundle.writer import GofWriter
from cags_common.errors import SceneError
from cags_common.geometry import DEFAULT_NEAR, F64, Vec3
from cags_common.raster import create
from cags_common.splats import Splats
from cags_encoder.codecs import ClipCodec, train_codec
from cags_encoder.frames.differential import DifferentialFrame, GofEncoder
from cags_encoder.frames.identity import IdentityTracker
from cags_encoder.measuring import cameras_around, measured
from cags_encoder.sampling import LOOKS, check_degree, training_splats
from cags_encoder.scenes import Focus, FrameSource, focus_of
from cags_encoder.settings import EncodeSettings
from cags_encoder.svq_codec import SvqCodec

Progress = Callable[[str, int, int], None]
"""Called with the stage's name, steps done and steps in all."""


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
        """Unknown: rows are matched."""


def encode(
    frames: FrameSource | Iterable[Splats],
    settings: EncodeSettings,
    out_url: str,
    progress: Progress | None = None,
) -> Manifest:
    """Encode ``frames`` into a bundle at ``out_url`` (a folder or an fsspec URL) and return its manifest.

    The same frames and settings give the same bytes. Nothing is left behind on failure. Raises :class:`SceneError`,
    :class:`ConfigError` or :class:`BundleError`.
    """
    source = _as_source(frames)
    count = len(source) if settings.frames is None else min(settings.frames, len(source))
    tell = progress or (lambda stage, done, total: None)
    with BundleWriter(out_url) as writer:
        codec = _train(source, count, settings, tell)
        writer.codebooks(codec.codebooks())
        run = _ClipEncoder(source, settings, codec, writer)
        for index in range(count):
            run.add(index)
            tell("encode", index + 1, count)
        return writer.commit(run.manifest(count))


def _as_source(frames: FrameSource | Iterable[Splats]) -> FrameSource:
    if not isinstance(frames, Iterable):
        return frames
    held = tuple(splats.checked(f"frame {i}") for i, splats in enumerate(frames))
    if not held:
        raise SceneError("splats: there are no frames; give at least one")
    return SplatSequence(held, focus=focus_of(held[0]))


def _train(source: FrameSource, count: int, settings: EncodeSettings, tell: Progress) -> ClipCodec:
    looks, done = min(LOOKS, count), 0

    def on_frame() -> None:
        nonlocal done
        done += 1
        tell("sample", done, looks)

    samples = training_splats(source, count, settings.train_splats, settings.seed, on_frame)
    tell("codebooks", 0, 1)
    codec = train_codec(samples, settings)
    tell("codebooks", 1, 1)
    if settings.lod_order == "measured" and isinstance(codec, SvqCodec):
        return _measured(codec, source, tell)
    return codec


def _measured(codec: SvqCodec, source: FrameSource, tell: Progress) -> ClipCodec:
    """The codec with its LoD order measured, where a rasteriser is there that is fast enough for dozens of renders."""
    rasteriser = create("auto")
    if rasteriser.name == "reference":
        return codec
    focus = source.focus
    cameras = cameras_around(focus.centre, focus.radius, source.up, near_plane(focus))
    return measured(codec, source.frame(0), cameras, rasteriser, lambda done, total: tell("order", done, total))


def near_plane(focus: Focus) -> float:
    """Near plane for a scene of this size."""
    return min(DEFAULT_NEAR, float(focus.radius) / 10)


class _ClipEncoder:
    """Takes frames in order; starts a group where one is due or where nothing connects to the frame before."""

    def __init__(self, source: FrameSource, settings: EncodeSettings, codec: ClipCodec, writer: BundleWriter) -> None:
        self._source, self._settings, self._codec, self._writer = source, settings, codec, writer
        self._tracker = IdentityTracker()
        self._starts: list[int] = []
        self._capacity: list[int] = []
        self._gof: GofWriter | None = None
        self._encoder = GofEncoder(codec, settings.change_threshold)
        self._low: F64 = np.full(3, np.inf)
        self._high: F64 = np.full(3, -np.inf)
        self._degree: int | None = None

    def add(self, index: int) -> DifferentialFrame:
        """Encode frame ``index`` and append it to the bundle."""
        where = f"{self._source.name}, frame {index}"
        splats = self._source.frame(index)
        self._degree = splats.sh_degree if self._degree is None else self._degree
        check_degree(splats, self._degree, where)
        identities, continuous = self._tracker.identify(splats, self._source.ids(index), where)
        if not self._starts or not continuous or index - self._starts[-1] >= self._settings.gof_frames:
            self._open_gof(index)
        assert self._gof is not None
        frame = self._encoder.encode(splats, identities)
        self._gof.frame(frame.tiles, frame.removed, encode_source(frame.source))
        self._low = np.minimum(self._low, splats.means.min(axis=0))
        self._high = np.maximum(self._high, splats.means.max(axis=0))
        return frame

    def manifest(self, frames: int) -> Manifest:
        """Close the last group and describe the clip."""
        self._close_gof()
        source, focus = self._source, self._source.focus
        return Manifest(
            name=source.name,
            fps=self._settings.fps or source.fps,
            frames=frames,
            gof_starts=tuple(self._starts),
            capacity=tuple(self._capacity),
            sh_degree=self._degree or 0,
            bounds=(_vector(self._low), _vector(self._high)),
            lod_order=self._codec.lod_order,
            lod_gains_db=self._codec.lod_gains_db,
            codec=self._settings.codec,
            quantiser=self._settings.quantiser,
            up=_vector(np.asarray(source.up)),
            focus_centre=_vector(np.asarray(focus.centre)),
            focus_radius=float(focus.radius),
            near=near_plane(focus),
        )

    def _open_gof(self, index: int) -> None:
        self._close_gof()
        self._gof = self._writer.open_gof(index, len(self._codec.lod_order) + 1)
        self._encoder = GofEncoder(self._codec, self._settings.change_threshold)
        self._starts.append(index)

    def _close_gof(self) -> None:
        if self._gof is not None:
            self._gof.close()
            self._capacity.append(self._encoder.capacity)


def _vector(values: np.ndarray) -> Vec3:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
