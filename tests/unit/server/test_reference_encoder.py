"""References of constant quality, or at a share of the link."""

import numpy as np
import pytest

from cags_common.geometry import Intrinsics
from cags_common.video.h264 import H264Decoder, is_idr
from cags_server.reference_encoder import ReferenceEncoder
from cags_server.settings import ServerSettings

CLIENT = Intrinsics.of_fov(321, 241, 1.0, 0.8)


def pictures(encoder: ReferenceEncoder, count: int) -> list[np.ndarray]:
    """Noise that moves: as hard to code as pictures get."""
    noise = np.random.default_rng(0).random((encoder.height_px + count, encoder.width_px, 3)).astype(np.float32)
    return [noise[i : i + encoder.height_px] for i in range(count)]


def test_references_are_as_large_as_asked() -> None:
    small = ReferenceEncoder(ServerSettings(), CLIENT, 30)
    full = ReferenceEncoder(ServerSettings(reference_full_size=True), CLIENT, 30)
    assert (small.width_px, small.height_px) == (400, 300)
    assert (full.width_px, full.height_px) == (320, 240), "even, as 4:2:0 must be"


@pytest.mark.parametrize("bps", [300_000, 1_000_000, 4_000_000])
def test_a_share_of_the_link_is_kept(bps: int) -> None:
    encoder = ReferenceEncoder(ServerSettings(reference_full_size=True, reference_share=0.8), CLIENT, 30)
    encoder.follow(bps)
    units = [encoder.encode(picture)[0] for picture in pictures(encoder, 60)]
    assert sum(map(len, units[15:])) * 8 / 1.5 <= bps, "after the first picture, over a second and a half"


def test_a_changed_link_begins_a_new_video_that_decodes() -> None:
    encoder, decoder = ReferenceEncoder(ServerSettings(reference_share=0.5), CLIENT, 30), H264Decoder()
    kinds = []
    for picture, link_bps in zip(pictures(encoder, 6), (2e6, 2e6, 2.2e6, 8e6, 8e6, 1e6), strict=True):
        encoder.follow(link_bps)
        unit, noise = encoder.encode(picture)
        assert noise is not None
        kinds.append(is_idr(unit))
        assert decoder.decode(unit) is not None
    assert kinds == [True, False, False, True, False, True]


def test_without_a_share_the_link_does_not_matter() -> None:
    encoders = [ReferenceEncoder(ServerSettings(), CLIENT, 30) for _ in range(2)]
    encoders[1].follow(1e5)
    units = [[e.encode(p, idr=not i)[0] for i, p in enumerate(pictures(e, 3))] for e in encoders]
    assert units[0] == units[1]
