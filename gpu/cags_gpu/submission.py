"""Frames recorded, submitted and read back."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cags_gpu.device import Gpu, Handle
from cags_gpu.workspace import Workspace

PIECE_BYTES = 2 << 20
COPIERS = 4
"""What comes back is copied by as many threads, in pieces of this size."""


class Output(NamedTuple):
    """A buffer to read back: the first ``size`` bytes, in as many arrays of one size as it has ``parts``."""

    buffer: Handle
    size: int
    parts: int = 1
    start: int = 0


Outputs = Sequence[Output]


class Recording:
    """Commands that are not yet submitted, and what is to be noted once what they draw is right."""

    def __init__(self, gpu: Gpu) -> None:
        self.encoder = gpu.device.create_command_encoder()
        self.once_drawn: list[Callable[[], None]] = []


class Submission:
    """Frames that are on their way: recorded and submitted with the device's lock held, read with or without it."""

    def __init__(self, workspace: Workspace, record: Callable[[Recording], Outputs]) -> None:
        """``record`` puts any number of frames into the recording; it may be called more than once."""
        self._workspace = workspace
        while True:
            version = workspace.version
            recording = Recording(workspace.gpu)
            recording.encoder.clear_buffer(workspace["state"])
            outputs = record(recording)
            if workspace.version == version:
                break  # else buffers were replaced: what was recorded before that refers to the old ones
        self._noted, self.capacity = recording.once_drawn, workspace.counts["capacity"]
        self._back = _submit(workspace, recording, [Output(workspace["state"], 16), *outputs])

    def read(self) -> tuple[list[NDArray[np.uint8]], int]:
        """Wait for the outputs; and how many entries the frames wanted at most: only with room for them are they right.

        The arrays belong to the caller: those of each output in turn.
        """
        state, *read = _read(self._workspace, *self._back)
        wanted = int(state.view(np.uint32)[3])
        if wanted <= self.capacity:
            for noted in self._noted:
                noted()
        return read, wanted


def submitted(workspace: Workspace, record: Callable[[Recording], Outputs]) -> list[NDArray[np.uint8]]:
    """Record, submit and read; again with larger buffers where there were more entries than room for them.

    Called with the device's lock held; otherwise as :class:`Submission`.
    """
    while True:
        read, wanted = Submission(workspace, record).read()
        if workspace.grow(wanted):
            return read


def read_back(workspace: Workspace, buffer: Handle, size: int, start: int = 0) -> NDArray[np.uint8]:
    """``size`` bytes of a buffer, once what was submitted before is done."""
    (read,) = _read(workspace, *_submit(workspace, Recording(workspace.gpu), [Output(buffer, size, start=start)]))
    return read


def _submit(workspace: Workspace, recording: Recording, wanted: Outputs) -> tuple[Handle, list[int]]:
    """Bring several buffers into one that the host maps; that one, and where they and their parts begin and end."""
    through = workspace.take_readback(sum(output.size for output in wanted))
    cuts = [0]
    for buffer, size, parts, start in wanted:
        recording.encoder.copy_buffer_to_buffer(buffer, start, through, cuts[-1], size)
        cuts += [cuts[-1] + size // parts * (part + 1) for part in range(parts)]
    workspace.gpu.device.queue.submit([recording.encoder.finish()])
    return through, cuts


def _read(workspace: Workspace, through: Handle, cuts: list[int]) -> list[NDArray[np.uint8]]:
    import wgpu

    through.map_sync(wgpu.MapMode.READ, 0, cuts[-1])
    try:
        return _copied(np.frombuffer(through.read_mapped(0, cuts[-1], copy=False), np.uint8), cuts)
    finally:
        through.unmap()
        workspace.give_readback(through)


def _copied(mapped: NDArray[np.uint8], cuts: Sequence[int]) -> list[NDArray[np.uint8]]:
    """Arrays of what lies between ``cuts``, each of its own: some are kept for long. numpy's, because its large arrays
    use huge pages, which makes their first use much faster; copied by several threads, because one alone takes longer
    than the device to draw.
    """
    copies = [np.empty(end - begin, np.uint8) for begin, end in pairwise(cuts)]
    pieces = [
        (copy[at : at + PIECE_BYTES], mapped[begin:end][at : at + PIECE_BYTES])
        for copy, (begin, end) in zip(copies, pairwise(cuts), strict=True)
        for at in range(0, len(copy), PIECE_BYTES)
    ]
    run = map if cuts[-1] <= PIECE_BYTES else _copiers().map
    for _ in run(np.copyto, *zip(*pieces, strict=True)):
        pass
    return copies


@cache
def _copiers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(COPIERS, os.cpu_count() or 1), "gpu-read-back")
