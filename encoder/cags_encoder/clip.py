"""The frames of a clip, encoded in parallel and written in order.

Frames pass through a chain: read and match (parallel), give ids (in order), quantise (parallel), compare with what the
decoder holds (in order), pack (parallel), write (in order). Each link draws only as many frames as keep the workers
busy, which bounds memory, and nothing depends on which worker is done first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from cags_common.bundle import BundleWriter, SourceDelta, TilePayloads
from cags_common.bundle.writer import GofWriter
from cags_common.geometry import F64, axis_bounds
from cags_encoder.codecs import ClipCodec
from cags_encoder.executors import Shared, Workers, ahead
from cags_encoder.frames.differential import DecoderCopy, Placer, QuantisedDelta, Sent
from cags_encoder.frames.identity import IdentityTracker
from cags_encoder.frames.tasks import Look, look, pack, quantise
from cags_encoder.journal import FrameRecord, Journal
from cags_encoder.sampling import check_degree
from cags_encoder.scenes import FrameSource
from cags_encoder.settings import EncodeSettings


@dataclass(frozen=True, eq=False)
class Placed:
    """A frame whose splats have their ids."""

    index: int
    key: bool
    """Whether it begins a group."""
    delta: SourceDelta
    capacity: int
    """One more than the largest id of the group so far."""


class ClipPlacer:
    """Takes frames in order; starts a group where one is due or where nothing connects to the frame before."""

    def __init__(self, name: str, gof_frames: int) -> None:
        self._name, self._gof_frames = name, gof_frames
        self._tracker, self._placer = IdentityTracker(), Placer()
        self.starts: list[int] = []
        self.low: F64 = np.full(3, np.inf)
        self.high: F64 = np.full(3, -np.inf)
        self.degree: int | None = None

    def place(self, looks: Iterable[tuple[int, Look]]) -> Iterator[Placed]:
        """Ids for the splats of each frame. Raises :class:`SceneError`."""
        for index, seen in looks:
            where = f"{self._name}, frame {index}"
            self.degree = seen.splats.sh_degree if self.degree is None else self.degree
            check_degree(seen.splats, self.degree, where)
            identities, continuous = self._tracker.identify(len(seen.splats), seen.known, seen.rows, where)
            key = not self.starts or not continuous or index - self.starts[-1] >= self._gof_frames
            if key:
                self._placer = Placer()
                self.starts.append(index)
            delta = self._placer.place(seen.splats, identities)
            low, high = axis_bounds(seen.splats.means)
            self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
            yield Placed(index, key, delta, self._placer.capacity)


class ClipEncoder:
    """Encodes all frames of one clip into a bundle's groups."""

    def __init__(
        self, source: FrameSource, settings: EncodeSettings, codec: ClipCodec, writer: BundleWriter, workers: Workers
    ) -> None:
        self._source, self._codec = Shared(source), Shared(codec)
        self._settings, self._writer, self._workers = settings, writer, workers
        self.placer = ClipPlacer(source.name, settings.gof_frames)
        self.capacity: list[int] = []
        """For each group, one more than its largest id."""
        self._held = DecoderCopy(codec, settings.change_threshold)
        self._gof: GofWriter | None = None

    def run(self, count: int, journal: Journal | None, tell: Callable[[int], None]) -> None:
        """Encode ``count`` frames, those first that ``journal`` has. ``tell`` takes the number of finished frames."""
        looks = ahead(self._workers, look, range(count), lambda index: (self._source, index))
        placed = self.placer.place(looks)
        done = self._replay(placed, journal, tell) if journal else 0
        for frame, record in self._encoded(placed) if done < count else ():
            if journal:
                journal.add(frame.index, record)
            self._write(frame, record.tiles, record.source)
            tell(frame.index + 1)
        if self._gof is not None:
            self._gof.close()

    def _replay(self, placed: Iterator[Placed], journal: Journal, tell: Callable[[int], None]) -> int:
        """Take over the frames that an earlier run finished; how many there were."""
        done = 0
        while (record := journal.frame(done)) is not None and (frame := next(islice(placed, 1), None)) is not None:
            self._hold(frame.key).take(record.ids, record.shown, frame.delta.removed)
            self._write(frame, record.tiles, record.source)
            done += 1
            tell(done)
        return done

    def _encoded(self, placed: Iterable[Placed]) -> Iterator[tuple[Placed, FrameRecord]]:
        quantised = ahead(self._workers, quantise, placed, lambda frame: (self._codec, frame.delta, frame.key))
        packed = ahead(self._workers, pack, map(self._send, quantised), lambda item: (self._codec, item[2].tiles))
        for (frame, source, sent), tiles in packed:
            yield frame, FrameRecord(tiles, source, sent.ids, sent.shown)

    def _send(self, item: tuple[Placed, QuantisedDelta]) -> tuple[Placed, bytes, Sent]:
        frame, quantised = item
        return frame, quantised.source, self._hold(frame.key).send(frame.delta, quantised)

    def _hold(self, key: bool) -> DecoderCopy:
        """What a decoder holds, nothing at a group's start."""
        if key:
            self._held = DecoderCopy(self._codec.get(), self._settings.change_threshold)
        return self._held

    def _write(self, frame: Placed, tiles: tuple[TilePayloads, ...], source: bytes) -> None:
        if frame.key:
            if self._gof is not None:
                self._gof.close()
            self._gof = self._writer.open_gof(frame.index, len(self._codec.get().lod_order) + 1)
            self.capacity.append(0)
        assert self._gof is not None
        self._gof.frame(tiles, frame.delta.removed, source)
        self.capacity[-1] = frame.capacity
