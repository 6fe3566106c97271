import numpy as np
import pytest

from cags_common.bundle.codecs import tile_codec
from cags_common.bundle.manifest import Manifest
from cags_common.splats import Splats
from cags_common.tiles.contexts import ContextModel
from cags_common.tiles.morton import morton_order
from cags_common.tiles.payloads import DELTA_TILE_SPLATS
from cags_encoder.codecs.context_models import models_of
from cags_encoder.codecs.svq import SPARSE, SvqCodec
from cags_encoder.settings import EncodeSettings
from support.codec_scenes import cloud, with_changes


def striped(count: int) -> Splats:
    """Splats whose colours and sizes change slowly over space, and whose rotations are chance."""
    splats = cloud(count, sh_degree=1)
    splats = splats.take(morton_order(splats.means))
    noise = np.random.default_rng(1).normal(size=(count, 3)).astype(np.float32) * np.float32(0.01)
    return with_changes(splats, sh0=splats.means * np.float32(0.5) + noise, log_scales=splats.means - 4 + noise)


def codec_of(splats: Splats) -> SvqCodec:
    return SvqCodec.train(splats, EncodeSettings(lod_order="paper"))


def model_of(codec: SvqCodec, splats: Splats, attribute: str, layer: int = 0) -> ContextModel | None:
    return codec.modelled(splats).quantiser.books[attribute].model(layer)


def test_what_neighbours_share_is_likely_and_chance_is_not() -> None:
    splats = striped(6000)
    codec = codec_of(splats)
    sure = {name: model_of(codec, splats, name) for name in ("sh0", "scale", "rotation")}
    likeliest = {name: model and float(model.frequencies.max(axis=1).mean()) / 4096 for name, model in sure.items()}
    assert min(likeliest["sh0"] or 0, likeliest["scale"] or 0) > 0.4
    assert (likeliest["rotation"] or 0) < 0.2


@pytest.mark.parametrize("count", [0, 1, 40])
def test_few_splats_have_no_models(count: int) -> None:
    splats = striped(200)
    few = codec_of(splats).modelled(splats.take(slice(0, count)))
    assert not any(any(book.models) for book in few.quantiser.books)


def test_no_tiles_have_no_models() -> None:
    assert models_of(codec_of(striped(50)).quantiser.books, [], []) == {}


def test_tiles_are_smaller_and_decode_to_the_same_splats() -> None:
    splats = striped(4000)
    plain = codec_of(splats)
    modelled = plain.modelled(splats)
    ids, decoded, sizes = np.arange(len(splats), dtype=np.int32), [], []
    for codec in (plain, modelled):
        tile = codec.encode_tile(ids, codec.quantise(codec.prepare(splats)), id_range=True)
        info = Manifest("x", 30.0, 1, (0,), (len(ids),), 1, ((0, 0, 0), (1, 1, 1)), codec.lod_order, ())
        state = tile_codec(info, codec.codebooks()).open_tile(tile[0])
        for lod in reversed(range(1, len(tile))):
            state.add_layer(lod, tile[lod])
        decoded.append(state.dequantise())
        sizes.append(sum(map(len, tile)))
    assert sizes[1] < 0.98 * sizes[0]
    for (name, one), (_, other) in zip(decoded[0].arrays(), decoded[1].arrays(), strict=True):
        assert np.array_equal(one, other), name


def test_sparse_tiles_are_learnt_from_large_frames_alone() -> None:
    """A model of a frame that has room for sparse tiles knows neighbours further apart, and is less sure of them."""
    splats = striped(SPARSE * DELTA_TILE_SPLATS)
    codec = codec_of(splats.take(slice(0, None, 4)))
    sure = model_of(codec, splats.take(slice(0, SPARSE * DELTA_TILE_SPLATS - 1)), "sh0")
    mixed = model_of(codec, splats, "sh0")
    assert sure is not None
    assert mixed is not None
    assert float(sure.frequencies.max(axis=1).mean()) > float(mixed.frequencies.max(axis=1).mean())
