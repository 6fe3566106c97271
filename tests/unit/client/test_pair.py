"""What a restorer keeps between frames that show one reference and one own view of it."""

from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_client import restore
from cags_client.align import ReferencePicture, create
from cags_client.restore import RestoreInput
from cags_client.restore.pair import OncePerPair
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView

RNG = np.random.default_rng(5)
SMALL = Camera(Intrinsics.of_fov(40, 30, 1.0, 0.8), Pose.identity())
LARGE = Camera(Intrinsics.of_fov(81, 61, 1.0, 0.8), Pose.identity())


def picture(height: int, width: int) -> np.ndarray:
    return RNG.random((height, width, 3), dtype=np.float32)


def frames(count: int) -> list[RestoreInput]:
    """The same reference and own view, seen from places that differ."""
    reference = ReferencePicture(picture(30, 40), SMALL, 0)
    own = RenderedView(picture(30, 40), np.ones((30, 40), np.float32), None, None)
    out = []
    for i in range(count):
        camera = replace(LARGE, pose=replace(LARGE.pose, position=(0.02 * i, 0.0, 0.0)))
        aligned = create("auto").align(reference, np.full((61, 81), 2.0, np.float32), camera)
        out.append(RestoreInput(picture(61, 81), np.ones((61, 81), np.float32), aligned, reference, own))
    return out


class Counted(OncePerPair):
    calls = 0

    def __init__(self) -> None:
        super().__init__(self.call)

    def call(self, own: np.ndarray, reference: ReferencePicture) -> np.ndarray:
        self.calls += 1
        return own - reference.rgb


def test_a_pair_is_worked_out_once() -> None:
    once, (first, second) = Counted(), frames(2)
    assert not once.repeats(first)
    results = [once.of(inputs, inputs.own.rgb) for inputs in (first, second, second)]
    assert once.calls == 1
    assert results[0] is results[1] is results[2]


@pytest.mark.parametrize("new", ["own view", "reference"])
def test_a_new_picture_of_either_is_worked_out_anew(new: str) -> None:
    once, (first,) = Counted(), frames(1)
    once.of(first, first.own.rgb)
    other = first.afresh() if new == "own view" else replace(first, reference=replace(first.reference))
    assert not once.repeats(other)
    once.of(other, other.own.rgb)
    assert not once.repeats(first)  # the frame before alone counts
    assert once.calls == 2


def test_what_a_restorer_made_up_itself_is_of_one_frame() -> None:
    once, (first,) = Counted(), frames(1)
    alone = replace(first, own=None)
    assert [once.of(alone, picture(30, 40)) is not None and once.repeats(alone) for _ in range(2)] == [False, False]
    assert once.calls == 2
    assert alone.afresh() is alone


@pytest.mark.parametrize("kernels", [True, False])
@pytest.mark.parametrize("name", ["affine", "lite"])
def test_frames_look_the_same_whether_a_correction_was_kept(
    name: str, kernels: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not kernels:
        monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    keeping = restore.create(name)
    for inputs in frames(4):
        kept = keeping.restore(inputs).copy()
        np.testing.assert_array_equal(kept, restore.create(name).restore(inputs))
