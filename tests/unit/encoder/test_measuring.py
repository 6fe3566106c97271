from pathlib import Path

import numpy as np
import pytest

from cags_common.lod import LodLayer, check_order
from cags_common.raster import create
from cags_encoder import EncodeSettings
from cags_encoder.measuring import cameras_around, cheapest_first, measured
from cags_encoder.svq_codec import SvqCodec
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
    cameras = cameras_around((1.0, 2.0, 3.0), 2.0, (0.0, -1.0, 0.0), 0.1)
    for camera in cameras:
        rotation, translation = camera.world_to_camera
        seen = rotation @ np.array([1.0, 2.0, 3.0]) + translation
        assert np.allclose(seen[:2], 0, atol=1e-9) and seen[2] > 2.0
    assert np.linalg.norm(np.mean([camera.pose.position for camera in cameras], axis=0) - [1, 2, 3]) < 2.0


def test_a_measured_order_is_complete_and_its_gains_add_up(tmp_path: Path) -> None:
    splats = cloud(1500, 3)
    codec = SvqCodec.train(splats, EncodeSettings())
    rasteriser = create("auto")
    if rasteriser.name == "reference":
        pytest.skip("the native kernels are not installed; measuring needs dozens of renders")
    done: list[int] = []
    better = measured(
        codec, splats, cameras_around((0, 0, 0), 2, (0, 1, 0), 0.1), rasteriser, lambda at, _: done.append(at)
    )
    check_order(better.lod_order, {book.attribute: book.enhancement_layers for book in codec.quantiser.books})
    assert len(better.lod_gains_db) == len(better.lod_order)
    assert sum(better.lod_gains_db) > 15
    assert done == list(range(1, len(done) + 1))
