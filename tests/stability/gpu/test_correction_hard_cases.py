"""Frames that are hard to correct, by the shaders: finite, in [0, 1], and what they are by the definition."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cags_common.correction import Corrected, CorrectSettings, Reference, compand, create
from support.corrections import F, assert_sound, camera, difference, empty_view, flat_view, picture, share_apart, view
from support.device_corrector import DeviceCorrector
from support.gpu import needs_adapter
from support.hard_corrections import CLIENT, PLACES, TIES, USUAL_TIES, VIEWS, server

pytestmark = needs_adapter


@cache
def shaders() -> DeviceCorrector:
    return DeviceCorrector()


@cache
def right(name: str, place: str) -> Corrected:
    return create("auto").correct(VIEWS[name], CLIENT, difference(PLACES[place], contrast=0.6))


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("place", PLACES)
def test_every_frame_is_sound_and_the_cpus(name: str, place: str) -> None:
    ours = shaders().correct(VIEWS[name], CLIENT, difference(PLACES[place], contrast=0.6))
    assert_sound(ours.rgb, ours.confidence)
    assert share_apart(ours.rgb, right(name, place).rgb) <= TIES.get(name, USUAL_TIES)


@pytest.mark.parametrize("place", ["the same", "a step of 1 m", "1 m and 60 degrees"])
def test_an_empty_client_shows_the_difference_itself(place: str) -> None:
    reference = Reference(compand(np.full((60, 80, 3), 0.7), 0.1).astype(F), PLACES[place])
    out = shaders().correct(empty_view(CLIENT), CLIENT, reference, settings=CorrectSettings(border_px=0))
    inside = out.confidence > 0
    assert inside.mean() > 0.2
    np.testing.assert_allclose(out.rgb[inside], 0.7, atol=2e-4)


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


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 2), (31, 33), (97, 1), (400, 300)], ids=str)
@pytest.mark.parametrize("error", [0.0, 1e-2])
def test_references_of_any_size(size: tuple[int, int], error: float) -> None:
    drawn = view(CLIENT, holes=0.1)
    for reference in (difference(server(size)), replace(picture(server(size)), error=error)):
        own = np.full(reference.coded.shape, 0.3, F) if reference.picture else None
        ours, by_cpu = (each.correct(drawn, CLIENT, reference, own) for each in (shaders(), create("auto")))
        assert_sound(ours.rgb, ours.confidence)
        assert share_apart(ours.rgb, by_cpu.rgb) <= 1e-3
