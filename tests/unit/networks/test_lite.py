"""``lite``: small, silent where the closed form is, and equal to it before training."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cags_client.restore.networks.inputs import (  # noqa: E402
    CHANNELS,
    CONFIDENCE,
    LEVEL,
    POWER,
    blocks_of,
    plus_change,
)
from cags_client.restore.networks.lite import (  # noqa: E402
    GATE_HALF,
    Lite,
    LiteShape,
    brought_up,
    from_blocks,
    gate,
    to_blocks,
)
from cags_client.restore.networks.srresnet import Sees, SrResNet  # noqa: E402


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


def features(height=32, width=32, change=0.02):
    out = np.random.default_rng(0).random((1, height, width, CHANNELS)).astype(np.float32)
    out[..., 6:9] = change
    return out


def blocks(level=0.0, **kwargs):
    return torch.from_numpy(blocks_of(features(**kwargs), np.float32(level)))


def loud():
    torch.manual_seed(0)
    network = Lite()
    torch.nn.init.normal_(network.tail.weight)
    return network


def test_an_untrained_network_adds_nothing():
    with torch.no_grad():
        assert Lite()(blocks(level=0.1)).abs().max() == 0


def test_where_the_closed_form_changes_nothing_the_network_may_not_either():
    with torch.no_grad():
        assert loud()(blocks(change=0.0)).abs().max() == 0
        assert loud()(blocks(change=0.02)).abs().max() > 0


def test_far_from_any_change_of_the_closed_form_there_is_none():
    given = features(height=64, width=64)
    given[:, :, 32:, 6:9] = 0.0
    with torch.no_grad():
        change = loud()(torch.from_numpy(blocks_of(given, np.float32(0.05))))
    assert change[:, :, :16].abs().max() > 0
    assert change[:, :, 18:].abs().max() == 0


def test_the_gate_is_half_open_at_an_eighth_of_a_code_and_never_beyond_one():
    open_at = [float(gate(blocks(change=change)).mean()) for change in (0.0, GATE_HALF, 0.1)]
    assert open_at == pytest.approx([0.0, 0.5, 0.995], abs=1e-2)


def test_blocks_of_numpy_are_blocks_of_torch():
    given = features(height=8, width=12)
    ours = torch.from_numpy(blocks_of(given, np.float32(0.3)))
    theirs = to_blocks(torch.from_numpy(given)).reshape(1, 4, 6, 4, CHANNELS)
    assert torch.equal(ours[..., :CONFIDENCE], theirs[..., :-1].reshape(1, 4, 6, CONFIDENCE))
    assert torch.allclose(ours[..., CONFIDENCE], theirs[..., -1].mean(dim=-1))
    assert torch.allclose(ours[..., POWER], torch.full((1, 4, 6), 0.02))
    assert (ours[..., LEVEL] == np.float32(0.3)).all()


def test_brought_up_is_what_opencv_does():
    cv2 = pytest.importorskip("cv2")
    change = np.random.default_rng(0).normal(size=(6, 8, 3)).astype(np.float32)
    expected = cv2.resize(change, (16, 12), interpolation=cv2.INTER_LINEAR)
    inside = to_blocks(torch.from_numpy(change)[None])
    np.testing.assert_allclose(brought_up(inside)[0].numpy(), expected, atol=1e-5)


@pytest.mark.parametrize("size", [(24, 32), (23, 29), (1, 1)])
def test_a_change_is_added_as_training_adds_it(size):
    rng = np.random.default_rng(1)
    change = rng.normal(0, 0.2, (6, 8, 12)).astype(np.float32)
    picture = rng.random((*size, 3)).astype(np.float32)
    full = brought_up(torch.from_numpy(change)[None])[0].numpy()[: size[0], : size[1]]
    np.testing.assert_allclose(plus_change(picture, change, 2), np.clip(picture + full, 0, 1), atol=1e-5)


def test_shape_can_be_chosen():
    assert parameters_of(Lite(LiteShape(width=8, body_width=8, body_layers=2))) < 5000
