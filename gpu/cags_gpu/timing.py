"""Counts of a frame's work, and times of its passes, measured on the device."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cags_common.correction import Placement
from cags_common.geometry import Camera
from cags_common.raster.base import Exactness, RenderOptions
from cags_gpu.graph import Dispatch, encode, record
from cags_gpu.layout import TILE_PX
from cags_gpu.scene import ResidentScene
from cags_gpu.submission import Outputs, Recording, submitted
from cags_gpu.work import FrameCounts

LOG2_ALPHA_CUT = -7.99435344
LEAST_LOG2 = -8.0


def frame_counts(
    scene: ResidentScene, camera: Camera, options: RenderOptions, reference: Camera | None = None
) -> FrameCounts:
    """Count a frame without blending it. Called with the device's lock held."""

    def binned(recording: Recording) -> Outputs:
        scene.record_binning(recording, camera, options)
        records = (scene.workspace["records"], 32 * scene.count)
        return [(scene.workspace["state"], 16), (scene.workspace["touched"], 4 * scene.count), records]

    state, touched, records = submitted(scene.workspace, binned)
    seen = touched.view(np.uint32) > 0
    words = records.view(np.uint32).reshape(-1, 8)[seen]
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
        box_entries=_box_entries(words, camera, packed=options.exactness is not Exactness.EXACT),
        entries=int(state.view(np.uint32)[1]),
        pixels=camera.width_px * camera.height_px,
        harmonics=scene.sh_count,
        **other,
    )


def _box_entries(words: np.ndarray, camera: Camera, *, packed: bool) -> int:
    """Tiles of the boxes around the ellipses of records [M, 8]."""
    u, v, l11, l12, l22 = (words[:, i].view(np.float32).astype(np.float64) for i in range(5))
    strength = words[:, 6].view(np.float32).astype(np.float64)
    if packed:
        strength = ((words[:, 7] >> 16) / 65535.0 - 1.0) * -LEAST_LOG2
    root = np.sqrt(np.maximum(strength - LOG2_ALPHA_CUT, 0.0))
    half = np.stack([root * np.hypot(l12, l22) / (l11 * l22), root / l22], axis=1)
    centre, size = np.stack([u, v], axis=1), np.array([camera.width_px, camera.height_px])
    low = np.clip(np.ceil(centre - half - 0.5), 0, size - 1) // TILE_PX
    high = np.clip(np.floor(centre + half - 0.5), 0, size - 1) // TILE_PX
    return int((high - low + 1).clip(0).prod(axis=1).sum())


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
