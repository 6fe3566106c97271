"""Restorers that run networks: what they show, where they keep silent, and that every runtime says the same."""

from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_client import align
from cags_client.align import AlignSettings, ReferencePicture
from cags_client.restore import RestoreInput
from cags_client.restore import create as create_tier
from cags_client.restore.networks import NETWORKS, Weights, create, from_weights, network_of, runtimes
from cags_client.restore.networks.inputs import even, filled, reach
from cags_client.restore.networks.lite import Lite
from cags_client.restore.networks.srresnet import Sees, SrResNet
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView


def scene(height=48, width=64, seed=0, error=0.1):
    """A smooth picture, its distorted copy (too dark by ``error``), and a reference of a quarter the size."""
    rng = np.random.default_rng(seed)
    h, w = max(1, height // 4), max(1, width // 4)
    truth = np.full((height, width, 3), 0.5, np.float32) + rng.uniform(-0.02, 0.02, (height, width, 3)).astype("f")
    small = np.full((h, w, 3), 0.5, np.float32)
    client, other = (Camera(Intrinsics.of_fov(*size, 1.0, 1.0), Pose.identity()) for size in ((width, height), (w, h)))
    reference = ReferencePicture(small, other, 0)
    settings = AlignSettings(border_px=0.0)
    aligned = align.create("fast", settings).align(reference, np.ones((height, width), np.float32), client)
    own = RenderedView(small - np.float32(error), np.ones((h, w), np.float32), None, None)
    alpha = np.ones((height, width), np.float32)
    return RestoreInput(truth - np.float32(error), alpha, aligned, reference, own), truth


def weights_of(network, name):
    return Weights(name, {k: p.detach().numpy() for k, p in network.named_parameters()}, {})


def lite_untrained():
    return from_weights(weights_of(Lite(), "lite"))


def silent(inputs):
    return replace(inputs, aligned=replace(inputs.aligned, confidence=np.zeros_like(inputs.aligned.confidence)))


def loud_lite():
    torch = pytest.importorskip("torch")
    torch.manual_seed(3)
    network = Lite()
    torch.nn.init.normal_(network.tail.weight, std=0.02)
    return from_weights(weights_of(network, "lite"))


@pytest.mark.parametrize("size", [(48, 64), (31, 17), (9, 8)])
def test_the_kernel_corrects_by_the_networks_fields_as_numpy_does(size, monkeypatch):
    if not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    inputs, _ = scene(*size)
    fast = loud_lite().restore(inputs).copy()
    assert np.abs(fast - create_tier("affine").restore(inputs)).max() > 1e-3, "it would show nothing"
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    np.testing.assert_allclose(fast, loud_lite().restore(inputs), atol=1e-4)


def test_without_own_splats_it_compares_with_the_picture_itself():
    inputs, truth = scene()
    shown = lite_untrained().restore(replace(inputs, own=None))
    assert np.abs(shown - truth).mean() < 0.5 * np.abs(inputs.distorted - truth).mean()


def test_untrained_lite_shows_the_closed_form():
    inputs, _ = scene()
    np.testing.assert_allclose(lite_untrained().restore(inputs), create_tier("affine").restore(inputs), atol=1e-6)


def test_splats_as_good_as_the_reference_are_left_alone_by_any_weights():
    """The gate is part of the graph: no weights can open it where there is no evidence."""
    inputs, _ = scene(error=0.0)
    np.testing.assert_array_equal(loud_lite().restore(inputs), inputs.distorted)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2), (31, 17), (48, 64), (50, 66)])
def test_any_size(size):
    inputs, _ = scene(*size)
    for restorer in (lite_untrained(), from_weights(weights_of(SrResNet(), "srresnet"))):
        shown = restorer.restore(inputs)
        assert shown.shape == (*size, 3)
        assert shown.dtype == np.float32
        assert np.isfinite(shown).all()
        assert shown.min() >= 0
        assert shown.max() <= 1


@pytest.mark.parametrize("name", ["lite", "srresnet"])
def test_without_a_say_of_the_reference_the_distorted_picture_stays_bit_for_bit(name):
    inputs, _ = scene()
    network = {"lite": Lite, "srresnet": SrResNet}[name]()
    restorer = from_weights(weights_of(network, name))
    np.testing.assert_array_equal(restorer.restore(silent(inputs)), inputs.distorted)


