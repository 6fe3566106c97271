"""What is compared: each method from a client's render and a reference to a picture, with the time of its stages."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from cags_bench.restore.cases import Case
from cags_client import align, restore
from cags_client.adapt import SirtAdapter
from cags_client.align import Aligned, Aligner, AlignSettings
from cags_client.align.fast import sample
from cags_client.restore import RESTORERS, RestoreInput, Restorer, networks
from cags_client.restore.affine import AffineRestorer, AffineSettings
from cags_client.restore.base import ALIGNED
from cags_common import raster
from cags_common.effects import Effect
from cags_common.errors import ConfigError
from cags_common.geometry import F32
from cags_common.raster.base import DepthKind, RenderedView, RenderOptions

Milliseconds = dict[str, float]

ADAPTER_STEPS = 6
"""Steps with the view's own reference where the walk before it is not looked at."""

DEPTH_TOLERANCE = 0.03
"""A pixel is hidden where it lies this share of the depth behind all that is drawn around it from the reference."""

FAR = 1e6


class SwapRestorer:
    """The aligned reference where it says something, erosion's fillings where it says nothing, else the distorted."""

    name = "aligned"
    needs = ALIGNED

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        aligned = inputs.aligned
        share = np.maximum(aligned.confidence, aligned.occluded)[..., None]
        return np.asarray(inputs.distorted + share * (aligned.rgb - inputs.distorted), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Method:
    """A restorer with the alignment in front of it."""

    name: str
    restorer: Restorer
    aligner: Aligner
    plain_reference: bool = False
    """Whether it takes the reference as the paper renders it, rather than through the client's footprint."""
    adapts: bool = False
    """Whether the client's splats have learnt from references before, by :data:`ADAPTER_STEPS` steps."""
    own_depth: bool = False
    """Whether what the reference cannot see is told by the client's own depth from its camera too."""

    def run(self, case: Case) -> tuple[F32, Milliseconds]:
        """The picture [H, W, 3], and milliseconds of each stage that the method needs."""
        watch = Watch()
        if self.adapts:
            case = adapted(case)
            watch("adapt")
        distorted = np.clip(case.distorted.rgb, 0.0, 1.0)
        if not self.restorer.needs:
            return distorted, watch.stages_ms
        assert case.distorted.depth is not None
        reference = case.plain if self.plain_reference else case.reference
        colours = Effect.EROSION in self.restorer.needs
        aligned = self.aligner.align(reference, case.distorted.depth, case.camera, colours=colours)
        watch("align")
        own = None
        if Effect.OWN_VIEW in self.restorer.needs:
            own = case.own(DepthKind.EXPECTED if self.own_depth else DepthKind.NONE)
            aligned = seen_by_own(aligned, own) if self.own_depth else aligned
            watch("own")
        picture = self.restorer.restore(RestoreInput(distorted, case.distorted.alpha, aligned, reference, own))
        watch("restore")
        return picture, watch.stages_ms


def adapted(case: Case) -> Case:
    """``case`` after a step of the colour adapter with each reference until then, or some with its own alone."""
    scene, adapter = raster.create("auto").load(case.splats), SirtAdapter(len(case.splats))
    options = replace(case.own_options, depth=DepthKind.NONE)
    for reference in (*case.before, case.reference) if case.before else [case.reference] * ADAPTER_STEPS:
        own = scene.render(reference.camera, options)
        adapter.adapt(scene, case.splats, reference, own, options)
    drawn = scene.render(case.camera, RenderOptions(threads=case.own_options.threads))
    return replace(case, held=scene, distorted=drawn)


def seen_by_own(aligned: Aligned, own: RenderedView) -> Aligned:
    """``aligned`` without what lies behind the client's own splats as drawn from the reference's camera."""
    assert own.depth is not None
    known = np.where(np.isfinite(own.depth), own.depth, np.float32(FAR))
    farthest = np.asarray(cv2.dilate(known, np.ones((3, 3), np.uint8)), dtype=np.float32)
    x, y, z, inside = aligned.geometry.projected
    hidden = inside & (z > sample(farthest[..., None], x, y)[..., 0] * np.float32(1 + DEPTH_TOLERANCE))
    share = 1 - cv2.blur(hidden.astype(np.float32), (3, 3))
    return replace(aligned, paint=lambda: aligned.rgb, confidence=aligned.confidence * share)


def methods_of(names: list[str], threads: int) -> list[Method]:
    """Methods by name. Raises :class:`~cags_common.errors.ConfigError` for unknown ones or absent weights."""
    return [_method(name, threads) for name in names]


def _method(name: str, threads: int) -> Method:
    def prpa(erosion: bool = True) -> Aligner:
        plain = AlignSettings(threads=threads)
        return align.create("auto", plain if erosion else replace(plain, erosion_iterations=0))

    affine = AffineRestorer(AffineSettings(threads=threads))
    special: dict[str, Callable[[], Method]] = {
        "affine": lambda: Method(name, affine, prpa()),
        "aligned": lambda: Method(name, SwapRestorer(), prpa()),
        "aligned without erosion": lambda: Method(name, SwapRestorer(), prpa(erosion=False)),
        "affine without PRPA": lambda: Method(name, affine, align.create("unaligned")),
        "affine with own depth": lambda: Method(name, affine, prpa(), own_depth=True),
        "sirt": lambda: Method(name, restore.create("none"), prpa(), adapts=True),
        "sirt + affine": lambda: Method(name, affine, prpa(), adapts=True),
        "paper": lambda: Method(name, networks.create("srresnet", threads), prpa(), plain_reference=True),
    }
    if name in special:
        return special[name]()
    base = name.partition("@")[0]
    if base in networks.NETWORKS:
        return Method(name, networks.create(name, threads), prpa())
    if base not in RESTORERS:
        known = ", ".join([*dict.fromkeys([*RESTORERS, *networks.NETWORKS, *special])])
        raise ConfigError(f"method {name!r} is unknown; known: {known}")
    return Method(name, restore.create(name), prpa())


@dataclass(eq=False)
class Watch:
    """Milliseconds between calls, by the name given at the end of each."""

    started: float = field(default_factory=time.perf_counter)
    stages_ms: Milliseconds = field(default_factory=dict)

    def __call__(self, stage: str) -> None:
        """The stage ends now."""
        now = time.perf_counter()
        self.stages_ms[stage] = (now - self.started) * 1e3
        self.started = now
