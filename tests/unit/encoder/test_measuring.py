import numpy as np
import pytest

from cags_common.bundle.quality import LodQuality
from cags_common.raster import create
from cags_common.tiles.lod import LodLayer, check_order
from cags_encoder import EncodeSettings
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.measuring import cheapest_first, measure
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


def test_a_measured_order_is_complete_and_its_gains_add_up() -> None:
    splats = cloud(1500, 3)
    codec = SvqCodec.train(splats, EncodeSettings())
    rasteriser = create("auto")
    if rasteriser.name == "oracle":
        pytest.skip("the native kernels are not installed; measuring needs dozens of renders")
    done: list[int] = []
    cameras = cameras_around(Focus((0, 0, 0), 2.0), (0, 1, 0), 3)
    found = measure(codec, splats, cameras, rasteriser, lambda at, _: done.append(at))
    layers = {book.attribute: book.enhancement_layers for book in codec.quantiser.books}
    better = found.applied(codec)
    check_order(better.lod_order, layers)
    assert len(better.lod_gains_db) == len(better.lod_order)
    assert sum(better.lod_gains_db) > 15
    assert done == list(range(1, len(done) + 1))
    ladder, alone = found.quality.ladder, found.quality.layers
    assert [row.lod for row in ladder] == list(range(len(better.lod_order) + 1))
    assert {(row.attribute, row.layer) for row in alone} == {(a, k) for a in layers for k in range(layers[a] + 1)}
    assert ladder[-1].psnr_db == max(row.psnr_db for row in alone), "all layers of all attributes"
    assert ladder[-1].ssim > ladder[0].ssim and ladder[-1].size_bytes > ladder[0].size_bytes > 0
    assert LodQuality.from_json(found.quality.to_json()) == found.quality
