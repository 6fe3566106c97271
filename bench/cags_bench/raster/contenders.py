"""The renderers to compare: the backend at each level of exactness, and the prototype if its source is available."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np

from cags_common.geometry import F32, Camera
from cags_common.raster import Exactness, RenderOptions, create
from cags_common.splats import Splats

Frame: TypeAlias = Callable[[], F32]
"""Renders one frame; returns its colours [H, W, 3]."""

PROTOTYPE_FLAGS = "-DPFD=24 -DEXPDEG=3"
"""Compiler flags from the prototype's notes, but with blocks of 8 lanes: 16 are faster on AVX-512 only."""


@dataclass(frozen=True, eq=False)
class Contender:
    """A renderer of one scene; ``frame`` prepares one view."""

    name: str
    frame: Callable[[Camera, int], Frame]  # camera, threads


def backend_contenders(splats: Splats) -> list[Contender]:
    """The ``cpu`` backend at each level, on one loaded scene."""
    scene = create("cpu").load(splats)

    def at(level: Exactness) -> Contender:
        def frame(camera: Camera, threads: int) -> Frame:
            options = RenderOptions(exactness=level, threads=threads)
            return lambda: scene.render(camera, options).rgb

        return Contender(str(level), frame)

    return [at(level) for level in (Exactness.BALANCED, Exactness.FAST, Exactness.EXACT)]


def prototype_contender(splats: Splats, shared: Path) -> Contender | None:
    """The speed prototype, compiled into the temporary folder; None if its source or a compiler is missing."""
    module = _prototype_module(shared)
    if module is None:
        return None
    lanes = "" if "avx512vbmi2" in _cpu_flags() else " -DV=8"
    try:
        renderer = module.Rast(module.build(PROTOTYPE_FLAGS + lanes))
    except (OSError, module.subprocess.CalledProcessError) as error:
        print(f"prototype left out: {error}", file=sys.stderr)
        return None
    renderer.scene(_prototype_scene(splats))

    def frame(camera: Camera, threads: int) -> Frame:
        described = _prototype_camera(camera)

        def render() -> F32:
            image: F32 = renderer.render(described, threads)[0]
            return image

        return render

    return Contender("prototype", frame)


def _prototype_module(shared: Path) -> ModuleType | None:
    path = shared / "prototypes" / "raster" / "cpp_rast.py"
    if not path.exists():
        return None
    spec = importlib.util.spec_from_file_location("cags_bench_prototype", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _cpu_flags() -> str:
    path = Path("/proc/cpuinfo")
    return path.read_text(encoding="utf-8") if path.exists() else ""


def _prototype_scene(splats: Splats) -> dict[str, F32]:
    opacities = 1.0 / (1.0 + np.exp(-splats.logit_opacities.astype(np.float64)))
    return {
        "means": splats.means,
        "quats": splats.quats,
        "scales": np.exp(splats.log_scales),
        "opac": opacities.astype(np.float32),
        "sh": np.ascontiguousarray(np.concatenate([splats.sh0[:, None], splats.sh_rest], axis=1)),
    }


def _prototype_camera(camera: Camera) -> dict[str, Any]:
    rotation, translation = camera.world_to_camera
    i = camera.intrinsics
    numbers = {"fx": i.fx_px, "fy": i.fy_px, "cx": i.cx_px, "cy": i.cy_px, "W": i.width_px, "H": i.height_px}
    return {"R": rotation, "t": translation, "eye": np.asarray(camera.pose.position), **numbers}
