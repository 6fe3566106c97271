"""What is compared: each method from a client's render and a reference to a picture, with the time of its stages."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cags_bench.restore.cases import Case
from cags_client import align, restore
from cags_client.align import Aligner, AlignSettings
from cags_client.restore import RestoreInput, Restorer, networks
from cags_common.geometry import F32

Milliseconds = dict[str, float]


@dataclass(frozen=True, eq=False)
class Method:
    """A restorer with the alignment in front of it."""

    name: str
    restorer: Restorer
    aligner: Aligner
    plain_reference: bool = False
    """Whether it takes the reference as the paper renders it, rather than through the client's footprint."""

    def run(self, case: Case) -> tuple[F32, Milliseconds]:
        """The picture [H, W, 3], and milliseconds of each stage."""
        watch = _Watch()
        distorted = np.clip(case.distorted.rgb, 0.0, 1.0)
        assert case.distorted.depth is not None
        reference = case.plain if self.plain_reference else case.reference
        aligned = self.aligner.align(reference, case.distorted.depth, case.camera)
        watch("align")
        own = case.own()
        watch("own")
        picture = self.restorer.restore(RestoreInput(distorted, case.distorted.alpha, aligned, reference, own))
        watch("restore")
        return picture, watch.stages_ms


def methods_of(names: list[str], threads: int) -> list[Method]:
    """Methods by name. Raises :class:`~cags_common.errors.ConfigError` for unknown ones or absent weights."""
    return [_method(name, threads) for name in names]


def _method(name: str, threads: int) -> Method:
    special: dict[str, Callable[[], Method]] = {
        "affine without PRPA": lambda: Method(name, restore.create("affine"), align.create("unaligned")),
        "affine without erosion": lambda: Method(
            name, restore.create("affine"), align.create("auto", AlignSettings(erosion_iterations=0))
        ),
        "paper": lambda: Method(name, networks.create("srresnet", threads), align.create("auto"), plain_reference=True),
    }
    if name in special:
        return special[name]()
    is_network = name.partition("@")[0] in networks.NETWORKS
    restorer = networks.create(name, threads) if is_network else restore.create(name)
    return Method(name, restorer, align.create("auto"))


@dataclass(eq=False)
class _Watch:
    started: float = field(default_factory=time.perf_counter)
    stages_ms: Milliseconds = field(default_factory=dict)

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.stages_ms[stage] = (now - self.started) * 1e3
        self.started = now
