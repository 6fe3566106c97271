"""``lite``: small, silent where the reference is silent, and equal to the evidence before training."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cags_client.restore.networks.inputs import CHANNELS  # noqa: E402
from cags_client.restore.networks.lite import Lite, LiteShape, brought_up, from_blocks, support, to_blocks  # noqa: E402
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


def test_untrained_takes_the_evidence_as_it_is():
    features = torch.rand(1, 16, 24, CHANNELS)
    features[..., 6] = 1.0
    with torch.no_grad():
        assert torch.allclose(Lite()(features), features[..., 3:6], atol=1e-6)


def test_nothing_changes_where_nothing_near_is_known():
    torch.manual_seed(0)
    network = Lite()
    torch.nn.init.normal_(network.tail.weight)
    features = torch.rand(1, 64, 64, CHANNELS)
    features[:, :, 32:, 6] = 0.0
    with torch.no_grad():
        change = network(features)
    assert change[:, :, :32].abs().max() > 0
    assert change[:, :, 44:].abs().max() == 0


def test_support_fades_over_the_edge_of_what_is_known():
    confidence = torch.ones(1, 8, 16, 4)
    confidence[:, :, 8:] = 0
    row = support(confidence)[0, 4, :, 0]
    assert row[:8].min() == 1
    assert row[12:].max() == 0
    assert (row.diff() <= 0).all()


def test_brought_up_is_what_opencv_does():
    cv2 = pytest.importorskip("cv2")
    change = np.random.default_rng(0).normal(size=(6, 8, 3)).astype(np.float32)
    expected = cv2.resize(change, (16, 12), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(brought_up(torch.from_numpy(change)[None])[0].numpy(), expected, atol=1e-5)


def test_shape_can_be_chosen():
    assert parameters_of(Lite(LiteShape(width=8, body_width=8, body_layers=2))) < 5000
