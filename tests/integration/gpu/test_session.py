"""A whole session drawn by the GPU on either end or both: the same stream, the same pictures as on the CPU.

A client's pictures are the CPU's, pixel by pixel, given the same references. What a server draws is within the bounds
of its level, and before it is seen it is rounded to 8-bit codes: some fall on the other side, and x264 answers them
with other choices. So of two ends on the GPU the references are compared at the coder's input, and scores at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_client.frame.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_common.geometry import F32
from cags_common.raster import Exactness
from cags_common.raster.cpu import BOUNDS
from cags_common.video.colour import Chroma, planes_of_ycbcr, ycbcr_of_rgb
from cags_encoder import EncodeSettings
from cags_gpu.difference import DeviceViews
from cags_gpu.pictures import DevicePictures
from cags_gpu.raster import GpuScene
from cags_server.reference import coder
from cags_server.reference.detail import BLOCK_PX
from cags_server.settings import ServerSettings
from support.gpu import needs_adapter, software_passes

pytestmark = needs_adapter


@dataclass
class Played:
    """What came of a session."""

    result: SessionResult | None = None
    shown: list[F32] = field(default_factory=list)
    drawn: list[F32] = field(default_factory=list)
    """What the server gave to the video coder, [h, w, 3] in [0, 1] each."""
    decoded: list[F32] = field(default_factory=list)
    together: int = 0
    """How often truth and mirror were drawn in one go."""


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = EncodeSettings(frames=4, train_splats=1000, lod_order="paper")
    return cached_bundle("procedural:size=1200,frames=4", str(tmp_path_factory.mktemp("bundle")), settings)


@cache
def played(bundle: Path, references: str, *, server: str, client: str) -> Played:
    """A session with these rasterisers; its video is coded without loss."""
    coded = {"references": references, "reference_crf": 0.0}
    serving = ServerSettings(rasteriser=server, reference_width=64, reference_height=48, **coded)
    viewing = ClientSettings(raster=client, width=96, height=64, exactness="exact")
    scenario, out = Scenario(bundle, "generated:steady-30", "synthetic:walking", serving, viewing), Played()

    def watch(presented: PresentedFrame, _: dict[str, Any]) -> None:
        assert isinstance(presented.pictures, DevicePictures) == (client == "gpu"), "frames are made in one go"
        out.shown.append(presented.rgb)

    compared, coding = GpuScene.compared, coder._Video.coded

    def counted(*arguments: Any, **named: Any) -> DeviceViews | None:
        made = compared(*arguments, **named)
        assert made is not None, "what one device can do alone it does"
        out.together += 1
        return made

    def recorded(self: Any, picture: F32, *, idr: bool) -> tuple[bytes, F32]:
        unit, decoded = coding(self, picture, idr=idr)
        out.drawn.append(picture.copy())
        out.decoded.append(decoded.copy())
        return unit, decoded

    with software_passes(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(GpuScene, "compared", counted)
        patch.setattr(coder._Video, "coded", recorded)
        out.result = simulate(scenario, watch=watch)
    return out


def least_within_a_level(ours: list[F32], right: list[F32]) -> float:
    """Share of the pixels within 1/255, in the worst of the frames."""
    return min(float((np.abs(a - b) <= 1 / 255).all(axis=2).mean()) for a, b in zip(ours, right, strict=True))


def left_out(drawn: F32) -> NDArray[np.bool_]:
    """Blocks [rows, columns] of a difference that are not worth their bits: nothing is drawn there."""
    rows, columns = (side // BLOCK_PX for side in drawn.shape[:2])
    blocks = drawn.reshape(rows, BLOCK_PX, columns, BLOCK_PX, 3)
    return np.asarray((np.ptp(blocks, axis=(1, 3)) == 0).all(axis=2))


def by_pixel(blocks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``blocks`` [rows, columns] at each of their pixels [h, w, 1]."""
    return np.kron(blocks, np.ones((BLOCK_PX, BLOCK_PX), np.bool_))[..., None]


def summary(session: Played) -> dict[str, Any]:
    assert session.result is not None
    return session.result.summary


@pytest.mark.parametrize("references", ["difference", "picture"])
def test_given_the_same_references_a_client_shows_the_cpus_pixels(bundle: Path, references: str) -> None:
    right = played(bundle, references, server="gpu", client="cpu")
    ours = played(bundle, references, server="gpu", client="gpu")
    np.testing.assert_array_equal(ours.decoded, right.decoded)
    assert least_within_a_level(ours.shown, right.shown) >= 0.9999
    assert summary(ours)["frames"] == summary(right)["frames"] == len(ours.shown) == 4


@pytest.mark.parametrize("references", ["difference", "picture"])
def test_a_server_codes_what_the_cpu_draws_to_a_code(bundle: Path, references: str) -> None:
    right = played(bundle, references, server="cpu", client="cpu")
    ours = played(bundle, references, server="gpu", client="cpu")
    assert not right.together
    assert bool(ours.together) == (references == "difference"), "where a mirror is kept, it is drawn with the truth"
    others_share = []
    for pair in zip(ours.drawn, right.drawn, strict=True):
        undecided = left_out(pair[0]) ^ left_out(pair[1])
        assert undecided.sum() <= 1, "a block just as loud as is worth its bits"
        drawn, same = (np.where(by_pixel(undecided), np.float32(0.5), each) for each in pair)
        assert np.abs(drawn - same).max() <= BOUNDS[Exactness.BALANCED].largest
        codes, others = (planes_of_ycbcr(ycbcr_of_rgb(each), Chroma.FULL).astype(int) for each in (drawn, same))
        assert np.abs(codes - others).max() <= 1
        others_share.append(float((codes != others).mean()))
    assert np.mean(others_share) <= 0.02
    assert max(others_share) <= 0.03, "how many values lie at an edge of a code is up to each picture"


@pytest.mark.parametrize("references", ["difference", "picture"])
def test_a_session_on_the_gpu_has_the_cpus_scores(bundle: Path, references: str) -> None:
    right = played(bundle, references, server="cpu", client="cpu").result
    ours = played(bundle, references, server="gpu", client="gpu").result
    assert ours is not None
    assert right is not None
    assert ours.summary["frames"] == right.summary["frames"]
    ours_db = [frame["psnr_restored_db"] for frame in ours.frames]
    right_db = [in_bytes_db(frame["psnr_restored_db"]) for frame in right.frames]
    assert abs(np.mean(ours_db) - np.mean(right_db)) < 0.1
    assert max(abs(one - other) for one, other in zip(ours_db, right_db, strict=True)) < 0.2


def in_bytes_db(psnr_db: float) -> float:
    """PSNR of the same picture in whole levels of 255."""
    return -10 * math.log10(10 ** (-psnr_db / 10) + 1 / 12 / 255**2)
