"""Run as a process of its own, for a driver is chosen once: draws what a page says that it shows (see web_page.py)."""

from __future__ import annotations

import base64
import json
import sys
from typing import Any

import numpy as np

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.correction import Correction, Reference, Spheres
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.raster.base import RenderOptions
from cags_common.video.h264 import H264Decoder
from cags_gpu.correct import Frame
from cags_gpu.raster import GpuRasteriser


def camera_of(values: dict[str, Any]) -> Camera:
    i, pose = values["intrinsics"], values["pose"]
    intrinsics = Intrinsics(i["widthPx"], i["heightPx"], i["fxPx"], i["fyPx"], i["cxPx"], i["cyPx"])
    return Camera(intrinsics, Pose(tuple(pose["position"]), tuple(pose["rotation"])), values["near"])


def floats(text: str, *shape: int) -> F32:
    return np.frombuffer(base64.b64decode(text), np.float32).reshape(shape)


def reference_of(values: dict[str, Any]) -> Reference | None:
    given = values["reference"]
    if given is None:
        return None
    camera = camera_of(given["camera"])
    coded = floats(given["coded"], camera.height_px, camera.width_px, 3)
    if values["idr"] and values["planes"]:  # decodes by itself: the browser's picture must be FFmpeg's
        own = H264Decoder().decode(base64.b64decode(values["unit"]))
        assert own is not None and np.abs(own - coded).max() < 2e-7, "the reference was decoded otherwise"
    return Reference(coded, camera, given["picture"], given["knee"], given["error"])


def correction_of(values: dict[str, Any], camera: Camera) -> Correction | None:
    reference = reference_of(values)
    if reference is None:
        return None
    changed = None
    if values["radii"] is not None:
        radii = floats(values["radii"], -1)
        changed = Spheres(floats(values["positions"], len(radii), 3), radii)
    return Correction(reference, camera.intrinsics, changed=changed, stale=values["stale"])


def refuse(_: object) -> bytes:
    raise SystemExit("the device was lost")


def drawn(rasteriser: GpuRasteriser, player: BundlePlayer, values: dict[str, Any]) -> bytes:
    camera = camera_of(values["camera"])
    options = RenderOptions(max_sh_degree=values["degree"], displayed=True)
    frame = Frame(camera, options, correction_of(values, camera))
    scene = rasteriser.load(player.frame(values["frame"]).splats)
    return scene.on_device(lambda held: frame.draw(held, frame.target_of(held)).tobytes(), refuse)


def main() -> None:
    job = json.load(sys.stdin)
    rasteriser = GpuRasteriser()
    with BundleReader.open(job["bundle"]) as reader:
        player = BundlePlayer(reader)
        for values in job["pictures"]:
            sys.stdout.buffer.write(drawn(rasteriser, player, values))


if __name__ == "__main__":
    main()
