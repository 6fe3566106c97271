"""Frames that are hard to correct: always finite, in [0, 1], and by the kernels what they are by the definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common.correction import Corrector, CorrectSettings, Reference, compand, create
from support.corrections import F, assert_sound, camera, difference, empty_view, flat_view, picture, share_apart, view
from support.hard_corrections import CLIENT, PLACES, TIES, USUAL_TIES, VIEWS, missing_square, server

needs_kernels = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())
BACKENDS = [pytest.param("cpu", marks=needs_kernels), "oracle"]


@pytest.fixture(params=BACKENDS)
def corrector(request: pytest.FixtureRequest) -> Corrector:
    return create(request.param)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", VIEWS)
def test_every_frame_is_sound_and_the_definitions(name: str, place: str) -> None:
    drawn, reference = VIEWS[name], difference(PLACES[place], contrast=0.6)
    right = create("oracle").correct(drawn, CLIENT, reference)
    assert_sound(right.rgb, right.confidence)
    if not cags_kernels.native_available():
        return
    ours = create("cpu").correct(drawn, CLIENT, reference)
    assert_sound(ours.rgb, ours.confidence)
    assert share_apart(ours.rgb, right.rgb) <= TIES.get(name, USUAL_TIES)


@pytest.mark.parametrize("place", ["the same", "a step of 1 m", "1 m and 60 degrees"])
def test_an_empty_client_shows_the_difference_itself_and_is_never_black(corrector: Corrector, place: str) -> None:
    scene = np.full((60, 80, 3), 0.7)
    reference = Reference(compand(scene, 0.1).astype(F), PLACES[place])
    out = corrector.correct(empty_view(CLIENT), CLIENT, reference, settings=CorrectSettings(border_px=0))
    inside = out.confidence > 0
    assert inside.mean() > 0.2
    np.testing.assert_allclose(out.rgb[inside], 0.7, atol=2e-4)
    if place != "1 m and 60 degrees":
        assert inside.all()


def test_what_is_missing_shows_at_the_depth_around_it(corrector: Corrector) -> None:
    """What the reference saw there lands at the wall's parallax."""
    missing, reference = missing_square()
    out = corrector.correct(missing, CLIENT, reference).rgb
    np.testing.assert_allclose(out[53:67, 73:87], 0.5, atol=0.01)
    assert np.abs(out - 0.5).mean() < 0.01


def test_the_largest_differences_go_all_the_way(corrector: Corrector) -> None:
    for lack, before, after in ((1.0, 0.0, 1.0), (-1.0, 1.0, 0.0), (1.0, 0.7, 1.0), (-1.0, 0.3, 0.0)):
        coded = np.full((60, 80, 3), compand(np.array([lack]), 0.05)[0], F)
        out = corrector.correct(flat_view(CLIENT, 3.0, before), CLIENT, Reference(coded, server(), knee=0.05))
        np.testing.assert_allclose(out.rgb[out.confidence == 1], after, atol=1e-4)
    noise = np.random.default_rng(0).integers(0, 2, (60, 80, 3)).astype(F)
    out = corrector.correct(view(CLIENT), CLIENT, Reference(noise, server(), knee=0.05))
    assert_sound(out.rgb, out.confidence)


def test_codes_that_are_no_numbers_do_no_harm_to_others(corrector: Corrector) -> None:
    clean = difference(server())
    coded = clean.coded.copy()
    coded[30, 40] = np.inf
    coded[10, 20] = -np.inf
    ours, right = (corrector.correct(view(CLIENT), CLIENT, r).rgb for r in (replace(clean, coded=coded), clean))
    assert np.isfinite(ours).all()
    assert (ours != right).any(axis=2).mean() < 0.01


SIZES = [(1, 1), (1, 7), (7, 1), (2, 2), (8, 8), (63, 5), (64, 9), (65, 17), (129, 31), (333, 251)]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("holes", [0.0, 0.4, 1.0])
def test_clients_of_any_size(size: tuple[int, int], holes: float) -> None:
    cam, reference = camera(size), difference(server())
    drawn = view(cam, holes=holes)
    veto = np.random.default_rng(0).random((-(-size[1] // 16), -(-size[0] // 16)), dtype=F)
    right = create("oracle").correct(drawn, cam, reference, veto=veto)
    assert_sound(right.rgb, right.confidence)
    if cags_kernels.native_available():
        ours = create("cpu", threads=3).correct(drawn, cam, reference, veto=veto)
        assert share_apart(ours.rgb, right.rgb) <= max(1e-3, 1.01 / (size[0] * size[1]))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 2), (31, 33), (97, 1), (400, 300), (1600, 1200)], ids=str)
def test_references_of_any_size(size: tuple[int, int]) -> None:
    drawn = view(CLIENT, holes=0.1)
    for reference in (difference(server(size)), picture(server(size))):
        own = np.full(reference.coded.shape, 0.3, F) if reference.picture else None
        right = create("oracle").correct(drawn, CLIENT, reference, own)
        assert_sound(right.rgb, right.confidence)
        if cags_kernels.native_available():
            ours = create("cpu").correct(drawn, CLIENT, reference, own)
            assert share_apart(ours.rgb, right.rgb) <= 1e-3


@needs_kernels
@pytest.mark.parametrize("fov_rad", [0.3, 1.0, 2.5])
def test_a_large_client_of_another_field_of_view(fov_rad: float) -> None:
    """Large enough for the frame to be written past the caches."""
    cam = camera((803, 601), fov_rad=fov_rad)
    drawn, reference = view(cam, holes=0.05), difference(server((200, 150), at=(0.2, 0.0, 0.0)))
    ours, right = (create(name).correct(drawn, cam, reference) for name in ("cpu", "oracle"))
    assert_sound(ours.rgb, ours.confidence)
    assert share_apart(ours.rgb, right.rgb) <= 1e-3


@needs_kernels
@pytest.mark.parametrize("name", VIEWS)
def test_bits_do_not_depend_on_threads(name: str) -> None:
    reference = difference(PLACES["a step of 1 m"])
    frames = [create("cpu", threads=n).correct(VIEWS[name], CLIENT, reference) for n in (1, 2, 3, 4)]
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.rgb, frames[0].rgb)
        np.testing.assert_array_equal(frame.confidence, frames[0].confidence)
