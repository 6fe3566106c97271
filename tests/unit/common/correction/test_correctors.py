"""Every corrector behind the seam: kernels give what the definition gives, and keep what they made of a reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common import correction
from cags_common.correction import Corrector, CorrectSettings, Reference, compand, create, veto_shape
from cags_common.correction.compander import ZERO
from cags_common.errors import ConfigError
from cags_common.geometry import Camera
from support.corrections import F, assert_sound, camera, difference, flat_view, picture, share_apart, view

needs_kernels = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())
BACKENDS = [pytest.param("cpu", marks=needs_kernels), "oracle"]

CLIENT = camera((208, 150))
SERVER = camera((52, 38), fov_rad=1.3, at=(0.3, 0.05, -0.1), turned_rad=0.05)


@pytest.fixture(params=["portable", "avx2", "avx512"])
def instruction_set(request: pytest.FixtureRequest) -> Iterator[str]:
    before = cags_kernels.instruction_set()
    try:
        cags_kernels.use_instruction_set(request.param)
    except cags_kernels.KernelError:
        pytest.skip(f"this processor does not run {request.param}")
    yield request.param
    cags_kernels.use_instruction_set(before)


@pytest.fixture(params=BACKENDS)
def corrector(request: pytest.FixtureRequest) -> Corrector:
    return create(request.param)


def own_of(reference: Reference) -> np.ndarray:
    return np.random.default_rng(9).random(reference.coded.shape, dtype=F) * F(1.2)


@needs_kernels
@pytest.mark.parametrize("holes", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("is_picture", [False, True], ids=["difference", "picture"])
@pytest.mark.parametrize("veto", ["none", "coarse", "fine"])
def test_the_kernels_give_what_the_definition_gives(
    instruction_set: str, holes: float, is_picture: bool, veto: str
) -> None:
    reference = picture(SERVER) if is_picture else difference(SERVER)
    own = own_of(reference) if is_picture else None
    shape = {"none": None, "coarse": veto_shape(CLIENT), "fine": (150, 208)}[veto]
    vetoed = None if shape is None else np.random.default_rng(2).random(shape, dtype=F)
    drawn = view(CLIENT, holes=holes)
    ours, right = (create(name).correct(drawn, CLIENT, reference, own, veto=vetoed) for name in ("cpu", "oracle"))
    assert_sound(ours.rgb, ours.confidence)
    assert (right.confidence > 0).mean() > 0.5
    if holes < 1:
        assert (right.confidence == 0).mean() > 0.005, "the case has pixels that nothing is added to"
    assert share_apart(ours.rgb, right.rgb) <= 1e-3
    apart = np.abs(ours.rgb.astype(np.float64) - right.rgb).max(axis=2)
    assert np.quantile(apart, 0.99) <= 1e-4
    assert (np.abs(ours.confidence - right.confidence) > 1e-4).mean() <= 1e-3


@needs_kernels
@pytest.mark.parametrize(
    "settings",
    [
        CorrectSettings(border_px=0.0),
        CorrectSettings(depth_tolerance=0.0),
        CorrectSettings(slope_cells=0.0),
        CorrectSettings(slope_cells=8.0, hole_alpha=1.0),
        CorrectSettings(hole_alpha=0.0),
        CorrectSettings(border_px=64.0),
    ],
)
def test_settings_mean_the_same_to_both(settings: CorrectSettings) -> None:
    drawn = view(CLIENT, holes=0.2)
    drawn = replace(drawn, alpha=np.random.default_rng(1).random(drawn.alpha.shape, dtype=F))
    ours, right = (
        create(name).correct(drawn, CLIENT, difference(SERVER), settings=settings) for name in ("cpu", "oracle")
    )
    assert share_apart(ours.rgb, right.rgb) <= 1e-3


@needs_kernels
def test_bits_do_not_depend_on_threads(instruction_set: str) -> None:
    drawn, reference = view(CLIENT, holes=0.2), difference(SERVER)
    right = create("cpu", threads=1).correct(drawn, CLIENT, reference)
    for threads in (2, 3, 4, 7):
        ours = create("cpu", threads=threads).correct(drawn, CLIENT, reference)
        np.testing.assert_array_equal(ours.rgb, right.rgb)
        np.testing.assert_array_equal(ours.confidence, right.confidence)


def test_nothing_lacking_changes_nothing(corrector: Corrector) -> None:
    drawn = view(CLIENT, holes=0.2)
    none = Reference(np.full((38, 52, 3), ZERO, F), SERVER)
    np.testing.assert_array_equal(corrector.correct(drawn, CLIENT, none).rgb, np.clip(drawn.rgb, 0, 1))


def test_an_identity_shows_the_picture(corrector: Corrector) -> None:
    shown = picture(CLIENT)
    drawn = view(CLIENT)
    out = corrector.correct(drawn, CLIENT, shown, drawn.rgb, CorrectSettings(border_px=0))
    np.testing.assert_allclose(out.rgb, shown.coded, atol=2e-4)
    assert (out.confidence == 1).all()


def test_a_reference_render_counts_until_the_next_and_a_new_picture_asks_for_one(corrector: Corrector) -> None:
    drawn, first, second = view(CLIENT), picture(SERVER, seed=1), picture(SERVER, seed=2)
    assert corrector.needs_own(first)
    with pytest.raises(ValueError, match="reference camera"):
        corrector.correct(drawn, CLIENT, first)
    dark, bright = (np.full(first.coded.shape, grey, F) for grey in (0.2, 0.6))
    shown = corrector.correct(drawn, CLIENT, first, dark)
    assert not corrector.needs_own(first)
    np.testing.assert_array_equal(corrector.correct(drawn, CLIENT, first).rgb, shown.rgb)
    other = corrector.correct(drawn, CLIENT, first, bright)
    np.testing.assert_array_equal(corrector.correct(drawn, CLIENT, first).rgb, other.rgb)
    assert np.abs(other.rgb - shown.rgb).max() > 0.1
    assert corrector.needs_own(second)
    assert not corrector.needs_own(difference(SERVER))
    with pytest.raises(ValueError, match="reference camera"):
        corrector.correct(drawn, CLIENT, second)


def test_references_in_turn_are_what_each_is_by_itself(corrector: Corrector) -> None:
    drawn, a, b = view(CLIENT), difference(SERVER, seed=1), difference(SERVER, seed=2, knee=0.05)
    for reference in (a, a, b, a, b, b):
        fresh = create(corrector.name).correct(drawn, CLIENT, reference)
        np.testing.assert_array_equal(corrector.correct(drawn, CLIENT, reference).rgb, fresh.rgb)


def test_a_veto_takes_confidence_away(corrector: Corrector) -> None:
    drawn, reference = flat_view(CLIENT, 3.0), difference(SERVER)
    free = corrector.correct(drawn, CLIENT, reference)
    nothing = corrector.correct(drawn, CLIENT, reference, veto=np.ones(veto_shape(CLIENT), F))
    np.testing.assert_array_equal(nothing.rgb, drawn.rgb)
    assert not nothing.confidence.any()
    half = corrector.correct(drawn, CLIENT, reference, veto=np.full((150, 208), 0.5, F))
    np.testing.assert_allclose(half.confidence, free.confidence / 2, atol=1e-6)
    cells = np.zeros(veto_shape(CLIENT), F)
    cells[3, 5] = 1
    once = corrector.correct(drawn, CLIENT, reference, veto=cells)
    assert once.confidence[3 * 16 + 8, 5 * 16 + 8] < 0.1 * free.confidence[3 * 16 + 8, 5 * 16 + 8]
    far = np.ones((150, 208), bool)
    far[2 * 16 : 5 * 16, 4 * 16 : 7 * 16] = False
    np.testing.assert_array_equal(once.rgb[far], free.rgb[far])


def test_what_does_not_fit_is_refused(corrector: Corrector) -> None:
    drawn, reference = view(CLIENT), difference(SERVER)
    with pytest.raises(ValueError, match="without depth"):
        corrector.correct(replace(drawn, depth=None), CLIENT, reference)
    with pytest.raises(ValueError, match="208x150 under a camera of 52x38"):
        corrector.correct(drawn, SERVER, reference)
    with pytest.raises(ValueError, match=r"veto of shape \(3, 3\)"):
        corrector.correct(drawn, CLIENT, reference, veto=np.zeros((3, 3), F))
    with pytest.raises(ValueError, match="render from the reference camera: shape"):
        corrector.correct(drawn, CLIENT, picture(SERVER), np.zeros((3, 3, 3), F))


def test_a_view_need_not_be_contiguous(corrector: Corrector) -> None:
    drawn, reference = view(CLIENT, holes=0.1), difference(SERVER)
    spread = replace(drawn, rgb=np.repeat(drawn.rgb, 2, axis=1)[:, ::2], depth=drawn.depth.astype(np.float64))
    np.testing.assert_array_equal(
        corrector.correct(spread, CLIENT, reference).rgb, corrector.correct(drawn, CLIENT, reference).rgb
    )


@needs_kernels
def test_frames_that_are_held_are_not_written_over() -> None:
    corrector, reference = create("cpu"), difference(SERVER)
    first = corrector.correct(view(CLIENT, seed=1), CLIENT, reference)
    kept = first.rgb.copy(), first.confidence.copy()
    for seed in range(20):
        corrector.correct(view(CLIENT, seed=seed), CLIENT, reference)
    np.testing.assert_array_equal(first.rgb, kept[0])
    np.testing.assert_array_equal(first.confidence, kept[1])


def test_backends_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="corrector 'magic' is unknown; known: auto, cpu, oracle"):
        create("magic")
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    monkeypatch.setattr(cags_kernels, "why_unavailable", lambda: "no library")
    with pytest.raises(ConfigError, match="corrector 'cpu' cannot run: no library"):
        create("cpu")
    correction._warn_once.cache_clear()
    assert create("auto").name == "oracle"


@needs_kernels
def test_auto_takes_the_kernels_and_threads_are_checked() -> None:
    assert create("auto").name == "cpu"
    with pytest.raises(ConfigError, match="threads = 0"):
        create("cpu", threads=0)


def test_what_the_client_adds_is_what_the_server_saw_lacking(corrector: Corrector) -> None:
    """A wall that is 0.3 too dark on its left half: seen from elsewhere it is whole again."""
    server: Camera = camera((200, 150), at=(0.2, 0.0, 0.0), fov_rad=1.4)
    drawn = flat_view(CLIENT, 3.0, 0.4)
    column = (np.arange(200) + 0.5 - server.intrinsics.cx_px) / server.intrinsics.fx_px * 3.0 + 0.2
    coded = np.broadcast_to(compand(np.where(column < 0, 0.3, 0.0), 0.1)[None, :, None], (150, 200, 3)).astype(F)
    out = corrector.correct(drawn, CLIENT, Reference(coded, server)).rgb
    middle = out.shape[1] // 2
    np.testing.assert_allclose(out[:, : middle - 3], 0.7, atol=2e-3)
    np.testing.assert_allclose(out[:, middle + 3 :], 0.4, atol=2e-3)
