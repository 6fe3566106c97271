"""Other splat renderers from PyPI that need no graphics card; timed if they are installed.

Open3D (0.20 and later) draws splats with Vulkan compute shaders, which Debian's lavapipe (``mesa-vulkan-drivers``) runs
on the processor: ``pip install open3d`` and ``apt-get install mesa-vulkan-drivers libgl1 libegl1 libusb-1.0-0``.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

import numpy as np

from cags_bench.raster.contenders import Contender, Frame
from cags_common.geometry import F32, Camera
from cags_common.splats import Splats

OPEN3D = "open3d"


def peer_contenders(splats: Splats) -> list[Contender]:
    """The installed peers, each with the scene loaded."""
    if importlib.util.find_spec("open3d") is None:
        return []
    try:
        return [Contender(OPEN3D, _Open3d(splats).frame)]
    except (ImportError, RuntimeError) as error:
        print(f"{OPEN3D} left out: {error}", file=sys.stderr)
        return []


class _Open3d:
    """Open3D's off-screen renderers, one per size because they cannot be resized. They always use all processors."""

    def __init__(self, splats: Splats) -> None:
        import open3d

        self._open3d = open3d
        self._renderers: dict[tuple[int, int], Any] = {}
        self._cloud = open3d.t.geometry.PointCloud()
        columns = {
            "positions": splats.means,
            "scale": np.exp(splats.log_scales),
            "rot": splats.quats,
            "opacity": splats.logit_opacities[:, None],
            "f_dc": splats.sh0,
        }
        if splats.sh_rest.shape[1]:
            columns["f_rest"] = splats.sh_rest
        for name, column in columns.items():
            setattr(self._cloud.point, name, open3d.core.Tensor(np.ascontiguousarray(column, np.float32)))

    def frame(self, camera: Camera, threads: int) -> Frame:
        """Render one view; the result has 8 bits per channel."""
        size = camera.width_px, camera.height_px
        renderer = self._renderers.get(size)
        if renderer is None:
            renderer = self._renderers[size] = self._renderer(*size)
        i = camera.intrinsics
        pinhole = np.array([[i.fx_px, 0, i.cx_px], [0, i.fy_px, i.cy_px], [0, 0, 1]])
        extrinsic = np.eye(4)
        extrinsic[:3, :3], extrinsic[:3, 3] = camera.world_to_camera
        renderer.setup_camera(pinhole, extrinsic, *size)

        def render() -> F32:
            image = np.asarray(renderer.render_to_image())
            return image.astype(np.float32) / np.float32(255)

        return render

    def _renderer(self, width: int, height: int) -> Any:
        rendering = self._open3d.visualization.rendering
        renderer = rendering.OffscreenRenderer(width, height)
        material = rendering.MaterialRecord()
        material.shader = "gaussianSplat"
        renderer.scene.view.set_post_processing(False)  # no tone mapping
        renderer.scene.set_background([0.0, 0.0, 0.0, 1.0])
        renderer.scene.add_geometry("splats", self._cloud, material)
        return renderer
