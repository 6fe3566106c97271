"""Frames recorded, submitted and read back at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cags_gpu.device import Gpu, Handle
from cags_gpu.workspace import Workspace

Outputs = Sequence[tuple[Handle, int]]
"""Buffers to read back, and how many bytes of each."""


class Recording:
    """Commands that are not yet submitted, and what is to be noted once what they draw is right."""

    def __init__(self, gpu: Gpu) -> None:
        self.encoder = gpu.device.create_command_encoder()
        self.once_drawn: list[Callable[[], None]] = []


def submitted(workspace: Workspace, record: Callable[[Recording], Outputs]) -> list[NDArray[np.uint8]]:
    """Record, submit and read back; again with larger buffers where there were more entries than room for them.

    The arrays belong to the caller.

    ``record`` puts any number of frames into the recording; it may be called more than once.
    """
    while True:
        version = workspace.version
        recording = Recording(workspace.gpu)
        recording.encoder.clear_buffer(workspace["state"])
        outputs = record(recording)
        if workspace.version != version:
            continue  # buffers were replaced: what was recorded before that refers to the old ones
        state, *read = _read(workspace, recording, [(workspace["state"], 16), *outputs])
        if workspace.grow(int(state.view(np.uint32)[3])):
            for noted in recording.once_drawn:
                noted()
            return read


def read_back(workspace: Workspace, buffer: Handle, size: int) -> NDArray[np.uint8]:
    """The first ``size`` bytes of a buffer, once what was submitted before is done."""
    (read,) = _read(workspace, Recording(workspace.gpu), [(buffer, size)])
    return read


def _read(workspace: Workspace, recording: Recording, wanted: Outputs) -> list[NDArray[np.uint8]]:
    """Bytes of several buffers through one that the host maps."""
    import wgpu

    total = sum(size for _, size in wanted)
    through = workspace.readback(total)
    at = 0
    for buffer, size in wanted:
        recording.encoder.copy_buffer_to_buffer(buffer, 0, through, at, size)
        at += size
    workspace.gpu.device.queue.submit([recording.encoder.finish()])
    through.map_sync(wgpu.MapMode.READ, 0, total)
    try:
        # numpy copies, because its large arrays use huge pages, which makes their first use much faster
        everything = np.frombuffer(through.read_mapped(0, total, copy=False), np.uint8).copy()
    finally:
        through.unmap()
    return np.split(everything, np.cumsum([size for _, size in wanted])[:-1])
