"""A scene in a device's memory: uploaded, changed in part, recorded into frames."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, takewhile
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Exactness, RasterScene, RenderedView, RenderOptions
from cags_common.splats import SH_REST_OF_DEGREE, Splats
from cags_gpu.device import Gpu, Handle
from cags_gpu.graph import Dispatch, buffer_bytes, build, encode
from cags_gpu.layout import CHUNK, COUNT, UPDATE, VIEW, tiles_of, view_bytes
from cags_gpu.submission import Recording
from cags_gpu.workspace import TooLargeError, Workspace

Result = TypeVar("Result")

STAGED_BYTES = 32 << 20
"""Rows go to the device in pieces of at most this size."""

KEPT_TARGETS = 8
"""Sets of buffers of pictures that a scene keeps."""


class SceneOnDevice(Protocol):
    """A scene that a device draws, or the CPU while there is no device: what frames and comparisons need of it."""

    def __len__(self) -> int: ...

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        """Render one view over black."""
        ...

    def on_device(self, draw: Callable[[ResidentScene], Result], instead: Callable[[RasterScene], Result]) -> Result:
        """The result of ``draw`` on the device, or of ``instead`` on the CPU."""
        ...

    def on(self, workspace: Workspace) -> ResidentScene:
        """The scene in that device's memory; called with the device's lock held."""
        ...


@dataclass(frozen=True)
class Columns:
    """What is replaced in ``rows`` [M] (unique): motion, or looks, or base colours, or all of them."""

    rows: NDArray[np.int64]
    motion: tuple[F32, F32, F32] | None = None  # means [M, 3], logits [M], quats [M, 4]
    looks: tuple[F32, F32] | None = None  # log scales [M, 3], sh_rest [M, K, 3]
    colours: F32 | None = None  # sh0 [M, 3]

    @classmethod
    def of(cls, rows: NDArray[np.int64], splats: Splats) -> Columns:
        """All columns."""
        motion = splats.means, splats.logit_opacities, splats.quats
        return cls(rows, motion, (splats.log_scales, splats.sh_rest), splats.sh0)

    def staged(self, max_bytes: int) -> list[NDArray[np.uint32]]:
        """Rows as they go to the device [m, 1 + words], in pieces of at most ``max_bytes``."""
        parts: list[F32] = []
        if self.motion:
            parts += [self.motion[0], self.motion[1][:, None], self.motion[2]]
        if self.looks:
            parts.append(self.looks[0])
        if self.colours is not None:
            parts.append(self.colours)
        if self.looks:
            parts.append(self.looks[1])
        words = [part.reshape(len(self.rows), math.prod(part.shape[1:])) for part in parts]
        piece = max(1, max_bytes // (4 * (1 + sum(word.shape[1] for word in words))))
        return [self._packed(words, slice(start, start + piece)) for start in range(0, len(self.rows), piece)]

    def _packed(self, words: Sequence[F32], part: slice) -> NDArray[np.uint32]:
        rows = self.rows[part]
        out = np.empty((len(rows), 1 + sum(word.shape[1] for word in words)), np.uint32)
        out[:, 0] = rows
        np.concatenate([word[part] for word in words], axis=1, out=out.view(np.float32)[:, 1:])
        return out

    @property
    def flags(self) -> dict[str, bool]:
        """The constants of the shader ``update``."""
        return {"motion": self.motion is not None, "looks": self.looks is not None, "colour": self.colours is not None}


@dataclass(frozen=True)
class Chunk:
    """Splats whose harmonics lie in one buffer."""

    first: int
    count: int
    sh_rest: Handle
    job: Handle


def view_counts(camera: Camera, layers: int = 1) -> dict[str, int]:
    """What sizes and dispatches of a picture of the camera's size depend on: of ``layers`` below one another."""
    (tiles_x, tiles_y), (width, height) = tiles_of(camera), (camera.width_px, camera.height_px)
    cells_x, cells_y = -(-width // 8), -(-height // 8)
    return {
        "tiles": tiles_x * tiles_y * layers,
        "tiles_x": tiles_x,
        "tiles_y": tiles_y * layers,
        "pixels": width * height * layers,
        "pixels_x": width,
        "pixels_y": height * layers,
        "cells_x": cells_x,
        "cells_y": cells_y,
        "cells": 2 * cells_x * cells_y + 64,  # all levels together
        "one": 1,
        "tile_bits": max(1, (tiles_x * tiles_y * layers).bit_length()),  # one tile more than there are: padding
    }


class Target:
    """The buffers of pictures of one size, of as many ``layers`` as there may be, and the recorded steps of each kind
    of frame.
    """

    def __init__(self, gpu: Gpu, camera: Camera, layers: int = 1) -> None:
        self._gpu = gpu
        self.counts = view_counts(camera, layers)
        self.view = gpu.buffer(VIEW.size, uniform=True)
        self._steps: dict[tuple[object, ...], list[Dispatch]] = {}
        self._buffers: dict[str, Handle] = {}
        self._uniforms: dict[str, Handle] = {}
        self._holders: list[weakref.ReferenceType[object]] = []

    @property
    def held(self) -> bool:
        """Whether somebody may still look at the pictures."""
        return any(holder() is not None for holder in self._holders)

    def hold_for(self, *holders: object) -> None:
        """Leave the pictures as they are as long as one of them lives."""
        self._holders = [weakref.ref(holder) for holder in holders]

    def uniform(self, name: str, data: bytes) -> Handle:
        """The uniform buffer of a name; the next submission sees ``data`` in it."""
        if name not in self._uniforms:
            self._uniforms[name] = self._gpu.buffer(len(data), uniform=True)
        self._gpu.device.queue.write_buffer(self._uniforms[name], 0, data)
        return self._uniforms[name]

    def steps(self, version: int, key: tuple[object, ...], make: Callable[[], list[Dispatch]]) -> list[Dispatch]:
        """What ``make`` records, made once for a key; those of other versions of the shared buffers are dropped."""
        if (version, key) not in self._steps:
            self._steps = {held: steps for held, steps in self._steps.items() if held[0] == version}
            self._steps[version, key] = make()
        return self._steps[version, key]

    def __contains__(self, name: str) -> bool:
        return name in buffer_bytes("view", self.counts)

    def __getitem__(self, name: str) -> Handle:
        if name not in self._buffers:
            size = buffer_bytes("view", self.counts)[name]
            if size > self._gpu.max_binding_bytes:
                raise TooLargeError(f"buffer {name!r} of {size} bytes is over what {self._gpu.info.name} binds")
            self._buffers[name] = self._gpu.buffer(size)
        return self._buffers[name]


class ResidentScene:
    """Splats on one device. Every method is called with the device's lock held."""

    def __init__(self, workspace: Workspace, splats: Splats) -> None:
        gpu = self.gpu = workspace.gpu
        self.workspace = workspace
        self.count, self.sh_count = len(splats), splats.sh_rest.shape[1]
        sizes = buffer_bytes("scene", {"splats": self.count})
        if max(sizes.values()) > gpu.max_binding_bytes:
            most = gpu.max_binding_bytes // 32
            raise TooLargeError(f"scene of {self.count} splats: {gpu.info.name} binds {most} at most; use 'cpu'")
        workspace.reserve(self.count, exact=False, capacity=4 * self.count)
        self._buffers = {name: gpu.buffer(size) for name, size in sizes.items()}
        self._chunks = self._chunked()
        self._targets: dict[tuple[int, int, str], Target] = {}
        self._kept: dict[str, Handle] = {}
        self.kept_version = 0
        self.changes = 0
        """How often splats were replaced."""
        self.held: tuple[object, object] | None = None
        """What the buffers of the reference hold: an object that is kept alive, and what it was made under."""
        self._unsorted = True
        self._recorded: dict[object, list[Dispatch]] = {}
        self._recorded_for = -1
        self._asked_at = -1
        every = Columns.of(np.arange(self.count), splats)
        self.change(every.flags, self.staged(every))

    def _chunked(self) -> list[Chunk]:
        words = 3 * self.sh_count
        most = max(1, self.gpu.max_binding_bytes // (4 * words)) if words else self.count
        chunks = []
        for first in range(0, self.count, most):
            size = min(most, self.count - first)
            job = self.gpu.uniform(CHUNK.pack(first=first, count=size))
            chunks.append(Chunk(first, size, self.gpu.buffer(4 * words * size), job))
        return chunks

    def staged(self, columns: Columns) -> list[NDArray[np.uint32]]:
        """``columns`` as :meth:`change` takes them. Needs no lock: others may record meanwhile."""
        return columns.staged(min(STAGED_BYTES, self.gpu.max_binding_bytes))

    def change(self, flags: Mapping[str, bool], staged: Sequence[NDArray[np.uint32]]) -> None:
        """Replace columns of rows; the cost is proportional to their number."""
        for packed in staged:
            self._stage(packed, flags)
        self._unsorted |= bool(staged)
        self.changes += bool(staged)

    def _stage(self, packed: NDArray[np.uint32], flags: Mapping[str, bool]) -> None:
        import wgpu

        staged = self.gpu.device.create_buffer_with_data(data=packed, usage=wgpu.BufferUsage.STORAGE)
        job = self.gpu.buffer(UPDATE.size, uniform=True)  # not a shared one: hardly two updates have as many rows
        words = UPDATE.pack(rows=len(packed), sh_words=3 * self.sh_count, width=packed.shape[1] - 1)
        self.gpu.device.queue.write_buffer(job, 0, words)
        encoder = self.gpu.device.create_command_encoder()
        for chunk in self._chunks:
            named = {"staged": staged, "update_job": job, "chunk": chunk.job, "sh_rest": chunk.sh_rest}
            encode(
                encoder, build(self.gpu, "update", {"rows": len(packed)}, flags, (self._buffers | named).__getitem__)
            )
        self.gpu.device.queue.submit([encoder.finish()])

    def kept(self, name: str, size: int) -> Handle:
        """A buffer of the scene's own, made when it is first asked for or was smaller."""
        held = self._kept.get(name)
        if held is None or held.size < size:
            held = self._kept[name] = self.gpu.buffer(size)
            self.kept_version += 1
        return held

    def hold(self, owner: object, made_under: object) -> None:
        """Note what the buffers of the reference hold now."""
        self.held = owner, made_under

    def target(self, camera: Camera, role: str = "") -> Target:
        """The buffers of pictures of the camera's size; ``role`` keeps two of one size apart."""
        key = (camera.width_px, camera.height_px, role)
        found = self._targets.pop(key, None) or Target(self.gpu, camera)
        self._targets[key] = found  # the last used is the last to go
        while len(self._targets) > KEPT_TARGETS:
            del self._targets[next(iter(self._targets))]
        return found

    def spare_role(self, camera: Camera) -> str:
        """The role of a target that nobody looks at any more, or of a new one."""
        key = camera.width_px, camera.height_px
        roles = (f"frame {i}" for i in count())
        return next(role for role in roles if not ((found := self._targets.get((*key, role))) and found.held))

    def record(self, recording: Recording, camera: Camera, options: RenderOptions, *, role: str = "") -> Target:
        """Record a frame: afterwards the target holds picture and depth, the workspace contributions and counts."""
        target = self.target(camera, role)
        self.record_into(recording, target, camera, options)
        return target

    def record_into(
        self, recording: Recording, target: Target, camera: Camera, options: RenderOptions, *, compact: bool = False
    ) -> None:
        """As :meth:`record`, into buffers that are at hand; the picture is ``compact`` for what only a display sees:
        16 bits a channel, colours up to 1.
        """
        self._prepare(recording, target, camera, options)
        encode(recording.encoder, self.steps_of(target, options, compact=compact))

    def record_binning(self, recording: Recording, camera: Camera, options: RenderOptions) -> Target:
        """Record a frame without blending it: afterwards the workspace holds records, tiles and counts."""
        target = self.target(camera)
        self._prepare(recording, target, camera, options)
        steps = self.steps_of(target, options)
        encode(recording.encoder, takewhile(lambda step: not step.label.startswith("blend"), steps))
        return target

    def _prepare(self, recording: Recording, target: Target, camera: Camera, options: RenderOptions) -> None:
        self.workspace.reserve(self.count, exact=not packed(options))
        self.gpu.device.queue.write_buffer(target.view, 0, self.view_bytes(camera, options))
        self.put_in_order(recording)

    def view_bytes(self, camera: Camera, options: RenderOptions, layers: int = 1) -> bytes:
        """The ``View`` of the scene, the first of ``layers``; after the workspace has reserved room for them."""
        used = min(self.sh_count, SH_REST_OF_DEGREE[options.max_sh_degree])
        counted = {"splats": self.count, "sh_count": self.sh_count, "sh_used": used}
        seen = replace(options, contribution=False, depth=DepthKind.NONE)  # which truth and mirror have in common
        return view_bytes(camera, seen, **counted, capacity=self.workspace.counts["capacity"], layers=layers)

    def restless(self) -> bool:
        """Whether the order of the splats' contents is not known, and they have changed since this was last asked."""
        asked, self._asked_at = self._asked_at, self.changes
        return self._unsorted and asked != self.changes

    def put_in_order(self, recording: Recording) -> None:
        """Record the sort by content, if splats have changed."""
        if self._unsorted:
            encode(recording.encoder, self._own_steps("hash", self._hash_steps))
            recording.once_drawn.append(self._is_sorted)

    def layer_order_steps(self, base: int, *, together: bool) -> list[Dispatch]:
        """Put the scene's order into the layer that begins at splat ``base`` of the workspace; or (``together``) its
        contents, for all layers to be sorted together.
        """

        def make() -> list[Dispatch]:
            named = {"count_job": self.gpu.uniform(COUNT.pack(count=self.count, base=base))}
            graph = "gathered" if together else "layer"
            return build(self.gpu, graph, {"layer_splats": self.count}, {}, lambda name: self._find(name, named))

        return self._own_steps(("order", base, together), make)

    def layer_steps(self, base: int, view: Handle, *, exact: bool) -> list[Dispatch]:
        """Project the scene into the layer that begins at splat ``base`` of the workspace.

        ``view`` is one of the workspace's, and always the same for a ``base`` and ``exact``.
        """

        def make() -> list[Dispatch]:
            named = {"view": view, "ranks": self.workspace["layer_ranks"]}
            return self._project_steps({"packed": not exact}, named)

        return self._own_steps(("layer", base, view["offset"], exact), make)

    def steps_of(self, target: Target, options: RenderOptions, *, compact: bool = False) -> list[Dispatch]:
        """The dispatches of a frame with these options."""
        flags = {
            "packed": packed(options),
            "compact": compact,
            "slots": options.contribution,
            "contribution": options.contribution,
        }
        return self._steps(target, flags)

    def _is_sorted(self) -> None:
        self._unsorted = False

    def _steps(self, target: Target, flags: dict[str, bool]) -> list[Dispatch]:
        return target.steps(self.workspace.version, tuple(flags.items()), lambda: self._frame_steps(target, flags))

    def _own_steps(self, key: object, make: Callable[[], list[Dispatch]]) -> list[Dispatch]:
        """As :meth:`Target.steps`, of what depends on the scene and the workspace alone."""
        if self._recorded_for != self.workspace.version:
            self._recorded, self._recorded_for = {}, self.workspace.version
        if key not in self._recorded:
            self._recorded[key] = make()
        return self._recorded[key]

    def counts_of(self, target: Target) -> dict[str, int]:
        """Everything that sizes and dispatches of a frame depend on."""
        return self.workspace.counts | target.counts | {"splats": self.count}

    def _hash_steps(self) -> list[Dispatch]:
        job = self.gpu.uniform(COUNT.pack(count=self.count))
        counts = {"splats": self.count}
        return build(self.gpu, "hash", counts, {}, lambda name: self._find(name, {"count_job": job}))

    def _project_steps(self, flags: dict[str, bool], named: Mapping[str, Handle]) -> list[Dispatch]:
        steps: list[Dispatch] = []
        for chunk in self._chunks:
            of_chunk = {**named, "chunk": chunk.job, "sh_rest": chunk.sh_rest}
            counts = {"chunk_splats": chunk.count}
            steps += build(self.gpu, "project", counts, flags, lambda name, of=of_chunk: self._find(name, of))  # type: ignore[misc]
        return steps

    def _frame_steps(self, target: Target, flags: dict[str, bool]) -> list[Dispatch]:
        named = {"view": target.view}

        def find(name: str) -> Handle:
            return target[name] if name in target else self._find(name, named)

        steps = self._project_steps(flags, named)
        return steps + build(self.gpu, "draw", self.counts_of(target), flags, find)

    def _find(self, name: str, named: Mapping[str, Handle]) -> Handle:
        if name in named:
            return named[name]
        return self._buffers[name] if name in self._buffers else self.workspace[name]


def packed(options: RenderOptions) -> bool:
    """Whether records of 32 bytes are exact enough."""
    return options.exactness is not Exactness.EXACT
