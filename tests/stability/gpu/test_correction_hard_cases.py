"""Frames that are hard to correct, by the shaders: finite, in [0, 1], and what they are by the definition."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cags_common.correction import Corrected, CorrectSettings, Reference, compand, create
from cags_common.raster import Exactness, RenderedView
from support.corrections import F, assert_sound, camera, difference, empty_view, flat_view, picture, share_apart, view
from support.device_corrector import DeviceCorrector
from support.gpu import needs_adapter
from support.hard_corrections import CLIENT, PLACES, TIES, USUAL_TIES, VIEWS, missing_square, server

pytestmark = needs_adapter


LEVELS = (Exactness.EXACT, Exactness.FAST)
"""Of one the client's own picture is kept in floats, of the other, as of ``balanced``, in 16 bits a channel."""


@cache
def shaders(exactness: Exactness = Exactness.EXACT) -> DeviceCorrector:
    return DeviceCorrector(exactness)


def displayed(drawn: RenderedView) -> RenderedView:
    return replace(drawn, rgb=np.clip(drawn.rgb, 0, 1))


@cache
def right(name: str, place: str, exactness: Exactness) -> Corrected:
    drawn = VIEWS[name] if exactness is Exactness.EXACT else displayed(VIEWS[name])
    return create("auto").correct(drawn, CLIENT, difference(PLACES[place], contrast=0.6))


@pytest.mark.parametrize("exactness", LEVELS)
@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("place", PLACES)
def test_every_frame_is_sound_and_the_cpus(name: str, place: str, exactness: Exactness) -> None:
    ours = shaders(exactness).correct(VIEWS[name], CLIENT, difference(PLACES[place], contrast=0.6))
    assert_sound(ours.rgb, ours.confidence)
    assert share_apart(ours.rgb, right(name, place, exactness).rgb) <= TIES.get(name, USUAL_TIES)


@pytest.mark.parametrize("place", ["the same", "a step of 1 m", "1 m and 60 degrees"])
def test_an_empty_client_shows_the_difference_itself(place: str) -> None:
    reference = Reference(compand(np.full((60, 80, 3), 0.7), 0.1).astype(F), PLACES[place])
    out = shaders().correct(empty_view(CLIENT), CLIENT, reference, settings=CorrectSettings(border_px=0))
    inside = out.confidence > 0
    assert inside.mean() > 0.2
    np.testing.assert_allclose(out.rgb[inside], 0.7, atol=2e-4)


@pytest.mark.parametrize("exactness", LEVELS)
def test_what_is_missing_shows_at_the_depth_around_it(exactness: Exactness) -> None:
    missing, reference = missing_square()
    out = shaders(exactness).correct(missing, CLIENT, reference).rgb
    np.testing.assert_allclose(out[53:67, 73:87], 0.5, atol=0.01)
    assert np.abs(out - 0.5).mean() < 0.01


def test_the_largest_differences_go_all_the_way() -> None:
    for lack, before, after in ((1.0, 0.0, 1.0), (-1.0, 1.0, 0.0), (1.0, 0.7, 1.0), (-1.0, 0.3, 0.0)):
        coded = np.full((60, 80, 3), compand(np.array([lack]), 0.05)[0], F)
        out = shaders().correct(flat_view(CLIENT, 3.0, before), CLIENT, Reference(coded, server(), knee=0.05))
        np.testing.assert_allclose(out.rgb[out.confidence == 1], after, atol=1e-4)


def test_codes_that_are_no_numbers_do_no_harm_to_others() -> None:
    clean = difference(server())
    coded = clean.coded.copy()
    coded[30, 40] = np.inf
    coded[10, 20] = -np.inf
    ours, same = (shaders().correct(view(CLIENT), CLIENT, r).rgb for r in (replace(clean, coded=coded), clean))
    assert np.isfinite(ours).all()
    assert (ours != same).any(axis=2).mean() < 0.01


@pytest.mark.parametrize(
    "size", [(1, 1), (1, 7), (7, 1), (2, 2), (8, 8), (63, 5), (65, 17), (129, 31), (333, 251)], ids=str
)
@pytest.mark.parametrize("holes", [0.0, 0.4, 1.0])
def test_clients_of_any_size(size: tuple[int, int], holes: float) -> None:
    cam, reference = camera(size), difference(server())
    drawn = view(cam, holes=holes)
    veto = np.random.default_rng(0).random((-(-size[1] // 16), -(-size[0] // 16)), dtype=F)
    ours, by_cpu = (each.correct(drawn, cam, reference, veto=veto) for each in (shaders(), create("auto")))
    assert share_apart(ours.rgb, by_cpu.rgb) <= max(1e-3, 1.01 / (size[0] * size[1]))


@pytest.mark.parametrize("fov_rad", [0.3, 2.5])
def test_a_large_client_of_another_field_of_view(fov_rad: float) -> None:
    cam = camera((803, 601), fov_rad=fov_rad)
    drawn, reference = view(cam, holes=0.05), difference(server((200, 150), at=(0.2, 0.0, 0.0)))
    ours, by_cpu = (each.correct(drawn, cam, reference) for each in (shaders(), create("auto")))
    assert_sound(ours.rgb, ours.confidence)
    assert share_apart(ours.rgb, by_cpu.rgb) <= 1e-3


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 2), (31, 33), (97, 1), (400, 300)], ids=str)
@pytest.mark.parametrize("error", [0.0, 1e-2])
def test_references_of_any_size(size: tuple[int, int], error: float) -> None:
    drawn = view(CLIENT, holes=0.1)
    for reference in (difference(server(size)), replace(picture(server(size)), error=error)):
        own = np.full(reference.coded.shape, 0.3, F) if reference.picture else None
        ours, by_cpu = (each.correct(drawn, CLIENT, reference, own) for each in (shaders(), create("auto")))
        assert_sound(ours.rgb, ours.confidence)
        assert share_apart(ours.rgb, by_cpu.rgb) <= 1e-3
