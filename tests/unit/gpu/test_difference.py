"""The server's reference on the device: truth, the client's copy, and what it lacks, in one submission."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.correction import ComparingScene, Look, Reference, StagedViews
from cags_common.raster import DepthKind, Footprint, create
from cags_gpu import submission
from cags_gpu.correct import corrected
from cags_gpu.difference import DeviceViews
from cags_gpu.keeper import Keeper
from cags_gpu.raster import GpuRasteriser, GpuScene
from cags_gpu.workspace import Workspace
from support.device_frames import CLIENT, EXACT, SERVER, plates
from support.gpu import any_gpu, needs_adapter, rasteriser

pytestmark = needs_adapter

OPTIONS = replace(EXACT, contribution=True)
STEP_LACK, STEP_SEEN = 0.5 / 32767 + 1e-6, 0.5 / 65535 + 1e-6
"""Rounding to 16 bits, and single precision."""


def scenes(keeper: Keeper | None = None) -> tuple[GpuScene, GpuScene]:
    backend = rasteriser() if keeper is None else GpuRasteriser(keeper)
    held = plates()
    held.sh0[::3] += 0.4
    return backend.load(plates()), backend.load(held)


def compared(truth: GpuScene, held: GpuScene, *looks: Look, knee: float = 0.1) -> DeviceViews:
    made = truth.compared(held, SERVER, OPTIONS, knee=knee, looks=looks)
    assert made is not None
    return made


def staged(truth: GpuScene, held: GpuScene) -> StagedViews:
    return StagedViews(*(scene.render(SERVER, EXACT).rgb for scene in (truth, held)))


@pytest.mark.parametrize("looks", [(), (Look.LACK, Look.COMPANDED), (Look.TRUTH, Look.LACK), tuple(Look)])
def test_the_pictures_are_those_of_two_renders_whichever_come_first(looks: tuple[Look, ...]) -> None:
    truth, held = scenes()
    assert isinstance(truth, ComparingScene)
    ours, right = compared(truth, held, *looks), staged(truth, held)
    np.testing.assert_allclose(ours.truth, right.truth, atol=STEP_SEEN)
    np.testing.assert_allclose(ours.lack, right.lack, atol=STEP_LACK)
    for knee in (0.1, 0.03):
        np.testing.assert_allclose(ours.companded(knee), right.companded(knee), atol=2e-3)
    assert np.abs(right.lack).max() > 0.05
    by_cpu = create("cpu").load(plates()).render(SERVER, OPTIONS)
    np.testing.assert_allclose(ours.contribution, by_cpu.contribution, rtol=1e-3, atol=5e-3)
    depth = held.render(SERVER, replace(EXACT, depth=DepthKind.EXPECTED)).depth
    np.testing.assert_array_equal(ours.depth, depth)


def test_one_submission_brings_what_was_asked_for_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    real = submission._read

    def counted(workspace: Workspace, recording: submission.Recording, wanted: submission.Outputs) -> object:
        read.append(sum(size for _, size in wanted))
        return real(workspace, recording, wanted)

    monkeypatch.setattr(submission, "_read", counted)
    truth, held = scenes()
    ours = compared(truth, held, Look.LACK, Look.COMPANDED)
    pixels = SERVER.width_px * SERVER.height_px
    assert read == [16 + 16 * pixels + 4 * pixels + 4 * len(truth)], "the state, two pictures, the depth, contributions"
    assert ours.companded(0.1).shape == ours.lack.shape
    assert len(read) == 1
    assert ours.truth.shape == ours.lack.shape
    assert read[1:] == [8 * pixels]


@pytest.mark.parametrize("crowded", ["truth", "mirror"])
def test_entries_that_overflow_in_either_drawing_compare_nothing_wrong(crowded: str) -> None:
    small = Keeper(any_gpu)
    workspace = small.current()
    assert workspace is not None
    few = plates().take(np.arange(3))
    pair = (plates(), few) if crowded == "truth" else (few, plates())
    truth, held = (GpuRasteriser(small).load(splats) for splats in pair)
    for scene in (truth, held):
        scene.on_device(lambda resident: resident, lambda _: None)
    workspace.counts["capacity"] = 64
    workspace.version += 1
    workspace._buffers.clear()
    ours = compared(truth, held, *Look)
    right = compared(*(rasteriser().load(splats) for splats in pair), *Look)
    assert workspace.counts["capacity"] > 64
    for one, other in ((ours.truth, right.truth), (ours.lack, right.lack), (ours.contribution, right.contribution)):
        np.testing.assert_array_equal(one, other)
    small.close()


def test_what_is_looked_at_late_is_what_was_drawn() -> None:
    truth, held = scenes()
    first = compared(truth, held)
    now = staged(truth, held).lack
    grey = plates()
    grey.sh0[:] = 0.0
    truth.update(np.arange(len(truth)), grey)
    second = compared(truth, held)
    np.testing.assert_allclose(first.lack, now, atol=STEP_LACK)
    assert np.abs(second.lack - first.lack).max() > 0.1


def test_what_one_device_cannot_do_alone_is_done_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cags_gpu.keeper.FIRST_DELAY_S", 60.0)
    other = Keeper(any_gpu)
    truth, held = scenes(other)
    elsewhere, _ = scenes()
    empty = rasteriser().load(plates().take(np.zeros(0, np.intp)))
    for scene, copy in ((elsewhere, held), (elsewhere, empty), (elsewhere, create("cpu").load(plates()))):
        assert scene.compared(copy, SERVER, OPTIONS, knee=0.1, looks=()) is None
    early = compared(truth, held)
    right = staged(truth, held)
    other.current().gpu.destroy()  # type: ignore[union-attr]
    np.testing.assert_allclose(early.lack, right.lack, atol=1e-3)
    np.testing.assert_allclose(early.companded(0.1), right.companded(0.1), atol=1e-2)
    assert truth.compared(held, SERVER, OPTIONS, knee=0.1, looks=()) is None
    other.close()


def test_what_the_server_codes_the_client_adds() -> None:
    held = plates()
    held.sh0[:] -= 0.5
    truth, scene = rasteriser().load(plates()), rasteriser().load(held)
    options = replace(EXACT, footprint=Footprint.of(CLIENT.intrinsics, SERVER.intrinsics))
    made = truth.compared(scene, SERVER, options, knee=0.1, looks=(Look.COMPANDED,))
    assert made is not None
    right = np.clip(create("cpu").load(plates()).render(CLIENT, EXACT).rgb, 0, 1)
    before = corrected(scene, CLIENT, EXACT, None)
    after = corrected(scene, CLIENT, EXACT, Reference(made.companded(0.1), SERVER))
    assert np.mean((after.rgb - right) ** 2) < 0.2 * np.mean((before.rgb - right) ** 2)
