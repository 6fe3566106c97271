"""The server's reference on the device: truth, the client's copy, and what it lacks, in one submission."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from cags_common.correction import ComparingScene, Look, Reference, StagedViews
from cags_common.geometry import Camera
from cags_common.raster import DepthKind, Footprint, create
from cags_common.splats import Splats
from cags_gpu import submission
from cags_gpu.correct import corrected
from cags_gpu.difference import DeviceViews
from cags_gpu.keeper import Keeper
from cags_gpu.layers import most_layers
from cags_gpu.raster import GpuRasteriser, GpuScene
from cags_gpu.submission import Submission
from cags_gpu.workspace import LAYERS, TooLargeError, Workspace
from support.device_frames import CLIENT, EXACT, SERVER, plates
from support.gpu import any_gpu, keeper, needs_adapter, rasteriser
from support.raster_scenes import camera, random_splats

pytestmark = needs_adapter

OPTIONS = replace(EXACT, contribution=True)
STEP = 1e-6
"""Single precision."""


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
    np.testing.assert_allclose(ours.truth, right.truth, atol=STEP)
    np.testing.assert_allclose(ours.lack, right.lack, atol=STEP)
    for knee in (0.1, 0.03):
        np.testing.assert_allclose(ours.companded(knee), right.companded(knee), atol=2e-3)
    assert np.abs(right.lack).max() > 0.05
    by_cpu = create("cpu").load(plates()).render(SERVER, OPTIONS)
    np.testing.assert_allclose(ours.contribution, by_cpu.contribution, rtol=1e-3, atol=5e-3)
    depth = held.render(SERVER, replace(EXACT, depth=DepthKind.EXPECTED)).depth
    np.testing.assert_array_equal(ours.depth, depth)


@pytest.fixture
def submissions(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Bytes that each submission brought."""
    brought: list[int] = []
    real = submission._submit

    def counted(workspace: Workspace, recording: submission.Recording, wanted: submission.Outputs) -> object:
        brought.append(sum(output.size for output in wanted))
        return real(workspace, recording, wanted)

    monkeypatch.setattr(submission, "_submit", counted)
    return brought


def test_one_submission_brings_what_was_asked_for_and_no_more(submissions: list[int]) -> None:
    truth, held = scenes()
    ours = compared(truth, held, Look.LACK, Look.COMPANDED)
    pixels = SERVER.width_px * SERVER.height_px
    brought = 16 + 24 * pixels + 4 * pixels + 4 * len(truth)
    assert submissions == [brought], "the state, two pictures, the depth, contributions"
    assert ours.companded(0.1).shape == ours.lack.shape
    assert len(submissions) == 1
    assert ours.truth.shape == ours.lack.shape
    assert submissions[1:] == [12 * pixels]


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
    np.testing.assert_allclose(first.lack, now, atol=STEP)
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


def copies(number: int) -> list[GpuScene]:
    """What different clients hold."""
    made = []
    for seed in range(number):
        held = plates()
        held.sh0[:] += np.random.default_rng(seed).normal(0, 0.2, held.sh0.shape).astype(np.float32)
        made.append(rasteriser().load(held))
    return made


@contextmanager
def held_up(scene: GpuScene, until: int) -> Iterator[None]:
    """The device is busy until as many comparisons wait for it."""
    workspace, comparisons = keeper().current(), keeper().comparisons
    assert workspace is not None
    with workspace.gpu.used():
        yield
        deadline = time.monotonic() + 30
        while len(comparisons._waiting) < until and time.monotonic() < deadline:
            time.sleep(0.001)


def aside(steps: int) -> Camera:
    return replace(SERVER, pose=replace(SERVER.pose, position=(0.9 - 0.02 * steps, 0.3, -4.7)))


def asked_for(truth: GpuScene, copy: GpuScene, seen_by: Camera) -> DeviceViews | None:
    """All pictures of a comparison, as a client of :data:`CLIENT` wants them."""
    footprint = Footprint.of(CLIENT.intrinsics, seen_by.intrinsics)
    return truth.compared(copy, seen_by, replace(OPTIONS, footprint=footprint), knee=0.1, looks=tuple(Look))


