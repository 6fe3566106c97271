"""A whole session drawn by the GPU on both ends: the same stream, the same pictures as on the CPU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings
from support.gpu import needs_adapter, software_passes


def played(bundle: Path, backend: str) -> SessionResult:
    # without loss: x264 chooses otherwise for pictures that differ in the last bit, which is none of the GPU's
    coded = {"references": "difference", "reference_crf": 0.0}
    server = ServerSettings(rasteriser=backend, reference_width=64, reference_height=48, **coded)
    client = ClientSettings(raster=backend, width=96, height=64, exactness="exact")
    return simulate(Scenario(bundle, "generated:steady-30", "synthetic:walking", server, client))


@needs_adapter
def test_a_session_on_the_gpu_is_one_on_the_cpu(tmp_path: Path) -> None:
    settings = EncodeSettings(frames=4, train_splats=1000, lod_order="paper")
    bundle = cached_bundle("procedural:size=800,frames=4", str(tmp_path), settings)
    right = played(bundle, "cpu")
    with software_passes():
        ours = played(bundle, "gpu")
    assert ours.summary["frames"] == right.summary["frames"] == 4
    pairs: list[tuple[dict[str, Any], dict[str, Any]]] = list(zip(ours.frames, right.frames, strict=True))
    for frame, same in pairs:
        assert abs(frame["psnr_restored_db"] - same["psnr_restored_db"]) < 0.1, sorted(frame)
