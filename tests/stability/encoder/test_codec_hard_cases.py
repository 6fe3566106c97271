"""The quantiser, tiles and dequantising on what real data holds and on what breaks codecs.

Stated bounds. Positions: half a grid step an axis. Attributes with at most 16 distinct values: float16's rounding,
2**-10 of the largest value. Others: a root-mean-square error of 4 % of the attribute's range for ``layered``, of 15 %
for the paper's.
"""

from __future__ import annotations

from collections.abc import Callable

import faiss
import numpy as np
import pytest

from cags_common.bundle.codecs import tile_codec
from cags_common.bundle.manifest import Manifest
from cags_common.errors import SceneError
from cags_common.splats import Splats
from cags_common.store.tile_decode import First, OpenTile, TileOpener
from cags_common.tiles.attributes import split_attributes
from cags_common.tiles.morton import morton_order, tile_ranges
from cags_common.tiles.svq import MAX_STAGE_BITS
from cags_encoder import EncodeSettings
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.quantiser.configs import LOGIT_RANGE, QuantiserConfig, layered
from cags_encoder.quantiser.training import train
from support.codec_scenes import cloud, with_changes

RMS_SHARE = {"layered": 0.04, "paper-66": 0.15}
FEW = 16
TILE = 200


def extreme(n: int = 400) -> Splats:
    """Infinite opacities and scales beyond any use, as captured files hold them."""
    splats = cloud(n)
    logits, scales = splats.logit_opacities.copy(), splats.log_scales.copy()
    logits[:5], logits[5:9] = np.inf, -np.inf
    scales[:5], scales[5:9] = -200, 60
    return with_changes(splats, logit_opacities=logits, log_scales=scales)


def spanning(n: int = 400) -> Splats:
    """Positions over a range of a million, most of them close together."""
    means = cloud(n).means.copy()
    means[:4] = [[1e6, 0, 0], [0, -1e6, 0], [0, 0, 1e6], [-1e6, 1e6, -1e6]]
    return with_changes(cloud(n), means=means)


def half_turns(n: int = 400) -> Splats:
    """Rotations by 180 degrees about every axis, their opposites, and the identity's two quaternions."""
    quats = cloud(n).quats.copy()
    turns = np.concatenate([np.eye(4), -np.eye(4)]).astype(np.float32)
    quats[: len(turns)] = turns
    return with_changes(cloud(n), quats=quats)


def equal(n: int) -> Splats:
    return cloud(1).take(np.zeros(n, np.intp))


