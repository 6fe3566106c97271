"""Scripts of what happens to a tile store, with what Python's shows after each step, for other implementations."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from cags_client.frame.restore import expected_errors
from cags_common.bundle.codecs import TileCodec
from cags_common.bundle.manifest import Manifest
from cags_common.errors import DecodeError
from cags_common.geometry import Camera
from cags_common.store.gof_buffer import Committed, GofBuffer
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore

Step = dict[str, Any]


class Recorder:
    """Drives a store and writes down each step, and what is there after it."""

    def __init__(
        self, manifest: Manifest, codec: TileCodec, camera: Camera | None = None, *, whole: bool = True
    ) -> None:
        """``whole``: whether the clip is kept whole, if it is small enough."""
        self.steps: list[Step] = []
        self.whole = whole
        self.store = TileStore(manifest, codec)
        self._camera, self._manifest = camera, manifest
        self._errors = expected_errors(manifest)
        self._pass()

    @property
    def reachable(self) -> int:
        """The first frame that can be committed."""
        return 0 if self.store._whole else self._manifest.gof_starts[self.store._oldest]

    def _pass(self) -> None:
        self.store._whole &= self.whole or len(self._manifest.gof_starts) == 1

    def add(self, arrivals: Sequence[Arrival]) -> None:
        errors = self.store.add_all(arrivals)
        given = [
            {"frame": a.frame, "tile": a.tile, "from": a.from_lod, "payloads": [text(bytes(p)) for p in a.payloads]}
            for a in arrivals
        ]
        self.steps.append({"op": "add", "arrivals": given, "errors": len(errors)})

    def flush(self) -> None:
        self.steps.append({"op": "flush", "errors": len(self.store.flush())})

    def mark(self, number: int) -> None:
        self.steps.append({"op": "mark", "number": number, "errors": len(self.store.mark(number))})

    def end(self, frame: int, removed: np.ndarray) -> None:
        try:
            self.store.end(frame, removed)
            wrong = 0
        except DecodeError:
            wrong = 1
        self.steps.append({"op": "end", "frame": frame, "removed": removed.tolist(), "errors": wrong})

    def reset(self, frame: int) -> None:
        self.store.reset(frame)
        self._pass()
        self.steps.append({"op": "reset", "frame": frame})

    def restarted(self, rng: np.random.Generator) -> None:
        held = self.store.held()
        kept = [tile for tile in held if rng.random() < 0.7] if rng.random() < 0.7 else None
        self.store.restarted(kept)
        inventory = None if kept is None else [[t.frame, t.tile, t.lods] for t in kept]
        self.steps.append({"op": "restarted", "inventory": inventory})

    def commit(self, frame: int, basis: int | None = None) -> None:
        gof, committed = self.store.commit(frame, basis)
        self.steps.append({"op": "commit", "frame": frame, "basis": basis, **self._shown(gof, committed)})

    def move(self, frame: int, share: float) -> None:
        moved = self.store.move(frame, share)
        after = {"none": True} if moved is None else self._shown(*moved)
        self.steps.append({"op": "move", "frame": frame, "share": share, **after})

    def _shown(self, gof: GofBuffer, committed: Committed) -> Step:
        held = sorted([t.frame, t.tile, t.lods] for t in self.store.held())
        kept = [self.store.kept.start, self.store.kept.stop]
        mean = gof.shown.lod_mean(self._camera) if self._camera else math.nan
        return {
            "columns": {name: zlib.crc32(np.ascontiguousarray(array)) for name, array in gof.splats.arrays()},
            "owners": zlib.crc32((gof.shown.owner >= 0).astype(np.uint8)),
            "rows": committed.rows.tolist(),
            "began": committed.began.tolist(),
            "moved": committed.moved.tolist(),
            "flags": [committed.gof, committed.fresh, committed.missed, gof.full, *kept],
            "held": held,
            "ahead": self.store.ahead(0),
            "dropped": len(self.store.take_dropped()),
            "lodMean": None if math.isnan(mean) else mean,
            "ownError": None if math.isnan(mean) else gof.shown.error_mean(self._camera, self._errors),
        }


def text(data: bytes) -> str:
    """Bytes as JSON has them."""
    return base64.b64encode(data).decode()
