"""``lite`` in the kernels: the same answers as PyTorch's, whatever the size, the threads and the instruction set."""

import subprocess
import sys

import numpy as np
import pytest

import cags_kernels
from cags_client.restore.networks import Weights, create, from_weights, runtimes
from cags_common.errors import ConfigError

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())

SIZES = [(2, 2), (2, 38), (16, 8), (24, 32), (34, 130), (300, 400)]


def images_of(height, width, seed=0):
    """Own view, reference, fields, noise features."""
    rng = np.random.default_rng(seed)
    own, reference = rng.random((2, height, width, 3), dtype=np.float32)
    fields = rng.uniform(-0.2, 0.2, (height, width, 4)).astype(np.float32)
    return own, reference, fields, rng.uniform(-1, 1, (1, 1, 6)).astype(np.float32)


def loud_weights(seed=0, layers=6):
    """Weights that change much; as large as trained ones."""
    rng = np.random.default_rng(seed)

    def drawn(*shape, inputs):
        return (rng.standard_normal(shape) * np.sqrt(2 / inputs)).astype(np.float32)

    arrays = {"head.weight": drawn(24, 40, inputs=40), "head.bias": drawn(24, inputs=40)}
    arrays |= {"noise.weight": drawn(24, 6, inputs=40), "tail.weight": drawn(16, 24, 3, 3, inputs=216)}
    arrays |= {f"body.{i}.weight": drawn(24, 24, 3, 3, inputs=432) for i in range(layers)}
    arrays |= {f"body.{i}.bias": drawn(24, inputs=432) for i in range(layers)}
    return Weights("lite", {**arrays, "tail.bias": drawn(16, inputs=216)}, {})


@pytest.fixture
def variants():
    """Names of the instruction sets that run here; the one in use is restored."""
    used = cags_kernels.instruction_set()
    yield ("portable",) if used == "portable" else ("portable", used)
    cags_kernels.use_instruction_set(used)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("weights", [loud_weights(), Weights.shipped("lite")], ids=["loud", "shipped"])
def test_it_answers_as_pytorch_does_with_every_instruction_set(size, weights, variants):
    pytest.importorskip("torch")
    images = images_of(*size)
    expected = runtimes.create("torch", weights).run(*images)
    assert np.abs(expected - images[2]).max() > 1e-2, "it would show nothing"
    for name in variants:
        cags_kernels.use_instruction_set(name)
        answer = runtimes.create("kernels", weights, threads=2).run(*images)
        np.testing.assert_allclose(answer, expected, atol=1e-4)


def test_any_number_of_threads_and_any_memory_give_the_same_bits():
    """Scratch memory of other sizes is used again: what it held must not show."""
    runtime = {threads: runtimes.create("kernels", loud_weights(), threads) for threads in (1, 2, 5)}
    first = {size: runtime[1].run(*images_of(*size)).copy() for size in SIZES}
    for size in reversed(SIZES):
        for some in runtime.values():
            np.testing.assert_array_equal(some.run(*images_of(*size)), first[size])


def test_without_a_correction_nearby_it_changes_nothing():
    own, reference, fields, noise = images_of(48, 64)
    fields[:, :40] = 0
    answer = runtimes.create("kernels", loud_weights()).run(own, reference, fields, noise)
    np.testing.assert_array_equal(answer[:, :32], 0)
    assert np.abs(answer - fields)[:, 40:].max() > 1e-3


def test_extreme_features_stay_within_the_bounds():
    own, reference, fields, noise = images_of(16, 16)
    weights = loud_weights()
    weights.arrays["tail.weight"][:] *= 1e8
    answer = runtimes.create("kernels", weights).run(own, reference, fields, noise)
    assert np.isfinite(answer).all()
    assert np.abs(answer - fields)[..., 0].max() == pytest.approx(0.3, abs=1e-4)


def test_it_is_the_default_and_needs_no_pytorch():
    script = (
        "import sys; from cags_client.restore import create\n"
        "assert create('lite').name == 'lite'\n"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda arrays: arrays.pop("tail.bias"), "tail.bias"),
        (lambda arrays: arrays.update(odd=np.zeros(1, np.float32)), "'odd' is unknown"),
        (lambda arrays: arrays.update({"head.weight": np.zeros((24, 41), np.float32)}), "head of shape"),
        (lambda arrays: arrays.update({"body.2.weight": np.zeros((24, 24, 1, 1), np.float32)}), "same shape"),
        (lambda arrays: (arrays.pop("body.5.weight"), arrays.pop("body.5.bias")), "5 layers"),
    ],
)
def test_weights_that_do_not_fit_are_refused(change, complaint):
    weights = loud_weights()
    change(weights.arrays)
    with pytest.raises(ConfigError, match=complaint):
        from_weights(weights, "kernels")


def test_pictures_that_do_not_fit_are_refused():
    own, reference, fields, noise = images_of(8, 8)
    runtime = runtimes.create("kernels", loud_weights())
    with pytest.raises(ValueError, match="expected"):
        runtime.run(own[:4], reference, fields, noise)
    with pytest.raises(cags_kernels.KernelError, match="out of range"):
        runtime.run(*(image[:7] for image in (own, reference, fields)), noise)


def test_it_runs_no_other_network():
    with pytest.raises(ConfigError, match="'lite' alone"):
        create("srresnet@kernels")
