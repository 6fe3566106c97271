"""Restorers that run networks: what they show, where they keep silent, and that every runtime says the same."""

from dataclasses import replace

import numpy as np
import pytest

from cags_client.frame import align
from cags_client.frame.align import AlignSettings, ReferencePicture
from cags_client.frame.restore import RestoreInput
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_research.restore.networks import NETWORKS, Weights, create, from_weights, network_of, runtimes
from cags_research.restore.networks.gate import START_DB
from cags_research.restore.networks.inputs import filled, reach
from cags_research.restore.networks.srresnet import Sees, SrResNet


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
    return RestoreInput(truth - np.float32(error), aligned, 0.0), truth


def weights_of(network, name):
    return Weights(name, {k: p.detach().numpy() for k, p in network.named_parameters()}, {})


def plane(expected_db):
    torch = pytest.importorskip("torch")
    return torch.full((1, 1, 1, 1), float(expected_db))


def untrained():
    return from_weights(weights_of(SrResNet(), "srresnet"))


def silent(inputs):
    return replace(inputs, aligned=replace(inputs.aligned, confidence=np.zeros_like(inputs.aligned.confidence)))


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2), (31, 17), (48, 64), (50, 66)])
def test_any_size(size):
    inputs, _ = scene(*size)
    shown = untrained().restore(inputs)
    assert shown.shape == (*size, 3)
    assert shown.dtype == np.float32
    assert np.isfinite(shown).all()
    assert shown.min() >= 0
    assert shown.max() <= 1


def test_without_a_say_of_the_reference_the_distorted_picture_stays_bit_for_bit():
    inputs, _ = scene()
    np.testing.assert_array_equal(untrained().restore(silent(inputs)), inputs.distorted)


def test_inputs_are_not_changed():
    inputs, _ = scene()
    before = [a.copy() for a in (inputs.distorted, inputs.aligned.rgb, inputs.aligned.confidence)]
    untrained().restore(inputs)
    for a, b in zip(before, (inputs.distorted, inputs.aligned.rgb, inputs.aligned.confidence), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("sees", "shown"), [(Sees.BOTH, 1), (Sees.REFERENCE, 0), (Sees.DISTORTED, 1)])
def test_the_papers_network_starts_from_a_picture(sees, shown):
    """With both, from the distorted one: from the reference it would have to win back decibels first."""
    torch = pytest.importorskip("torch")
    pictures = torch.rand(2, 1, 12, 16, 3, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        assert torch.allclose(SrResNet(sees)(*pictures), pictures[shown], atol=1e-6)


@pytest.mark.parametrize("expected_db", [None, 0.0, 27.0, 51.0])
def test_training_starts_from_the_blurred_difference(expected_db):
    """The detail of the client's picture in the colours of the reference, by the PSNR expected of the two."""
    torch = pytest.importorskip("torch")
    aligned, distorted = torch.rand(2, 1, 21, 26, 3, generator=torch.Generator().manual_seed(0))
    network = SrResNet(gated=expected_db is not None)
    network.start_at_blurred()
    blurred = (aligned - distorted).permute(0, 3, 1, 2)
    for _ in range(6):
        blurred = torch.nn.functional.avg_pool2d(blurred, 3, 1, 1)
    with torch.no_grad():
        shown = network(aligned, distorted, *(() if expected_db is None else (plane(expected_db),)))
    share = 1.0 if expected_db is None else 1 / (1 + 10 ** ((expected_db - START_DB) / 10))
    assert torch.allclose(shown, distorted + share * blurred.permute(0, 2, 3, 1), atol=1e-6)


def test_a_gate_shows_what_it_is_told_to():
    torch = pytest.importorskip("torch")
    aligned, distorted = torch.rand(2, 1, 13, 22, 3, generator=torch.Generator().manual_seed(1))
    network = SrResNet(gated=True)
    torch.nn.init.normal_(network.tail.weight, std=0.1)
    for expected_db, shows in ((130.0, "distorted"), (-80.0, "restored")):
        with torch.no_grad():
            shown = network(aligned, distorted, plane(expected_db))
            gate, network.gate = network.gate, None
            restored, network.gate = network(aligned, distorted), gate
        assert torch.allclose(shown, distorted if shows == "distorted" else restored, atol=1e-6)
    with pytest.raises(ValueError, match="reference alone has none"):
        SrResNet(Sees.REFERENCE, gated=True)
    with pytest.raises(ValueError, match="needs the expected PSNR"):
        network(aligned, distorted)


def learnt_gate():
    """A gate whose weights are anything."""
    torch = pytest.importorskip("torch")
    torch.manual_seed(3)
    network = SrResNet(gated=True)
    network.start_at_blurred()
    torch.nn.init.normal_(network.gate.said.weight, std=0.3)
    torch.nn.init.normal_(network.gate.said.bias, std=0.3)
    return network


def test_at_the_top_of_the_ladder_training_starts_as_good_as_the_identity():
    """48 dB against a reference whose colours are 40 dB off: what is shown loses less than 0.1 dB."""
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.2, 0.8, (1, 48, 64, 3)).astype(np.float32)
    distorted = truth + rng.normal(0, 10 ** (-48 / 20), truth.shape).astype(np.float32)
    aligned = truth + np.float32(0.01)
    network = SrResNet(gated=True)
    network.start_at_blurred()
    with torch.no_grad():
        shown = network(torch.from_numpy(aligned), torch.from_numpy(distorted), plane(48.0)).numpy()
    before, after = (float(np.square(picture - truth).mean()) for picture in (distorted, shown))
    assert 10 * np.log10(after / before) < 0.1


