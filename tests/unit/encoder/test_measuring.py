"""What the encoder measures in pictures of the clip: the order of layers and the step of positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import pytest
from numpy.typing import NDArray

from cags_common.bundle.quality import LodQuality
from cags_common.raster import create
from cags_common.splats import Splats
from cags_common.tiles.lod import POSITION, LodLayer, check_order, position_layers
from cags_encoder import EncodeSettings, measuring
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.measuring import LodMeasurement, cheapest_first, measure, standing, standing_still
from cags_encoder.scenes import Focus
from cags_encoder.views import cameras_around
from support.codec_scenes import cloud


def test_the_largest_fall_of_error_a_byte_comes_first() -> None:
    errors = {("a", 0): 10.0, ("a", 1): 4.0, ("b", 0): 9.0, ("b", 1): 3.0}
    sizes = {("a", 1): 10, ("a", 2): 10, ("b", 1): 20, ("b", 2): 1}
    order = cheapest_first(errors, 1.0, {"a": 2, "b": 2}, sizes)
    assert order == (LodLayer("a", 1), LodLayer("b", 1), LodLayer("b", 2), LodLayer("a", 2))


def test_a_layer_that_only_prepares_the_next_is_weighed_with_it() -> None:
    errors = {("a", 0): 10.0, ("a", 1): 9.9, ("b", 0): 3.0}
    sizes = {("a", 1): 10, ("a", 2): 10, ("b", 1): 10}
    order = cheapest_first(errors, 1.0, {"a": 2, "b": 1}, sizes)
    assert order[:2] == (LodLayer("a", 1), LodLayer("a", 2))


def test_views_look_at_the_centre_from_all_sides() -> None:
    cameras = cameras_around(Focus((1.0, 2.0, 3.0), 2.0), (0.0, -1.0, 0.0), 3)
    for camera in cameras:
        rotation, translation = camera.world_to_camera
        seen = rotation @ np.array([1.0, 2.0, 3.0]) + translation
        assert np.allclose(seen[:2], 0, atol=1e-9) and seen[2] > 2.0
    assert np.linalg.norm(np.mean([camera.pose.position for camera in cameras], axis=0) - [1, 2, 3]) < 2.0


def mist() -> Splats:
    """Large, faint splats."""
    small = cloud(1500, 3)
    return replace(small, log_scales=small.log_scales + 2, logit_opacities=np.full(1500, -2, np.float32))


def walls() -> Splats:
    """Flat splats of two colours, in two sheets hardly more than a thickness apart."""
    rng, n, thickness = np.random.default_rng(4), 1200, 0.002
    base = cloud(n, 4)
    means = rng.uniform(-1, 1, (n, 3))
    means[:, 2] = np.where(np.arange(n) % 2, 0.0, 1.5 * thickness)
    colours = np.where(np.arange(n)[:, None] % 2, [[1.5, -1.0, -1.0]], [[-1.0, -1.0, 1.5]])
    return replace(
        base,
        means=means.astype(np.float32),
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)).astype(np.float32),
        log_scales=np.log(np.tile([0.06, 0.05, thickness], (n, 1))).astype(np.float32),
        logit_opacities=np.full(n, 3, np.float32),
        sh0=colours.astype(np.float32),
    )


@pytest.mark.parametrize(("splats", "finer"), [(walls(), True), (mist(), False)], ids=["walls", "mist"])
def test_positions_are_as_fine_as_the_order_of_overlapping_splats_needs(splats: Splats, *, finer: bool) -> None:
    rasteriser = create("auto")
    if rasteriser.name == "oracle":
        pytest.skip("the native kernels are not installed; measuring needs dozens of renders")
    codec, cameras = SvqCodec.train(splats, EncodeSettings()), cameras_around(Focus((0, 0, 0), 2.0), (0, 1, 0), 3)

    def chosen(still: NDArray[np.bool_], *, refine: bool) -> LodMeasurement:
        return measure(codec, splats, cameras, rasteriser, lambda *_: None, still=still, refine=refine)

    all_still = np.ones(len(splats), np.bool_)
    found, coarse, moving = (
        chosen(all_still, refine=True),
        chosen(all_still, refine=False),
        chosen(~all_still, refine=True),
    )
    assert moving.position_step >= codec.position_step, "chunks refine the positions of what moves"
    assert (found.position_step < codec.position_step) == finer
    assert found.position_step >= codec.position_step / 8 and coarse.position_step >= codec.position_step
    assert found.applied(codec).position_step == found.position_step
    if finer:
        top, base = found.quality.ladder[-1], found.quality.ladder[0]
        assert top.size_bytes > coarse.quality.ladder[-1].size_bytes, "a halving takes 3 bits"
        assert top.psnr_db > coarse.quality.ladder[-1].psnr_db + 5
        assert base.size_bytes <= coarse.quality.ladder[0].size_bytes + 16, "of a level, not of the base"


def test_a_ladder_without_the_last_levels_of_positions_has_a_larger_step() -> None:
    """Of splats that are large and faint nobody sees where exactly they are."""
    rasteriser = create("auto")
    if rasteriser.name == "oracle":
        pytest.skip("the native kernels are not installed; measuring needs dozens of renders")
    splats, settings = mist(), EncodeSettings(position_step=1 / 64)
    codec, cameras = SvqCodec.train(splats, settings), cameras_around(Focus((0, 0, 0), 2.0), (0, 1, 0), 3)
    still = np.ones(len(splats), np.bool_)
    found = measure(codec, splats, cameras, rasteriser, lambda *_: None, still=still)
    left_out = codec.finest_layers - position_layers(found.order)
    assert left_out > 0 and found.position_step == codec.position_step * 2**left_out
    shorter = found.applied(codec)
    coded = shorter.quantise(shorter.prepare(splats))
    grid, whole = shorter.grid(coded), codec.grid(coded)
    assert grid.layers == position_layers(found.order) and abs(whole.bits - left_out - grid.bits) <= 1


def test_what_stands_still_is_found_whatever_the_order_of_rows() -> None:
    first = cloud(1000, 5)
    shifted = first.means + np.where(np.arange(1000)[:, None] < 300, np.float32(0.5), np.float32(0))
    later = replace(first, means=shifted.astype(np.float32)).take(np.random.default_rng(0).permutation(1000))
    still = standing(first, later, SvqCodec.train(first, EncodeSettings()))
    assert still[300:].all() and not still[:300].any()
    assert not standing(first, later.take(slice(0, 0)), SvqCodec.train(first, EncodeSettings())).any()


def test_what_standing_still_costs_is_measured_from_several_frames_of_the_clip() -> None:
    rasteriser = create("auto")
    cameras = cameras_around(Focus((0, 0, 0), 2.0), (0, 1, 0), 2)
    first = cloud(300, 5)

    def frame(number: int) -> Splats:  # still at first
        return replace(first, means=first.means + np.float32(0.02 * max(number - 4, 0)))

    found = standing_still(frame, 10, cameras, rasteriser)
    assert [frames for frames, _ in found] == [1, 4], "nothing is sixteen frames later"
    assert 60 > found[0][1] > found[1][1] > 5
    assert standing_still(lambda _: first, 2, cameras, rasteriser)[0][1] > 90
    assert standing_still(frame, 1, cameras, rasteriser) == ()


def test_steps_that_are_given_or_published_are_not_measured() -> None:
    assert EncodeSettings().measures_positions
    given = ({"position_step": 0.125}, {"position_bits": 14}, {"quantiser": "paper-66"})
    assert not any(EncodeSettings(**each).measures_positions for each in given)


def test_a_measured_order_is_complete_and_its_gains_add_up() -> None:
    splats = cloud(1500, 3)
    codec = SvqCodec.train(splats, EncodeSettings())
    rasteriser = create("auto")
    if rasteriser.name == "oracle":
        pytest.skip("the native kernels are not installed; measuring needs dozens of renders")
    done: list[int] = []
    cameras = cameras_around(Focus((0, 0, 0), 2.0), (0, 1, 0), 3)
    still = np.ones(len(splats), np.bool_)
    found = measure(codec, splats, cameras, rasteriser, lambda at, _: done.append(at), still=still)
    layers = {book.attribute: book.enhancement_layers for book in codec.quantiser.books}
    better = found.applied(codec)
    assert 0 < position_layers(better.lod_order) <= codec.finest_layers == 3
    check_order(better.lod_order, layers)
    assert len(better.lod_gains_db) == len(better.lod_order)
    assert sum(better.lod_gains_db) > 15
    assert done == list(range(1, len(done) + 1))
    ladder, alone = found.quality.ladder, found.quality.layers
    levels_db = np.cumsum([better.base_psnr_db, *better.lod_gains_db])
    np.testing.assert_allclose(levels_db, [row.psnr_db for row in ladder], atol=0.01)
    assert [row.lod for row in ladder] == list(range(len(better.lod_order) + 1))
    every = layers | {POSITION: codec.finest_layers}
    assert {(row.attribute, row.layer) for row in alone} == {(a, k) for a in every for k in range(every[a] + 1)}
    assert ladder[-1].psnr_db == max(row.psnr_db for row in alone), "all layers of all attributes"
    assert ladder[-1].ssim > ladder[0].ssim and ladder[-1].size_bytes > ladder[0].size_bytes > 0
    assert LodQuality.from_json(found.quality.to_json()) == found.quality


@pytest.mark.parametrize(
    ("psnr_db", "kept"),
    [
        ([20, 30, 40, 50], 3),
        ([20, 30, 40, 41.5], 3),  # 1.25 dB are a quarter of the bytes' worth
        ([20, 30, 40, 41], 2),
        ([20, 30, 30, 40], 3),  # two levels that pay together
        ([20, 30, 66, 76], 2),  # nothing to see
    ],
)
def test_the_order_ends_where_bytes_bring_less_than_their_share(psnr_db: list[float], kept: int) -> None:
    order = [LodLayer("sh0", layer) for layer in (1, 2, 3)]
    levels = [measuring._Seen(10 ** (-db / 10), 1.0) for db in psnr_db]
    totals = np.array([100, 200, 300, 400])

    def never(_: Splats) -> NoReturn:
        pytest.fail("no later frame to look at")

    assert measuring._enough(order, levels, totals, (), never) == kept


def test_a_later_frame_may_need_levels_that_the_first_does_not() -> None:
    order = [LodLayer("sh0", layer) for layer in (1, 2, 3)]
    levels = [measuring._Seen(10 ** (-db / 10), 1.0) for db in (20, 66, 67, 68)]

    class Later:
        def look(self, depths: Mapping[str, int]) -> measuring._Seen:
            return measuring._Seen(10 ** (-(20 + 10 * depths.get("sh0", 0)) / 10), 1.0)

    later: Any = Later()
    assert measuring._enough(order, levels, np.array([100, 200, 300, 400]), [cloud(3, 1)], lambda _: later) == 3


def _balls(n: int, seed: int) -> Splats:
    """Opaque balls of nearly one size and colour: no rotation shows."""
    splats, sizes = cloud(n, seed), np.random.default_rng(seed).normal(-3, 0.05, n).astype(np.float32)
    return replace(
        splats,
        log_scales=np.repeat(sizes[:, None], 3, axis=1),
        logit_opacities=np.full(n, 20, np.float32),
        sh0=splats.sh0 * np.float32(0.05),
    )


@pytest.mark.parametrize("enough_db", [50.0, 65.0])
def test_no_level_is_made_that_nobody_can_see(enough_db: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a smaller bound than the program's, because all levels together show these balls at 57 dB."""
    monkeypatch.setattr(measuring, "ENOUGH", 10 ** (-enough_db / 10))
    rasteriser = create("auto")
    if rasteriser.name == "oracle":
        pytest.skip("the native kernels are not installed; measuring needs dozens of renders")
    splats = _balls(800, 1)
    long = replace(_balls(800, 2), log_scales=cloud(800, 2).log_scales + 1)
    codec = SvqCodec.train(Splats.concatenate([splats, long]), EncodeSettings())
    cameras = cameras_around(Focus((0, 0, 0), 2.0), (0, 1, 0), 2)

    def measured(*later: Splats) -> LodMeasurement:
        still = np.zeros(len(splats), np.bool_)
        return measure(codec, splats, cameras, rasteriser, lambda *_: None, still=still, later=later)

    found = measured()
    ladder_db = [row.psnr_db for row in found.quality.ladder]
    assert 0 < len(found.order) < len(codec.lod_order)
    if enough_db == 50:
        assert ladder_db[-1] >= enough_db > ladder_db[-2], "the first level that leaves nothing to see is the last"
    else:
        assert ladder_db[-2] + 0.01 < ladder_db[-1] < enough_db, "what is left out would show nothing more"
    assert not any(item.attribute == "rotation" for item in found.order), "balls look the same however they are turned"
    kept = {book.attribute: book.enhancement_layers for book in found.applied(codec).quantiser.books}
    check_order(found.order, kept)
    shorter, whole = found.applied(codec), codec.quantise(codec.prepare(splats)).codes
    for book in codec.quantiser.books:
        name, layers = book.attribute, 1 + kept[book.attribute]
        codes = shorter.quantise(shorter.prepare(splats)).codes[name]
        np.testing.assert_array_equal(codes, book.prefix(whole[name], layers))
        np.testing.assert_array_equal(shorter.quantiser.books[name].lookup(codes, layers), book.lookup(codes, layers))

    assert measured(splats).order == found.order
    assert len(measured(long).order) > len(found.order), "a later frame that needs more levels has them"