def at_once(truths: Sequence[GpuScene], held: Sequence[GpuScene], cameras: Sequence[Camera]) -> list[DeviceViews]:
    """Comparisons of as many threads, that all wait for the device before any is drawn."""

    with ThreadPoolExecutor(len(held)) as pool:
        with held_up(truths[0], len(held)):
            futures = [pool.submit(asked_for, *each) for each in zip(truths, held, cameras, strict=True)]
        made = [future.result(60) for future in futures]
    assert None not in made
    return [views for views in made if views is not None]


def alone(truth: GpuScene, copy: GpuScene, camera: Camera) -> DeviceViews:
    (made,) = at_once([truth], [copy], [camera])
    return made


@pytest.mark.parametrize("clients", [2, 5, LAYERS, LAYERS + 3])
def test_those_that_wait_are_drawn_together_and_have_the_same_bits(clients: int, submissions: list[int]) -> None:
    truths = [rasteriser().load(plates()), rasteriser().load(plates().take(np.arange(460)[::-1]))]
    truths = [truths[i % 3 == 2] for i in range(clients)]
    held, cameras = copies(clients), [aside(i) for i in range(clients)]
    right = [alone(*each) for each in zip(truths, held, cameras, strict=True)]
    submissions.clear()
    made = at_once(truths, held, cameras)
    again = at_once(truths, held, cameras)
    assert len(submissions) <= 2 * -(-clients // LAYERS) + 2, "drawn again at most once, with more room for entries"
    for views in (made, again):
        for ours, one in zip(views, right, strict=True):
            for name in ("truth", "lack", "contribution", "depth"):
                np.testing.assert_array_equal(getattr(ours, name), getattr(one, name))
            np.testing.assert_array_equal(ours.companded(0.1), one.companded(0.1))
    assert np.abs(made[0].lack - made[1].lack).max() > 0.1


def ties() -> Splats:
    """Splats of three depths and many colours: which of them is in front hangs on their contents."""
    splats = random_splats(300, seed=5, log_scale=-1.2)
    splats.means[:, 2] = np.random.default_rng(6).integers(-1, 2, 300)
    splats.logit_opacities[:] = 1.0
    return splats


def test_scenes_that_change_from_frame_to_frame_have_the_order_of_their_contents() -> None:
    truth, held = rasteriser().load(ties()), [rasteriser().load(ties()) for _ in range(4)]
    ahead = camera(48, 36)  # depths as in the world: equal ones stay equal
    for turn in range(3):
        for seed, copy in enumerate(held):
            rows = np.arange(seed, 300, 2 + turn)
            new = ties()
            new.sh0[:] += np.random.default_rng(10 * turn + seed).normal(0, 0.5, new.sh0.shape).astype(np.float32)
            copy.update(rows, new)
        made, again = (at_once([truth] * 4, held, [ahead] * 4) for _ in range(2))
        right = [alone(truth, copy, ahead) for copy in held]
        for views in (made, again):
            for ours, one in zip(views, right, strict=True):
                np.testing.assert_array_equal(ours.lack, one.lack)
        assert np.abs(made[0].lack - made[1].lack).max() > 0.1


def test_only_what_fits_together_is_drawn_together(submissions: list[int]) -> None:
    truth, held = rasteriser().load(plates()), copies(4)
    small = replace(SERVER, intrinsics=SERVER.intrinsics.resized(24, 18))
    few = rasteriser().load(plates().take(np.arange(400)))
    cameras = [SERVER, small, aside(1), small]
    truths = [truth, truth, truth, few]
    right = [alone(*each) for each in zip(truths, held, cameras, strict=True)]
    submissions.clear()
    made = at_once(truths, held, cameras)
    assert len(submissions) == 3
    for ours, one in zip(made, right, strict=True):
        np.testing.assert_array_equal(ours.lack, one.lack)
        np.testing.assert_array_equal(ours.contribution, one.contribution)


def test_what_is_too_large_together_is_drawn_one_after_the_other(
    submissions: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, held = rasteriser().load(plates()), copies(3)
    monkeypatch.setattr(keeper().comparisons, "_most", {})
    right = [alone(truth, copy, SERVER) for copy in held]
    real = Workspace.reserve

    def narrow(self: Workspace, splats: int, **asked: object) -> None:
        if splats > len(truth):
            raise TooLargeError("no room for two")
        real(self, splats, **asked)  # type: ignore[arg-type]

    monkeypatch.setattr(Workspace, "reserve", narrow)
    workspace = keeper().current()
    assert workspace is not None
    submissions.clear()
    made = at_once([truth] * 3, held, [SERVER] * 3)
    assert len(submissions) == 3
    for ours, one in zip(made, right, strict=True):
        np.testing.assert_array_equal(ours.lack, one.lack)


def test_entries_that_are_too_many_together_are_not_drawn_together_again(
    submissions: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The buffers hold the splats of all, but not their entries, as the first drawing tells."""
    truth, held = rasteriser().load(plates()), copies(4)
    monkeypatch.setattr(keeper().comparisons, "_most", {})
    right = [alone(truth, copy, SERVER) for copy in held]
    real = Submission.read

    def crowded(self: Submission) -> object:
        if len(submissions) == 1:
            raise TooLargeError("no room for the entries of four")
        return real(self)

    monkeypatch.setattr(Submission, "read", crowded)
    submissions.clear()
    with ThreadPoolExecutor(4) as pool:
        with held_up(truth, 4):
            first = [pool.submit(asked_for, truth, copy, SERVER) for copy in held]
        assert [future.result(60) for future in first] == [None] * 4, "for the server to draw step by step"
    made = at_once([truth] * 4, held, [SERVER] * 4)
    assert len(submissions) == 1 + 2
    for ours, one in zip(made, right, strict=True):
        np.testing.assert_array_equal(ours.lack, one.lack)


def test_pictures_of_layers_that_are_looked_at_late_are_their_own() -> None:
    truth, held = rasteriser().load(plates()), copies(3)

    def one(copy: GpuScene) -> DeviceViews:
        made = truth.compared(copy, SERVER, OPTIONS, knee=0.1, looks=())
        assert made is not None
        return made

    with ThreadPoolExecutor(3) as pool:
        with held_up(truth, 3):
            futures = [pool.submit(one, copy) for copy in held]
        made = [future.result(60) for future in futures]
    later = at_once([truth] * 3, held[::-1], [aside(4)] * 3)
    for ours, copy in zip(made, held, strict=True):
        np.testing.assert_allclose(ours.lack, staged(truth, copy).lack, atol=STEP)
    assert len(later) == 3


def test_a_picture_that_is_kept_keeps_no_other(submissions: list[int]) -> None:
    truth, held = rasteriser().load(plates()), copies(3)
    made = at_once([truth] * 3, held, [SERVER] * 3)
    assert len(submissions) == 1
    for views in made:
        for picture in (views.lack, views.truth, views.depth, views.contribution):
            owner = picture
            while owner.base is not None:
                owner = owner.base
            assert owner.nbytes == picture.nbytes


def test_a_device_that_is_lost_fails_none_of_those_that_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cags_gpu.keeper.FIRST_DELAY_S", 60.0)
    other = Keeper(any_gpu)
    workspace = other.current()
    assert workspace is not None
    truth, held = scenes(other)
    with ThreadPoolExecutor(4) as pool:
        with workspace.gpu.lock:
            asked = [pool.submit(truth.compared, held, SERVER, OPTIONS, knee=0.1, looks=(Look.LACK,)) for _ in range(4)]
            while len(other.comparisons._waiting) < 4:
                time.sleep(0.001)
            workspace.gpu.destroy()
        assert [future.result(60) for future in asked] == [None] * 4
    assert not other.comparisons._waiting
    other.close()


@pytest.mark.parametrize(
    ("splats", "binding", "layers"),
    [(1, 1 << 27, 16), (1_000_000, 1 << 27, 4), (1 << 22, 1 << 27, 1), (9 << 20, 1 << 40, 1)],
)
def test_layers_are_as_many_as_a_devices_buffers_hold(splats: int, binding: int, layers: int) -> None:
    assert most_layers(splats, binding) == layers
