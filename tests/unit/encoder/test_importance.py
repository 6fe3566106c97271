import numpy as np
import pytest

from cags_common.raster import create
from cags_encoder.quantiser.configs import quantiser_config
from cags_encoder.quantiser.importance import importance
from cags_encoder.quantiser.training import train
from cags_encoder.scenes import Focus
from cags_encoder.views import cameras_around
from support.codec_scenes import cloud, with_changes


def test_what_is_seen_more_counts_more_and_what_is_not_counts_too() -> None:
    rasteriser = create("auto")
    splats = cloud(60).checked("x")
    logits = np.where(np.arange(60) < 30, 4.0, -20.0)
    splats = with_changes(splats, logit_opacities=logits)
    cameras = cameras_around(Focus((0.0, 0.0, 0.0), 2.0), (0.0, 1.0, 0.0), 2)
    weights = importance(splats, cameras, rasteriser)
    assert weights[:30].mean() > 2 * weights[30:].max()
    assert weights.min() > 0
    nothing = importance(with_changes(splats, logit_opacities=np.full(60, -30.0)), cameras, rasteriser)
    assert np.array_equal(nothing, np.ones(60))


@pytest.mark.parametrize("heavy", [slice(0, 300), slice(300, 3000)])
def test_heavier_samples_come_nearer(heavy: slice) -> None:
    splats = cloud(3000, 4).checked("x")
    config, weights = quantiser_config("layered"), np.ones(3000)
    weights[heavy] = 30

    def error(given: np.ndarray | None) -> float:
        quantiser = train(splats, config, 0, given)
        prepared = quantiser.prepare(splats)
        values, book = prepared.log_scales, quantiser.books["scale"]
        codes = quantiser.encode(prepared)["scale"]
        decoded = book.lookup(book.prefix(codes, 1), 1)
        return float(np.square(decoded - values)[heavy].mean())

    assert error(weights) < error(None)
