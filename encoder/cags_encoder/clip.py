"""Encodes the frames of a clip in parallel and writes them in order.

The stages: read (parallel), link and assign ids (in order), quantise (parallel), compare with the decoder's copy (in
order), pack (parallel), write (in order). Each stage requests only as many frames as keep the workers busy, which
bounds memory. The result does not depend on which worker finishes first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from cags_common.bundle import BundleWriter
from cags_common.bundle.manifest import MotionSteps
from cags_common.bundle.writer import GofWriter
from cags_encoder.codecs.registry import ClipCodec
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.execution.executors import INLINE, Shared, Workers, ahead
from cags_encoder.execution.journal import FrameRecord, Journal
from cags_encoder.frames.differential import DecoderCopy
from cags_encoder.frames.moving import SHARE, MovingGroups
from cags_encoder.frames.outdated import Outdated
from cags_encoder.frames.tasks import AnyCut, look, pack, quantise, quantise_looks
from cags_encoder.motion.tolerance import Tolerances
from cags_encoder.motion.trails import Trails
from cags_encoder.scenes import FrameSource, is_still
from cags_encoder.settings import EncodeSettings
from cags_encoder.tracks.lasting import ease_of
from cags_encoder.tracks.placing import ClipPlacer, Placed


@dataclass(frozen=True, eq=False)
class _Chosen:
    """Content of a frame, before packing."""

    frame: Placed
    source: bytes
    """The packed unquantised changes."""
    tiles: tuple[AnyCut, ...]


class ClipEncoder:
    """Encodes all frames of one clip into a bundle's groups."""

    def __init__(
        self, source: FrameSource, settings: EncodeSettings, codec: ClipCodec, writer: BundleWriter, workers: Workers
    ) -> None:
        self._source, self._codec = Shared(source), Shared(codec)
        self._settings, self._writer, self._workers = settings, writer, workers
        self.placer = ClipPlacer(source.name, settings.gof_frames)
        self.capacity: list[int] = []
        """For each group, its largest id plus one."""
        self._gof: GofWriter | None = None

    def run(
        self,
        count: int,
        journal: Journal | None,
        tell: Callable[[int], None],
        motion: MotionSteps | None = None,
        tolerances: Tolerances = Tolerances(),  # noqa: B008 - it is frozen
        *,
        outdated: Outdated | None = None,
    ) -> None:
        """Encode ``count`` frames; those in ``journal`` are not packed again. ``tell`` gets the number finished.

        With ``motion``, splats keep their looks and their motion is coded in these units, with the accuracy of
        ``tolerances``; ``outdated`` looks at what updates replace. Without it, changed splats are sent again.
        """
        readers = INLINE if is_still(self._source.get()) else self._workers
        looks = ahead(readers, look, range(count), lambda index: (self._source, index))
        placed = self.placer.place(looks)
        chosen = self._differing(placed) if motion is None else self._moving(placed, motion, tolerances, outdated)
        for frame, record in self._packed(chosen, journal):
            self._write(frame, record)
            tell(frame.index + 1)
        if self._gof is not None:
            self._gof.close()

    def _packed(self, chosen: Iterable[_Chosen], journal: Journal | None) -> Iterator[tuple[Placed, FrameRecord]]:
        def lacking(item: _Chosen) -> tuple[AnyCut, ...]:
            return () if journal is not None and journal.has(item.frame.index) else item.tiles

        for item, tiles in ahead(self._workers, pack, chosen, lambda item: (self._codec, lacking(item))):
            record = journal.frame(item.frame.index) if journal else None
            if record is None:
                damaged = len(tiles) != len(item.tiles)
                record = FrameRecord(pack(self._codec, item.tiles) if damaged else tiles, item.source)
                if journal:
                    journal.add(item.frame.index, record)
            yield item.frame, record

    def _differing(self, placed: Iterable[Placed]) -> Iterator[_Chosen]:
        """Changed splats, sent whole (paper, section "Differential frames")."""
        held = DecoderCopy(self._codec.get(), self._settings.change_threshold)
        items = ahead(self._workers, quantise, placed, lambda frame: (self._codec, frame))
        for frame, quantised in items:
            if frame.key:
                held = DecoderCopy(self._codec.get(), self._settings.change_threshold)
            yield _Chosen(frame, quantised.source, held.send(frame.delta, quantised))

    def _moving(
        self, placed: Iterable[Placed], motion: MotionSteps, tolerances: Tolerances, outdated: Outdated | None
    ) -> Iterator[_Chosen]:
        """Looks sent once, changed attributes, and motion."""
        codec, span = self._codec.get(), self._settings.motion_span
        assert isinstance(codec, SvqCodec)
        trails = Trails(span, SHARE * self._settings.change_threshold, ease_of(codec.top_psnr_db))
        groups = MovingGroups(codec, motion, trails, self._settings, tolerances, outdated=outdated)
        followed = trails.follow(placed)
        for frame, quantised in ahead(self._workers, quantise_looks, followed, lambda frame: (self._codec, frame)):
            yield _Chosen(frame, quantised.source, groups.send(frame, quantised))
            trails.forget(frame.index)

    def _write(self, frame: Placed, record: FrameRecord) -> None:
        if frame.key:
            if self._gof is not None:
                self._gof.close()
            self._gof = self._writer.open_gof(frame.index, len(self._codec.get().lod_order) + 1)
            self.capacity.append(0)
        assert self._gof is not None
        self._gof.frame(record.tiles, frame.delta.removed, record.source)
        self.capacity[-1] = frame.capacity