def test_a_restorer_tells_its_network_what_is_expected():
    inputs, truth = scene()
    restorer = from_weights(weights_of(learnt_gate(), "srresnet"))
    errors = [float(np.abs(restorer.restore(replace(inputs, expected_db=x)) - truth).mean()) for x in (20, 33, 50)]
    assert errors[0] < errors[1] < errors[2]


def test_weights_of_a_gate_that_was_told_something_else_are_refused_with_the_way_out():
    weights = weights_of(SrResNet(gated=True), "srresnet")
    before = {name.replace("said", "last"): array for name, array in weights.arrays.items()}
    with pytest.raises(ConfigError, match=r"'gate\.last\.bias' is .*unknown.*; train them anew with 'cags-train"):
        network_of(replace(weights, arrays=before))


def test_weights_say_whether_their_network_has_a_gate():
    for gated in (False, True):
        network = network_of(weights_of(SrResNet(gated=gated), "srresnet"))
        assert (network.gate is not None) == gated


def test_one_input_variants_look_at_one_input():
    inputs, _ = scene()
    other = replace(inputs, distorted=inputs.distorted[::-1] * np.float32(0.5))
    reference_only = from_weights(weights_of(SrResNet(Sees.REFERENCE), "sr-align-ref"))
    np.testing.assert_array_equal(reference_only.restore(inputs), reference_only.restore(other))
    distorted_only = from_weights(weights_of(SrResNet(Sees.DISTORTED), "cr-no-ref"))
    np.testing.assert_array_equal(distorted_only.restore(inputs), inputs.distorted)


@pytest.mark.parametrize("gated", [False, True])
@pytest.mark.parametrize("name", ["openvino", "onnxruntime"])
def test_every_runtime_says_the_same(name, gated):
    pytest.importorskip(name, reason=f"needs {name}: pip install cags-stream[runtimes]")
    torch = pytest.importorskip("torch")
    torch.manual_seed(1)
    made = SrResNet(gated=gated)
    torch.nn.init.normal_(made.tail.weight, std=0.1)
    if gated:
        torch.nn.init.normal_(made.gate.said.weight, std=0.5)
    rng = np.random.default_rng(2)
    weights = weights_of(made, "srresnet")
    for shape in ((24, 32), (16, 8), (19, 29)):
        images = [rng.uniform(size=(*shape, 3)).astype(np.float32) for _ in range(2)]
        images += [np.full((1, 1, 1), 30, np.float32)] if gated else []
        expected = runtimes.create("torch", weights).run(*images)
        np.testing.assert_allclose(runtimes.create(name, weights, threads=1).run(*images), expected, atol=1e-3)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="srresnet, sr-align-ref"):
        create("deep")
    with pytest.raises(ConfigError, match="torch, cuda, openvino"):
        from_weights(weights_of(SrResNet(), "srresnet"), "abacus")


def test_cuda_without_a_device_says_so():
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(ConfigError, match="CUDA device"):
        from_weights(weights_of(SrResNet(), "srresnet"), "cuda")


@pytest.mark.parametrize("name", NETWORKS)
def test_shipped_weights_fit_their_network(name):
    weights = Weights.shipped(name)
    network_of(weights)
    assert weights.about["command"].startswith("cags-train restore")


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
