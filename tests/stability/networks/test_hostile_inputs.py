"""Networks on what goes wrong in a session: the output is finite, displayable, and of the right size."""

import numpy as np
import pytest

pytest.importorskip("torch")

from cags_client.frame import align
from cags_client.frame.align import ReferencePicture
from cags_client.frame.restore import RestoreInput
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_research.restore.networks import Weights, from_weights


def shipped():
    return from_weights(Weights.shipped("srresnet"))


def frame(depth, pose=None, reference_value=0.5, size=(40, 56), reference_size=(15, 20)):
    pose = pose or Pose.identity()
    height, width = size
    h, w = reference_size
    client = Camera(Intrinsics.of_fov(width, height, 1.0, 0.8), Pose.identity())
    seen = Camera(Intrinsics.of_fov(w, h, 1.1, 0.9), pose)
    reference = ReferencePicture(np.full((h, w, 3), reference_value, np.float32), seen, 0)
    depths = np.full(size, depth, np.float32)
    distorted = np.random.default_rng(0).uniform(size=(*size, 3)).astype(np.float32)
    aligned = align.create("fast").align(reference, depths, client)
    return RestoreInput(distorted, aligned, 0.0)


BEHIND = Pose((0.0, 0.0, 50.0), (1.0, 0.0, 0.0, 0.0))
CASES = {
    "void": lambda: frame(np.inf),
    "no depth": lambda: frame(np.nan),
    "depth zero": lambda: frame(0.0),
    "points behind the reference": lambda: frame(2.0, BEHIND),
    "turned away": lambda: frame(2.0, Pose((0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))),
    "a step of 30 cm": lambda: frame(2.0, Pose((0.3, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))),
    "black reference": lambda: frame(2.0, reference_value=0.0),
    "white reference": lambda: frame(2.0, reference_value=1.0),
    "one pixel": lambda: frame(2.0, size=(1, 1)),
    "reference of one pixel": lambda: frame(2.0, reference_size=(1, 1)),
    "odd": lambda: frame(2.0, size=(37, 53), reference_size=(17, 19)),
}


@pytest.mark.parametrize("name", list(CASES))
def test_output_is_finite_and_displayable(name):
    inputs = CASES[name]()
    shown = shipped().restore(inputs)
    assert shown.shape == inputs.distorted.shape
    assert np.isfinite(shown).all()
    assert shown.min() >= 0
    assert shown.max() <= 1


@pytest.mark.parametrize("name", ["void", "no depth", "depth zero", "points behind the reference", "turned away"])
def test_nothing_is_invented_where_the_reference_says_nothing(name):
    inputs = CASES[name]()
    np.testing.assert_array_equal(shipped().restore(inputs), inputs.distorted)
