"""A whole session drawn by the GPU on both ends: the same stream, the same pictures as on the CPU."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_client.frame.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_common.geometry import F32
from cags_encoder import EncodeSettings
from cags_gpu.difference import DeviceViews
from cags_gpu.pictures import DevicePictures
from cags_gpu.raster import GpuScene
from cags_server.settings import ServerSettings
from support.gpu import needs_adapter, software_passes


def played(bundle: Path, references: str, *, server: str, client: str) -> tuple[SessionResult, list[F32]]:
    """What came of it, and the pictures shown; with these rasterisers."""
    # without loss: x264 chooses otherwise for pictures that differ in the last bit, which is none of the GPU's
    coded = {"references": references, "reference_crf": 0.0}
    serving = ServerSettings(rasteriser=server, reference_width=64, reference_height=48, **coded)
    viewing = ClientSettings(raster=client, width=96, height=64, exactness="exact")
    scenario, shown = Scenario(bundle, "generated:steady-30", "synthetic:walking", serving, viewing), []

    def watch(presented: PresentedFrame, _: dict[str, Any]) -> None:
        assert isinstance(presented.pictures, DevicePictures) == (client == "gpu"), "frames are made in one go"
        shown.append(presented.rgb)

    return simulate(scenario, watch=watch), shown


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = EncodeSettings(frames=4, train_splats=1000, lod_order="paper")
    return cached_bundle("procedural:size=800,frames=4", str(tmp_path_factory.mktemp("bundle")), settings)


@needs_adapter
@pytest.mark.parametrize("references", ["difference", "picture"])
def test_a_session_on_the_gpu_is_one_on_the_cpu(bundle: Path, references: str, monkeypatch: pytest.MonkeyPatch) -> None:
    together: list[DeviceViews | None] = []
    compared = GpuScene.compared
    monkeypatch.setattr(GpuScene, "compared", lambda *a, **b: together.append(compared(*a, **b)) or together[-1])
    right, pictures = played(bundle, references, server="cpu", client="cpu")
    assert not together
    with software_passes():
        _, shown = played(bundle, references, server="cpu", client="gpu")
        ours, _ = played(bundle, references, server="gpu", client="gpu")
    within = [(np.abs(a - b) <= 1 / 255).all(axis=2).mean() for a, b in zip(shown, pictures, strict=True)]
    assert np.mean(within) >= 0.9999
    assert ours.summary["frames"] == right.summary["frames"] == len(shown) == 4
    assert all(together)
    assert (len(together) >= 4) == (references == "difference"), "where a mirror is kept, it is drawn with the truth"
    pairs: list[tuple[dict[str, Any], dict[str, Any]]] = list(zip(ours.frames, right.frames, strict=True))
    for frame, same in pairs:
        assert abs(frame["psnr_restored_db"] - in_bytes_db(same["psnr_restored_db"])) < 0.1, sorted(frame)


def in_bytes_db(psnr_db: float) -> float:
    """PSNR of the same picture in whole levels of 255."""
    return -10 * math.log10(10 ** (-psnr_db / 10) + 1 / 12 / 255**2)
