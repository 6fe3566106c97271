"""What a client shows that was sent so much and no more: every message in a buffer of splats."""

from __future__ import annotations

import numpy as np

from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import MotionTile
from cags_common.coding.packing import decode_ids
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.splats import Ids, Splats
from cags_common.tiles.splat_buffer import Slot, SplatBuffer
from cags_common.tiles.updates import UpdateState
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, TileLayers


class ShadowClient:
    """Holds payloads by (media frame, tile); nothing is ever given up."""

    def __init__(self, reader: BundleReader) -> None:
        self._reader = reader
        self.held: dict[tuple[int, int], dict[int, bytes]] = {}
        self.ended: dict[int, Ids] = {}
        self.again: list[tuple[int, int, int]] = []
        """(media frame, tile, LoD) of what came a second time."""

    def take(self, outgoing: list[ev.Outgoing]) -> None:
        for each in outgoing:
            message = each.message
            if isinstance(message, TileLayers):
                self._take_tile(message, bytes(each.payload))
            elif isinstance(message, FrameEnd):
                self.ended[message.frame] = decode_ids(each.payload)

    def _take_tile(self, message: TileLayers, payload: bytes) -> None:
        layers = self.held.setdefault((message.frame, message.tile), {})
        for lod, part in enumerate(message.split(payload), start=message.from_lod):
            if lod in layers:
                self.again.append((message.frame, message.tile, lod))
            layers[lod] = bytes(part)

    def shown(self, frame: int) -> tuple[Ids, Splats]:
        """Ids [n] and splats [n] on display at ``frame``, by the rules of the buffer."""
        manifest = self._reader.manifest
        gof = manifest.gof_of(frame)
        buffer = SplatBuffer(manifest.capacity[gof], manifest.sh_degree)
        for at in range(manifest.gof_starts[gof], frame + 1):
            buffer.remove(at, self.ended.get(at, np.zeros(0, np.int32)))
            for key in sorted(key for key in self.held if key[0] == at and 0 in self.held[key]):
                self._show(buffer, key, float(frame))
        buffer.move(float(frame))
        buffer.ramp(float(frame))
        ids = np.flatnonzero((buffer.owner >= 0) & (buffer.splats.logit_opacities > ABSENT_LOGIT)).astype(np.int32)
        return ids, buffer.splats.take(ids)

    def _show(self, buffer: SplatBuffer, key: tuple[int, int], time: float) -> None:
        layers = self.held[key]
        looks = next(entry.looks for entry in self._reader.frame(key[0]).tiles if entry.tile == key[1])
        anchors = None if looks is None else self._reader.anchors(*looks)
        state = self._reader.codec.open_tile(layers[0], anchors)
        for lod in sorted(layers)[1:]:
            state.add_layer(lod, layers[lod])
        if isinstance(state, MotionTile):
            buffer.set_motion(state.looks, key[0], state.chunk)
        elif isinstance(state, UpdateState):
            buffer.update(key[0], state.values(), time)
        else:
            slot = Slot(len(buffer.slots), key, steps=state.steps)
            buffer.add(slot)
            buffer.write(slot, state.lod, state.ids, state.dequantise())
