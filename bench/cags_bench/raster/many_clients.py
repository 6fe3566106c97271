"""References per second for many clients, of one server or of several processes that share a device."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from threading import BrokenBarrierError
from typing import TYPE_CHECKING, Any

import numpy as np

from cags_bench.jsonl import check
from cags_bench.raster.cases import REFERENCE_SIZE, size_text, view_of
from cags_bench.raster.settings import RasterSettings
from cags_common.correction import Look
from cags_common.geometry import Camera, Pose
from cags_common.raster import Footprint, RenderOptions, create
from cags_common.splats import Splats
from cags_common.words import counted
from cags_encoder.scenes import FrameSource, open_scene
from cags_gpu.raster import GpuScene

if TYPE_CHECKING:
    from threading import Barrier

SCENE = "procedural:size={splats},frames=1"
FRAME_SPLATS = 150_000

CLIENTS_RATE = 64, 30
"""Target: number of clients, and references per second for each."""

WAKE_S = 2.0
"""Frames before those that are timed, once all pipelines are made: a device at rest runs at a fifth of its clock."""

KNEE = 0.1

MOVING_SHARE = 1 / 8
"""Splats that move in every frame of the mirrors that do."""

LOOKS = Look.LACK, Look.COMPANDED

START_S = 300.0
"""Largest time between two processes that wait for each other."""

Line = dict[str, Any]


@dataclass(frozen=True)
class Crowd:
    """The clients of one server."""

    settings: RasterSettings
    clients: int
    """Of all servers together."""
    mine: range
    """Which of them are this server's."""
    moving: bool
    """Whether splats of the mirrors move before each reference, as those of clients do."""


def reference_lines(settings: RasterSettings, truth: GpuScene) -> Iterator[Line]:
    """References per second of servers that render for all clients at once, each at a place of its own: truth and
    mirror are drawn, subtracted and companded, and both pictures come as floats. ``truth`` is the scene of the server
    in this process.
    """
    for clients in settings.client_list:
        for servers in (n for n in settings.server_list if n <= clients):
            for moving in (False, True):
                parts = [range(at, clients, servers) for at in range(servers)]
                crowds = [Crowd(settings, clients, part, moving) for part in parts]
                times = _side_by_side(crowds) if servers > 1 else [serve(crowds[0], lambda: None, truth)]
                taken = max(end for _, end in times) - min(start for start, _ in times)
                yield {
                    "case": "references",
                    "clients": clients,
                    "servers": servers,
                    "moving": moving,
                    "size": size_text(REFERENCE_SIZE),
                    "a_second": round(settings.repetitions * clients / taken, 1),
                }


def reference_checks(lines: list[Line]) -> list[Line]:
    """The checks of :func:`reference_lines`, if they have as many clients as the target."""
    clients, rate = CLIENTS_RATE
    many = [x for x in lines if x["case"] == "references" and x["clients"] == clients and not x["moving"]]
    return [
        check(
            f"references a second for {clients} clients, {counted(x['servers'], 'server')}",
            f">= {clients * rate}",
            x["a_second"],
            x["a_second"] >= clients * rate,
        )
        for x in many
    ]


