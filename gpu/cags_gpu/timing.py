"""Counts of a frame's work, and times of its passes, measured on the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.correction import Placement
from cags_common.geometry import F64, Camera
from cags_common.raster.base import RenderOptions
from cags_gpu.graph import Dispatch, encode, record
from cags_gpu.layout import TILE_PX
from cags_gpu.scene import ResidentScene, packed
from cags_gpu.submission import Output, Outputs, Recording, submitted
from cags_gpu.work import FrameCounts

LOG2_ALPHA_CUT = -7.99435344
LEAST_LOG2 = -8.0
"""As in common.wgsl."""

QUARTER_PX = 8
"""Side of the quarters of a tile, as in blend.wgsl."""


def frame_counts(
    scene: ResidentScene, camera: Camera, options: RenderOptions, reference: Camera | None = None
) -> FrameCounts:
    """Count a frame without blending it. Called with the device's lock held."""

    def binned(recording: Recording) -> Outputs:
        scene.record_binning(recording, camera, options)
        sizes = {"state": 16, "touched": 4 * scene.count, "records": 32 * scene.count}
        return [Output(scene.workspace[name], size) for name, size in sizes.items()]

    state, touched, records = submitted(scene.workspace, binned)
    seen = touched.view(np.uint32) > 0
    words = records.view(np.uint32).reshape(-1, 8)[seen]
    drawn = _ellipses(words, packed=packed(options))
    other = (
        {}
        if reference is None
        else {
            "reference_pixels": reference.width_px * reference.height_px,
            "stride": Placement(camera, reference).stride,
        }
    )
    return FrameCounts(
        splats=scene.count,
        visible=int(seen.sum()),
        box_entries=_box_entries(drawn, camera),
        entries=int(state.view(np.uint32)[1]),
        quarters=_touched_blocks(drawn, camera, QUARTER_PX),
        pixels=camera.width_px * camera.height_px,
        harmonics=scene.sh_count,
        **other,
    )


@dataclass(frozen=True)
class _Ellipses:
    """What splats cover: ``(l11 dx + l12 dy)^2 + (l22 dy)^2 <= reach`` about their centres, pixels; all [M] float64."""

    u: F64
    v: F64
    l11: F64
    l12: F64
    l22: F64
    reach: F64


def _ellipses(words: NDArray[np.uint32], *, packed: bool) -> _Ellipses:
    """The ellipses of records [M, 8], as common.wgsl reads them."""
    u, v, l11, l12, l22 = (words[:, i].view(np.float32).astype(np.float64) for i in range(5))
    strength = words[:, 6].view(np.float32).astype(np.float64)
    if packed:
        strength = ((words[:, 7] >> 16) / 65535.0 - 1.0) * -LEAST_LOG2
    return _Ellipses(u, v, l11, l12, l22, np.maximum(strength - LOG2_ALPHA_CUT, 0.0))


def _box_entries(drawn: _Ellipses, camera: Camera) -> int:
    """Tiles of the boxes around the ellipses."""
    root = np.sqrt(drawn.reach)
    half = np.stack([root * np.hypot(drawn.l12, drawn.l22) / (drawn.l11 * drawn.l22), root / drawn.l22], axis=1)
    centre, size = np.stack([drawn.u, drawn.v], axis=1), np.array([camera.width_px, camera.height_px])
    low = np.clip(np.ceil(centre - half - 0.5), 0, size - 1) // TILE_PX
    high = np.clip(np.floor(centre + half - 0.5), 0, size - 1) // TILE_PX
    return int((high - low + 1).clip(0).prod(axis=1).sum())


def _touched_blocks(drawn: _Ellipses, camera: Camera, side: int) -> int:
    """Blocks of ``side`` x ``side`` pixels with a pixel centre in an ellipse, summed over the ellipses."""
    half = np.sqrt(drawn.reach) / drawn.l22
    first = np.maximum(np.ceil(drawn.v - half - 0.5), 0)
    last = np.minimum(np.floor(drawn.v + half - 0.5), camera.height_px - 1)
    widest = drawn.l12 * half / np.hypot(drawn.l12, drawn.l22)  # dy of the leftmost point
    total = 0
    for top in range(0, camera.height_px, side):
        at = np.flatnonzero((first < top + side) & (last >= top))
        above = np.maximum(first[at], top) + 0.5 - drawn.v[at]
        below = np.minimum(last[at], top + side - 1) + 0.5 - drawn.v[at]
        spans = []
        for dy, sign in ((np.clip(widest[at], above, below), -1), (np.clip(-widest[at], above, below), 1)):
            root = np.sqrt(np.maximum(drawn.reach[at] - (drawn.l22[at] * dy) ** 2, 0.0))
            spans.append(drawn.u[at] + (sign * root - drawn.l12[at] * dy) / drawn.l11[at])
        low, high = np.maximum(np.ceil(spans[0] - 0.5), 0), np.minimum(np.floor(spans[1] - 0.5), camera.width_px - 1)
        total += int((high // side - low // side + 1)[low <= high].sum())
    return total


def pass_times_ms(scene: ResidentScene, steps: Sequence[Dispatch]) -> dict[str, float]:
    """Milliseconds of each kind of pass in ``steps`` by the device's clock; empty if the device has no clock."""
    import wgpu

    if not scene.gpu.timestamps:
        return {}
    device = scene.gpu.device
    timed = [step for step in steps if step.pipeline is not None]
    queries = device.create_query_set(type="timestamp", count=2 * len(timed))
    usage = wgpu.BufferUsage.QUERY_RESOLVE | wgpu.BufferUsage.COPY_SRC
    ticks = device.create_buffer(size=16 * len(timed), usage=usage)
    encoder = device.create_command_encoder()
    at = 0
    for step in steps:
        if step.pipeline is None:
            encode(encoder, [step])
            continue
        writes = {"query_set": queries, "beginning_of_pass_write_index": at, "end_of_pass_write_index": at + 1}
        running = encoder.begin_compute_pass(timestamp_writes=writes)
        record(running, step)
        running.end()
        at += 2
    encoder.resolve_query_set(queries, 0, 2 * len(timed), ticks, 0)
    device.queue.submit([encoder.finish()])
    pairs = np.frombuffer(device.queue.read_buffer(ticks), np.uint64).reshape(-1, 2)
    total: dict[str, float] = {}
    for step, (begin, end) in zip(timed, pairs.tolist(), strict=True):
        total[step.label] = total.get(step.label, 0.0) + (end - begin) / 1e6
    return total


def frame_times_ms(scene: ResidentScene, camera: Camera, options: RenderOptions) -> dict[str, float]:
    """Milliseconds of each pass of a drawing. Called with the device's lock held, after the frame was drawn once."""
    steps: list[Dispatch] = []

    def drawn(recording: Recording) -> Outputs:
        target = scene.record(recording, camera, options)
        steps[:] = scene.steps_of(target, options)
        return []

    submitted(scene.workspace, drawn)
    return pass_times_ms(scene, steps)