def test_inputs_are_not_changed():
    inputs, _ = scene()
    before = [a.copy() for a in (inputs.distorted, inputs.aligned.rgb, inputs.reference.rgb)]
    lite_untrained().restore(inputs)
    for a, b in zip(before, (inputs.distorted, inputs.aligned.rgb, inputs.reference.rgb), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("sees", "shown"), [(Sees.BOTH, 1), (Sees.REFERENCE, 0), (Sees.DISTORTED, 1)])
def test_the_papers_network_starts_from_a_picture(sees, shown):
    """With both, from the distorted one: from the reference it would have to win back decibels first."""
    torch = pytest.importorskip("torch")
    pictures = torch.rand(2, 1, 12, 16, 3, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        assert torch.allclose(SrResNet(sees)(*pictures), pictures[shown], atol=1e-6)


def test_one_input_variants_look_at_one_input():
    inputs, _ = scene()
    other = replace(inputs, distorted=inputs.distorted[::-1] * np.float32(0.5))
    reference_only = from_weights(weights_of(SrResNet(Sees.REFERENCE), "sr-align-ref"))
    np.testing.assert_array_equal(reference_only.restore(inputs), reference_only.restore(other))
    distorted_only = from_weights(weights_of(SrResNet(Sees.DISTORTED), "cr-no-ref"))
    np.testing.assert_array_equal(distorted_only.restore(inputs), inputs.distorted)


@pytest.mark.parametrize("name", ["openvino", "onnxruntime"])
@pytest.mark.parametrize("network", [Lite, SrResNet])
def test_every_runtime_says_the_same(name, network):
    pytest.importorskip(name, reason=f"needs {name}: pip install cags-stream[runtimes]")
    torch = pytest.importorskip("torch")
    torch.manual_seed(1)
    made = network()
    torch.nn.init.normal_(made.tail.weight, std=0.1)
    rng = np.random.default_rng(2)
    channels = (3, 3, 4) if network is Lite else (3, 3)
    weights = weights_of(made, "lite" if network is Lite else "srresnet")
    for shape in ((24, 32), (16, 8)):
        images = [rng.uniform(size=(*shape, count)).astype(np.float32) for count in channels]
        images += [np.full((1, 1, 6), 0.5, np.float32)] if network is Lite else []
        expected = runtimes.create("torch", weights).run(*images)
        np.testing.assert_allclose(runtimes.create(name, weights, threads=1).run(*images), expected, atol=1e-3)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="lite, srresnet"):
        create("deep")
    with pytest.raises(ConfigError, match="kernels, torch, cuda, openvino"):
        from_weights(weights_of(Lite(), "lite"), "abacus")


def test_cuda_without_a_device_says_so():
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(ConfigError, match="CUDA device"):
        from_weights(weights_of(Lite(), "lite"), "cuda")


@pytest.mark.parametrize("name", NETWORKS)
def test_shipped_weights_fit_their_network(name):
    try:
        weights = Weights.shipped(name)
    except ConfigError:
        pytest.skip(f"no weights of {name} are shipped")
    network_of(weights)
    assert weights.about["command"].startswith("cags-train restore")


def test_odd_sides_repeat_their_last_pixels():
    image = np.arange(9, dtype=np.float32).reshape(3, 3, 1)
    assert even(image).shape == (4, 4, 1)
    assert even(image)[3, 3] == 8
    whole = np.zeros((8, 16, 3), np.float32)
    assert even(whole) is whole


def test_filled_keeps_what_alignment_found():
    aligned = np.zeros((2, 2, 3), np.float32)
    aligned[0, 0], aligned[0, 1] = 0.3, 0.4
    confidence = np.float32([[1, 0], [1, 0]])  # (0, 1) was filled by erosion, (1, 0) is truly black
    out = filled(aligned, confidence, np.full((2, 2, 3), 0.9, np.float32))
    np.testing.assert_allclose(out[..., 0], [[0.3, 0.4], [0, 0.9]], rtol=1e-6)


def test_reach_is_one_inside_and_zero_far_outside():
    confidence = np.zeros((64, 96), np.float32)
    confidence[:, :32] = 1
    out = reach(confidence)
    assert out.shape == confidence.shape
    assert out[:, :32].min() > 0.99
    assert out[:, 60:].max() == 0