def serve(crowd: Crowd, ready: Callable[[], object], truth: GpuScene | None = None) -> tuple[float, float]:
    """Make the references of ``crowd``, ``settings.repetitions`` for each client, one under way at a time, once
    ``ready`` returns; when they began and ended, seconds of the machine's monotonic clock.
    """
    settings = crowd.settings
    source, splats = client_scene(settings)
    scene = truth or _loaded(splats)
    view = view_of(source, *settings.size_list[-1])
    camera = replace(view, intrinsics=view.intrinsics.resized(*REFERENCE_SIZE))
    footprint = Footprint.of(view.intrinsics, camera.intrinsics)
    options = RenderOptions(footprint=footprint, contribution=True)
    places = _places(camera, source.focus.radius, crowd.clients)

    def compare(mirror: _Mirror, pose: Pose) -> None:
        if crowd.moving:
            mirror.move()
        views = scene.compared(mirror.scene, camera.at(pose), options, knee=KNEE, looks=LOOKS)
        if views is None:
            raise RuntimeError("the device was lost or cannot hold the scenes; draw fewer splats and run it again")
        _ = views.lack, views.companded(KNEE)

    def in_turn(mirror: _Mirror, pose: Pose) -> None:
        for _ in range(settings.repetitions):
            compare(mirror, pose)

    mirrors, poses = [_Mirror(splats, seed) for seed in crowd.mine], [places[at] for at in crowd.mine]
    with ThreadPoolExecutor(len(mirrors)) as pool:
        list(pool.map(compare, mirrors, poses))  # uploads, pipelines, room for entries
        ready()
        awake = time.monotonic() + WAKE_S
        while time.monotonic() < awake:
            list(pool.map(compare, mirrors, poses))
        ready()
        start = time.monotonic()
        list(pool.map(in_turn, mirrors, poses))
        return start, time.monotonic()


def client_scene(settings: RasterSettings) -> tuple[FrameSource, Splats]:
    """What clients see, and its first frame: small if all scenes of the benchmark are."""
    return _scene(min(FRAME_SPLATS, max(settings.growth_list)))


@cache
def _scene(count: int) -> tuple[FrameSource, Splats]:
    source = open_scene(SCENE.format(splats=count))
    return source, source.frame(0)


def _places(camera: Camera, radius: float, clients: int) -> list[Pose]:
    """Poses beside each other, so that no client's picture is another's."""
    aside = radius * np.outer(np.linspace(0, 0.5, clients), camera.pose.rotation_matrix[:, 0])
    return [replace(camera.pose, position=(x, y, z)) for x, y, z in (np.asarray(camera.pose.position) + aside).tolist()]


def _loaded(splats: Splats) -> GpuScene:
    scene = create("gpu").load(splats)
    assert isinstance(scene, GpuScene)
    return scene


class _Mirror:
    """A client's copy with different base colours, so that there is a difference to send."""

    def __init__(self, splats: Splats, seed: int) -> None:
        rng = np.random.default_rng(seed)
        noise = rng.normal(0.0, 0.1, splats.sh0.shape).astype(np.float32)
        held = replace(splats, sh0=splats.sh0 + noise)
        self.scene = _loaded(held)
        self._rows = np.sort(rng.choice(len(splats), round(MOVING_SHARE * len(splats)), replace=False))
        away = held.means.copy()
        away[self._rows] += np.exp(held.log_scales[self._rows].min(axis=1, keepdims=True))
        self._next, self._last = replace(held, means=away), held

    def move(self) -> None:
        """Show the other of two places of some splats."""
        self.scene.move(self._rows, self._next)
        self._next, self._last = self._last, self._next


# ------------------------------------------------------------------------------------------------- several processes


def _side_by_side(crowds: list[Crowd]) -> list[tuple[float, float]]:
    """Begin and end of each of ``crowds``, served by processes that begin together. Raises what went wrong first."""
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(len(crowds), timeout=START_S)
    with ProcessPoolExecutor(len(crowds), context, _meet_at, (barrier,)) as pool:
        futures = [pool.submit(_serve_together, crowd) for crowd in crowds]
        errors = [error for future in futures if (error := future.exception()) is not None]
    for error in sorted(errors, key=lambda error: isinstance(error, BrokenBarrierError)):
        raise error
    return [future.result() for future in futures]


_barriers: list[Barrier] = []
"""That of a process of :func:`_side_by_side`."""


def _meet_at(barrier: Barrier) -> None:
    _barriers.append(barrier)


def _serve_together(crowd: Crowd) -> tuple[float, float]:
    (barrier,) = _barriers
    try:
        return serve(crowd, barrier.wait)
    except BaseException:
        barrier.abort()  # the others would wait for this one
        raise
