"""Pass plans: on whenever needed, left out else, and their account."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.passes import ALWAYS, Pass, Situation, held_sh_degree, plan_frame, tally
from cags_common.splats import SH_REST_OF_DEGREE

PAINTING = frozenset({Pass.ALIGNMENT, Pass.EROSION})
CORRECTING = frozenset({Pass.CORRECTION, Pass.REFERENCE_RENDER, Pass.VETO})
RESTORING = frozenset({Pass.RESTORATION, Pass.ALIGNMENT, Pass.OCCLUSION, Pass.EROSION})
BUSY = Situation(
    sh_degree=2,
    scene_sh_degree=3,
    whole=False,
    reference=True,
    picture=True,
    same_place=False,
    certain=False,
    corrects=True,
    stale=True,
    restorer=PAINTING,
    replaces=False,
    depth_shown=True,
)
RESTORED = replace(BUSY, corrects=False)
situations = st.builds(
    Situation,
    sh_degree=st.integers(0, 3),
    scene_sh_degree=st.just(3),
    whole=st.booleans(),
    reference=st.booleans(),
    picture=st.booleans(),
    same_place=st.booleans(),
    certain=st.booleans(),
    corrects=st.booleans(),
    stale=st.booleans(),
    restorer=st.sampled_from([frozenset(), PAINTING]),
    replaces=st.booleans(),
    depth_shown=st.booleans(),
)


def test_a_busy_moment_needs_everything_of_its_way() -> None:
    plan = plan_frame(BUSY)
    assert plan.on == frozenset(Pass) - RESTORING
    assert plan.sh_degree == 2
    assert plan_frame(RESTORED).on == frozenset(Pass) - CORRECTING


@pytest.mark.parametrize(
    ("change", "gone"),
    [
        ({"sh_degree": 0}, {Pass.VIEW_COLOUR}),
        ({"certain": True}, {Pass.FADE}),
        ({"picture": False}, {Pass.REFERENCE_RENDER}),
        ({"stale": False}, {Pass.VETO}),
        ({"same_place": True}, set()),  # what hides something is looked for within the correction
        ({"whole": True}, set()),  # the server says so, if there is nothing lacking
        ({"depth_shown": False}, set()),  # the correction needs it
        ({"reference": False}, {*CORRECTING, Pass.FADE}),
        ({"reference": False, "depth_shown": False}, {*CORRECTING, Pass.FADE, Pass.DEPTH}),
    ],
)
def test_each_condition_takes_its_own_effects_of_a_correction_away(change: dict[str, object], gone: set[Pass]) -> None:
    assert plan_frame(BUSY).on - plan_frame(replace(BUSY, **change)).on == gone  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "gone"),
    [
        ({"same_place": True}, {Pass.OCCLUSION, Pass.EROSION}),
        ({"certain": True}, {Pass.FADE}),
        ({"stale": False}, set()),
        ({"restorer": frozenset({Pass.ALIGNMENT})}, {Pass.EROSION}),
        ({"depth_shown": False}, set()),  # alignment needs it
        ({"picture": False, "depth_shown": False}, {*RESTORING, Pass.FADE, Pass.DEPTH}),
        ({"restorer": frozenset(), "depth_shown": False}, {*RESTORING, Pass.FADE, Pass.DEPTH}),
        ({"whole": True, "depth_shown": False}, {*RESTORING, Pass.FADE, Pass.DEPTH}),
        ({"whole": True, "replaces": True}, set()),
    ],
)
def test_each_condition_takes_its_own_effects_of_a_restorer_away(change: dict[str, object], gone: set[Pass]) -> None:
    assert plan_frame(RESTORED).on - plan_frame(replace(RESTORED, **change)).on == gone  # type: ignore[arg-type]


@given(situations)
def test_what_is_needed_is_a_part_of_always(situation: Situation) -> None:
    needed, always = plan_frame(situation), plan_frame(situation, ALWAYS)
    assert needed.on <= always.on
    assert needed.sh_degree <= always.sh_degree


@given(situations)
def test_plans_are_consistent(situation: Situation) -> None:
    plan = plan_frame(situation)
    assert (Pass.VIEW_COLOUR in plan) == (plan.sh_degree > 0)
    assert Pass.DEPTH in plan or not plan.on & {Pass.ALIGNMENT, Pass.CORRECTION}
    assert Pass.CORRECTION in plan or not plan.on & {Pass.REFERENCE_RENDER, Pass.VETO}
    assert Pass.ALIGNMENT in plan or not plan.on & {Pass.OCCLUSION, Pass.EROSION}
    assert plan.on & {Pass.RESTORATION, Pass.CORRECTION} or Pass.FADE not in plan
    assert not plan.on >= {Pass.RESTORATION, Pass.CORRECTION}
    assert situation.reference or not plan.on & {Pass.RESTORATION, Pass.CORRECTION}


@pytest.mark.parametrize("degree", range(4))
def test_the_highest_band_with_anything_in_it_counts(degree: int) -> None:
    rest = np.zeros((5, SH_REST_OF_DEGREE[3], 3), np.float32)
    if degree:
        rest[3, SH_REST_OF_DEGREE[degree] - 1, 1] = 1e-30
    assert held_sh_degree(rest) == degree
    assert held_sh_degree(rest[:, : SH_REST_OF_DEGREE[degree]]) == degree
    assert held_sh_degree(rest[:0]) == 0


def test_the_account_counts_shares_and_what_leaving_out_saved() -> None:
    on, off = frozenset({Pass.ALIGNMENT, Pass.DEPTH}), frozenset[Pass]()
    account = tally([(on, {"raster": 10, "align": 4}), (off, {"raster": 9}), (off, {"raster": 9})])
    assert account["alignment"] == {"share": pytest.approx(1 / 3), "saved_ms": 8}
    assert account["depth"]["saved_ms"] == pytest.approx(2)
    assert account["reference-render"] == {"share": 0, "saved_ms": None}
    assert tally([(on, {})])["alignment"] == {"share": 1, "saved_ms": None}
    assert tally([]) == {}
