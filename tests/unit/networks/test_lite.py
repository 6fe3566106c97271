"""``lite``: small, silent where the closed form is, and equal to it before training."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cags_client.restore.networks.inputs import noise_features  # noqa: E402
from cags_client.restore.networks.lite import (  # noqa: E402
    FACTOR_REACH,
    GATE_HALF,
    REACH,
    Lite,
    LiteShape,
    from_blocks,
    gate,
    spread,
    to_blocks,
)
from cags_client.restore.networks.srresnet import Sees, SrResNet  # noqa: E402
from cags_common.video.noise import CodingNoise  # noqa: E402


def parameters_of(network):
    return sum(p.numel() for p in network.parameters())


def test_sizes_are_what_the_design_allows():
    assert parameters_of(Lite()) <= 60_000
    assert parameters_of(SrResNet()) == 54_051
    assert parameters_of(SrResNet(Sees.REFERENCE)) == parameters_of(SrResNet(Sees.DISTORTED)) == 53_403


def test_blocks_go_there_and_back():
    image = torch.rand(2, 12, 8, 3)
    assert to_blocks(image).shape == (2, 6, 4, 12)
    assert torch.equal(from_blocks(to_blocks(image)), image)


def test_channels_of_a_block_are_its_pixels_in_reading_order():
    image = torch.arange(4.0).reshape(1, 2, 2, 1)
    assert to_blocks(image).flatten().tolist() == [0, 1, 2, 3]


def seen(height=32, width=32, change=0.02):
    """Own view, reference, fields and noise; the correction is ``change`` everywhere."""
    own, reference = torch.rand(2, 1, height, width, 3, generator=torch.Generator().manual_seed(0))
    fields = torch.full((1, height, width, 4), -0.5)
    fields[..., 1:] = change + 0.5 * own
    return own, reference, fields, torch.from_numpy(noise_features(CodingNoise()))[None, None, None]


def loud():
    torch.manual_seed(0)
    network = Lite()
    torch.nn.init.normal_(network.tail.weight)
    torch.nn.init.normal_(network.tail.bias)
    return network


def test_an_untrained_one_answers_with_the_fields_it_is_given():
    given = seen()
    with torch.no_grad():
        assert torch.allclose(Lite()(*given), given[2], atol=1e-7)


def test_without_a_correction_there_is_none_whatever_the_weights_are():
    own, reference, fields, noise = seen()
    with torch.no_grad():
        assert (loud()(own, reference, torch.zeros_like(fields), noise) == 0).all()
        assert (loud()(own, reference, fields, noise) - fields).abs().max() > 1e-3


def test_far_from_any_correction_there_is_none():
    own, reference, fields, noise = seen(height=64, width=64)
    fields[:, :, 32:] = 0.0
    with torch.no_grad():
        change = loud()(own, reference, fields, noise) - fields
    assert change[:, :, :32].abs().max() > 0
    assert change[:, :, 36:].abs().max() == 0


def test_what_it_changes_depends_on_the_coding_noise():
    own, reference, fields, noise = seen()
    with torch.no_grad():
        quiet, coarse = (loud()(own, reference, fields, n) for n in (noise, noise + 1))
    assert not torch.allclose(quiet, coarse)


def test_a_change_of_the_factor_leaves_the_mean_of_the_own_view_to_the_correction():
    """Detail is scaled about the own view's colours: there, only the correction moves the picture."""
    own, reference, fields, noise = seen()
    network = Lite()
    torch.nn.init.zeros_(network.tail.weight)
    with torch.no_grad():
        network.tail.bias[::4] = 1.0  # the factor of each of the four pixels of a block
        found = network(own, reference, fields, noise)
    assert (found[..., :1] - fields[..., :1]).abs().min() > 0.2
    before, after = (f[..., :1] * own + f[..., 1:] for f in (fields, found))
    assert torch.allclose(before, after, atol=1e-6)


def test_no_weights_move_a_correction_by_more_than_the_noise_allows():
    own, reference, fields, noise = seen()
    network = loud()
    torch.nn.init.normal_(network.tail.weight, std=10.0)
    for coarser in (0.0, 1.0):
        with torch.no_grad():
            found = network(own, reference, fields, noise + coarser)
        moved = [f[..., :1] * own + f[..., 1:] for f in (fields, found)]
        bound = REACH * spread(noise + coarser).item()
        assert 0.5 * bound < (moved[1] - moved[0]).abs().max() <= bound * 1.001
        assert (found - fields)[..., 0].abs().max() <= FACTOR_REACH * 1.001


def test_the_spread_of_noise_is_in_display_range():
    noise = CodingNoise(fine=(1e-3, 1e-3, 1e-3), broad=(1e-5, 1e-5, 1e-5))
    given = torch.from_numpy(noise_features(noise))[None, None, None]
    assert spread(given).item() == pytest.approx((1e-5 + 3e-5 + 2e-6) ** 0.5, rel=1e-3)


def test_the_gate_is_half_open_at_an_eighth_of_a_code_and_never_beyond_one():
    open_at = [float(gate(torch.full((1, 32, 32, 3), change)).mean()) for change in (0.0, -GATE_HALF, 0.1)]
    assert open_at == pytest.approx([0.0, 0.5, 0.995], abs=1e-2)


def test_noise_is_told_in_decades():
    noise = CodingNoise(fine=(1e-4, 1e-3, 1e-2), broad=(1e-5, 0.0, 1.0))
    np.testing.assert_allclose(noise_features(noise), [0, 1, 2, -1, -5, 4], atol=1e-3)
    np.testing.assert_array_equal(noise_features(np.array([*noise.fine, *noise.broad])), noise_features(noise))


def test_shape_can_be_chosen():
    assert parameters_of(Lite(LiteShape(width=8, layers=2))) < 5000