CASES: dict[str, Callable[[], Splats]] = {
    "one splat": lambda: cloud(1),
    "fewer splats than clusters": lambda: cloud(9),
    "all equal": lambda: equal(300),
    "two values, many copies": lambda: cloud(2).take(np.arange(500) % 2),
    "duplicates among others": lambda: cloud(400).take(np.arange(800) // 2),
    "SH without an all-zero row": lambda: cloud(500, 1, 3),
    "half turns": half_turns,
    "infinite opacity and scale": extreme,
    "positions spanning a million": spanning,
    "no extent": lambda: with_changes(cloud(50), means=np.full((50, 3), 3.0)),
}


def coded(splats: Splats, quantiser: str, *, threads: int = 1) -> tuple[SvqCodec, list[tuple[bytes, ...]], Splats]:
    """The codec, a key frame's tiles, and what comes back at the highest LoD."""
    codec = SvqCodec.train(splats, EncodeSettings(quantiser=quantiser, lod_order="paper"))
    rows = codec.quantise(codec.prepare(splats))
    tiles = [
        codec.encode_tile(np.arange(a, b, dtype=np.int32), rows.take(slice(a, b)), id_range=True)
        for a, b in tile_ranges(len(splats), TILE)
    ]
    capacity, nowhere = (len(splats),), ((0, 0, 0), (0, 0, 0))
    info = Manifest("", 30.0, 1, (0,), capacity, splats.sh_degree, nowhere, codec.lod_order, ())
    opener = TileOpener(tile_codec(info, codec.codebooks()), threads)
    states = []
    firsts = [First((0, number), 0, memoryview(payloads[0])) for number, payloads in enumerate(tiles)]
    for tile, payloads in zip(opener.opened(firsts), tiles, strict=True):
        assert isinstance(tile, OpenTile)
        for lod, payload in enumerate(payloads[1:], start=1):
            tile.state.add_layer(lod, payload)
        states.append(tile.state)
    return codec, tiles, Splats.concatenate(opener.dequantise(states))


@pytest.mark.parametrize("quantiser", list(RMS_SHARE))
@pytest.mark.parametrize("case", list(CASES))
def test_what_comes_back_is_within_the_stated_bounds(case: str, quantiser: str) -> None:
    splats = CASES[case]().checked(case)
    splats = splats.take(morton_order(splats.means))
    codec, _, back = coded(splats, quantiser)
    truth = codec.prepare(splats)
    for first, end in tile_ranges(len(splats), TILE):
        step = codec.grid(codec.quantise(truth.take(slice(first, end)))).step
        off = np.abs(back.means[first:end].astype(np.float64) - truth.means[first:end])
        assert off.max() <= step * 0.5000001 + np.spacing(np.abs(truth.means).max()) * 2
    values, decoded = split_attributes(truth), split_attributes(back)
    for book in codec.quantiser.books:
        drawn_in = book.attribute == "opacity" and not quantiser.startswith("paper")
        true = np.clip(values[book.attribute].astype(np.float64), *(LOGIT_RANGE if drawn_in else (-30, 30)))
        error = decoded[book.attribute] - true
        assert np.isfinite(error).all()
        if len(np.unique(true, axis=0)) <= FEW:
            assert np.abs(error).max() <= 2**-10 * max(np.abs(true).max(), 1), book.attribute
        else:
            assert np.sqrt(np.square(error).mean()) <= RMS_SHARE[quantiser] * np.ptp(true), book.attribute
    assert np.abs(decoded["alpha"] - values["alpha"]).mean() < 0.02


@pytest.mark.parametrize("attribute", ["log_scales", "logit_opacities", "quats", "means"])
def test_not_a_number_is_refused_by_name(attribute: str) -> None:
    array = dict(cloud(20).arrays())[attribute].copy()
    array[3] = np.nan
    with pytest.raises(SceneError, match=rf"{attribute}\[3\]"):
        with_changes(cloud(20), **{attribute: array}).checked("file")


def test_half_turns_come_back_as_the_same_rotations() -> None:
    splats = half_turns().checked("x")
    codec, _, back = coded(splats, "layered")
    apart = 1 - np.abs((codec.prepare(splats).quats * back.quats).sum(axis=1))
    assert apart.max() < 0.02, "within 23 degrees, whatever the turn"
    assert np.median(apart) < 2e-3


def test_a_tile_of_no_splats_goes_both_ways() -> None:
    codec, _, _ = coded(cloud(100).checked("x"), "layered")
    nothing = codec.quantise(codec.prepare(cloud(100).checked("x"))).take(slice(0, 0))
    payloads = codec.encode_tile(np.zeros(0, np.int32), nothing, id_range=False)
    info = Manifest("", 30.0, 1, (0,), (100,), 0, ((0, 0, 0), (0, 0, 0)), codec.lod_order, ())
    state = tile_codec(info, codec.codebooks()).open_tile(payloads[0])
    for lod, payload in enumerate(payloads[1:], start=1):
        state.add_layer(lod, payload)
    assert len(state) == len(state.dequantise()) == 0
    assert state.lod == len(codec.lod_order)


def test_codebooks_as_deep_as_allowed() -> None:
    deepest = dict.fromkeys(("scale", "rotation", "alpha", "sh0"), (MAX_STAGE_BITS, 0))
    config: QuantiserConfig = layered("deep", deepest)
    splats = cloud(3000).checked("x")
    quantiser = train(splats, config, 0)
    prepared = quantiser.prepare(splats)
    values = split_attributes(prepared)
    for name, decoded in quantiser.decode(quantiser.encode(prepared)).items():
        assert sum(quantiser.books[name].layer_bits) <= MAX_STAGE_BITS
        assert np.abs(decoded - values[name]).max() <= 2**-10 * np.abs(values[name]).max(), name


@pytest.mark.parametrize("quantiser", list(RMS_SHARE))
def test_twice_gives_the_same_bytes_and_threads_change_nothing(quantiser: str) -> None:
    splats = cloud(300, 5, 1).checked("x")
    before = faiss.omp_get_max_threads()
    codec, tiles, back = coded(splats, quantiser)
    try:
        faiss.omp_set_num_threads(3)
        again, same, shown = coded(splats, quantiser, threads=3)
    finally:
        faiss.omp_set_num_threads(before)
    assert codec.codebooks() == again.codebooks()
    assert tiles == same
    for (name, a), (_, b) in zip(back.arrays(), shown.arrays(), strict=True):
        assert np.array_equal(a, b), name
