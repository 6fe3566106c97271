"""Several views of one size, drawn together as layers.

A small view hardly occupies a device: its time goes into dispatches that wait for one another, and into recording
them. Sixteen views cost few more dispatches than one. Splats, tiles and pixels of each layer follow those of the layer
before; sorts are stable, and tiles are each layer's own, so that every picture has the bits of one drawn alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

from cags_common.geometry import Camera
from cags_common.raster.base import RenderOptions
from cags_gpu.device import Handle
from cags_gpu.graph import MAX_GROUPS, Dispatch, build, encode
from cags_gpu.layout import COUNT, VIEW
from cags_gpu.scene import ResidentScene, Target, packed, view_counts
from cags_gpu.submission import Recording
from cags_gpu.workspace import LAYERS, VIEW_BYTES

SPLATS_A_GROUP = 256
RECORD_BYTES = 32


@dataclass(frozen=True, eq=False)
class Layer:
    """A view to draw. All layers have pictures of one size, scenes of as many splats, and the same options but for
    their footprints.
    """

    scene: ResidentScene
    camera: Camera
    options: RenderOptions


def most_layers(splats: int, binding_bytes: int) -> int:
    """How many layers of as many splats a device draws together; at least one."""
    return max(1, min(LAYERS, binding_bytes // (RECORD_BYTES * splats), MAX_GROUPS * SPLATS_A_GROUP // splats))


def record_layers(recording: Recording, target: Target, layers: Sequence[Layer], first_view: int = 0) -> None:
    """Record ``layers``: afterwards the target holds their pictures and depths, and the workspace contributions.

    ``first_view``: the workspace's views from there on are used; one recording may not use any of them twice.
    """
    front = layers[0]
    workspace, options, splats = front.scene.workspace, front.options, front.scene.count
    exact = not packed(options)
    workspace.reserve(len(layers) * splats, exact=exact)
    views = bytearray()
    for k, layer in enumerate(layers):
        at = len(views)
        views += layer.scene.view_bytes(layer.camera, layer.options, len(layers)).ljust(VIEW_BYTES, b"\0")
        VIEW.put(views, at, "base", k * splats)
    workspace.gpu.device.queue.write_buffer(workspace.views, first_view * VIEW_BYTES, views)
    steps = [
        layer.scene.layer_steps(k * splats, workspace.view(first_view + k), exact=exact)
        for k, layer in enumerate(layers)
    ]
    order = _order(recording, target, layers)
    encode(recording.encoder, chain(*order, *steps, _draw_steps(target, front, len(layers), first_view)))


def _order(recording: Recording, target: Target, layers: Sequence[Layer]) -> list[list[Dispatch]]:
    """What puts the layers in the order of their splats' contents. Several that have just changed are sorted together,
    into an order in which layers lie between one another; the sort by depth keeps it within each. A scene that is drawn
    again as it is gets an order of its own, which lasts.
    """
    workspace, splats = layers[0].scene.workspace, layers[0].scene.count
    scenes = dict.fromkeys(layer.scene for layer in layers)
    together = sum(scene.restless() for scene in scenes) > 1
    if not together:
        for scene in scenes:
            scene.put_in_order(recording)
    steps = [layer.scene.layer_order_steps(k * splats, together=together) for k, layer in enumerate(layers)]
    if together:
        total = len(layers) * splats
        named = {"count_job": workspace.gpu.uniform(COUNT.pack(count=total))}

        def make() -> list[Dispatch]:
            return build(workspace.gpu, "order", {"splats": total}, {}, lambda name: named.get(name) or workspace[name])

        steps.append(target.steps(workspace.version, ("order", total), make))
    return steps


def _draw_steps(target: Target, front: Layer, layers: int, first_view: int) -> list[Dispatch]:
    """What follows the projection; ``front``: any of the layers."""
    workspace, counting = front.scene.workspace, front.options.contribution
    splats = front.scene.count
    flags = {"packed": packed(front.options), "compact": False, "slots": counting, "contribution": counting}
    counts = workspace.counts | view_counts(front.camera, layers) | {"splats": layers * splats}

    def find(name: str) -> Handle:
        if name == "view":
            return workspace.view(first_view)
        return target[name] if name in target else workspace["layer_order" if name == "by_hash" else name]

    key = ("layers", layers, splats, first_view, *flags.values())
    return target.steps(workspace.version, key, lambda: build(workspace.gpu, "draw", counts, flags, find))
