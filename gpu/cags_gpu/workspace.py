"""Working memory of a device: buffers that all scenes share, for frames follow one another on its queue."""

from __future__ import annotations

from cags_common.errors import CagsError
from cags_gpu.device import Gpu, Handle
from cags_gpu.graph import buffer_bytes
from cags_gpu.layout import VIEW

LEAST_CAPACITY = 1 << 16
"""Entries (splat, tile) that a frame may have at first; it grows with what frames ask for."""

LAYERS = 16
"""Views that are drawn together at most: more would need buffers that not every device has."""

VIEW_BYTES = 512
"""Of a ``View`` among others: uniform bindings begin at multiples of 256 bytes."""

HEADROOM = 1.5
CROWDED = 0.8
"""Beyond this share of the capacity it grows before the next frame, so that hardly any frame is drawn twice."""


class TooLargeError(CagsError):
    """A frame or scene that this adapter's buffers cannot hold."""


class Workspace:
    """Buffers of the owner ``work`` in the graph. ``version`` changes when bind groups on them have to be made anew."""

    def __init__(self, gpu: Gpu) -> None:
        self.gpu = gpu
        self._buffers: dict[str, Handle] = {}
        self._readbacks: list[Handle] = []
        self.views = gpu.buffer(2 * LAYERS * VIEW_BYTES, uniform=True)
        """Cameras of layers: of two drawings in one submission."""
        self.version = 0
        self.counts = {"one": 1, "splats": 1, "exact_splats": 1, "capacity": LEAST_CAPACITY}

    def reserve(self, splats: int, *, exact: bool, capacity: int = 0) -> None:
        """Make room for a scene of ``splats``, and for ``capacity`` entries. Raises :class:`TooLargeError`."""
        needed = {"splats": splats, "exact_splats": splats if exact else 1, "capacity": capacity}
        grown = {name: count for name, count in needed.items() if count > self.counts[name]}
        if not grown:
            return
        counts = self.counts | grown
        self._check(counts)
        self.counts = counts
        self._buffers.clear()
        self.version += 1

    def crowded(self, wanted: int) -> bool:
        """Whether there is room for hardly more entries, or not even for as many."""
        return wanted > CROWDED * self.counts["capacity"]

    def grow(self, wanted: int) -> bool:
        """Grow for frames that want as many entries; whether the frame that did fitted."""
        fitted = wanted <= self.counts["capacity"]
        if self.crowded(wanted):
            most = self.gpu.max_binding_bytes // 4
            self.reserve(1, exact=False, capacity=max(wanted, min(int(wanted * HEADROOM), most)))
        return fitted

    def __getitem__(self, name: str) -> Handle:
        if name not in self._buffers:
            size = buffer_bytes("work", self.counts)[name]
            self._limit(name, size)
            self._buffers[name] = self.gpu.buffer(size, indirect=name == "dispatch")
        return self._buffers[name]

    def view(self, number: int) -> Handle:
        """One of :attr:`views`, to be bound."""
        return {"buffer": self.views, "offset": number * VIEW_BYTES, "size": VIEW.size}

    def take_readback(self, size: int) -> Handle:
        """A buffer of at least ``size`` bytes that the host maps; called with the device's lock held."""
        import wgpu

        found = next((buffer for buffer in self._readbacks if buffer.size >= size), None)
        if found is not None:
            self._readbacks.remove(found)
            return found
        self._readbacks.clear()  # smaller ones
        usage = wgpu.BufferUsage.MAP_READ | wgpu.BufferUsage.COPY_DST
        return self.gpu.device.create_buffer(size=size, usage=usage)

    def give_readback(self, buffer: Handle) -> None:
        """It has been read."""
        self._readbacks.append(buffer)

    def _check(self, counts: dict[str, int]) -> None:
        sizes = buffer_bytes("work", counts)
        for name in ("records", "colours", "tile_a"):  # what is largest of those that every frame has
            self._limit(name, sizes[name])

    def _limit(self, name: str, size: int) -> None:
        most = self.gpu.max_binding_bytes
        if size > most:
            mib = f"{size / 2**20:.0f} MiB is over the {most / 2**20:.0f} MiB"
            raise TooLargeError(f"buffer {name!r} of {mib} that {self.gpu.info.name} binds; draw fewer splats")
