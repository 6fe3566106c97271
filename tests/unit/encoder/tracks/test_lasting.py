"""Lasting looks: fewer values express the same changes within the same tolerance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cags_common.bundle import SourceDelta
from cags_common.splats import SH_C0, Splats
from cags_encoder.tracks.lasting import (
    ALONE,
    EFFECTS,
    FASTER,
    RAMPS,
    USUAL_DB,
    WORTH,
    Allowed,
    Coming,
    Held,
    bounds,
    ease_of,
    lasting,
    segment,
)
from cags_encoder.tracks.placing import Bound, Placed, Told

N, MOST = 6, 0.01
OPAQUE = 30.0
HUES = np.arange(N)[:, None] * np.array([0.0, 0.0, 0.1])
SIZES = np.arange(N)[:, None] * np.ones(3)
"""What tells the splats apart: changes of splats that are the same in everything are cheap."""


def splats(sh0: np.ndarray, **columns: np.ndarray) -> Splats:
    n = len(sh0)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    given = {
        "means": np.zeros((n, 3)),
        "quats": quats,
        "log_scales": np.zeros((n, 3)),
        "logit_opacities": np.full(n, OPAQUE),
        "sh0": sh0,
        "sh_rest": np.zeros((n, 3, 3)),
        **columns,
    }
    return Splats(**{name: np.ascontiguousarray(value, np.float32) for name, value in given.items()})


def frames(of: Sequence[Splats], removed: Sequence[Sequence[int]] | None = None) -> list[Placed]:
    ids, no = np.arange(N, dtype=np.int32), np.zeros(N, bool)
    gone = removed or [()] * len(of)
    return [
        Placed(at, False, SourceDelta(ids, each, np.array(went, np.int32)), N, no, ~no)
        for at, (each, went) in enumerate(zip(of, gone, strict=True), start=1)
    ]


def told_of(now: Splats, ids: np.ndarray, later: Sequence[Placed], most: float, ease: float = 1.0) -> Told:
    """What lasts, and how far off it may be."""
    allowed = Allowed(most, ease)
    return Told(lasting(now, ids, later, allowed), bounds(now, ids, later, allowed, {}))


def grey(effect: float | np.ndarray) -> np.ndarray:
    """Colours [N, 3] with a visible effect of ``effect`` relative to :data:`HUES`."""
    return HUES + np.broadcast_to(np.asarray(effect, float).reshape(-1, 1) / SH_C0, (N, 3))


def test_what_drifts_is_told_as_the_middle_of_what_it_will_be() -> None:
    steps = [0.002 * at for at in range(20)]
    told = told_of(splats(grey(0)), np.arange(N), frames([splats(grey(step)) for step in steps[1:]]), MOST)
    tolerance = told.bounds["sh0"].wrong
    assert np.all(tolerance > MOST)
    lasts = sum(step <= 2 * tolerance[0] + 1e-9 for step in steps)
    assert np.allclose(told.splats.sh0, grey(np.mean(steps[:lasts])), atol=1e-6)
    assert SH_C0 * np.abs(told.splats.sh0 - HUES).max() <= tolerance[0] + 1e-6


def test_what_changes_fast_is_told_more_exactly_the_better_the_looks_are() -> None:
    fast = frames([splats(grey(0.05 * at)) for at in range(1, 20)])
    wrong = [
        told_of(splats(grey(0)), np.arange(N), fast, MOST, ease_of(psnr_db)).bounds["sh0"].wrong[0]
        for psnr_db in (40, USUAL_DB, 56, 80, 90)
    ]
    assert wrong[0] == pytest.approx(FASTER * MOST)
    assert wrong[0] > wrong[1] > wrong[2] > wrong[3] == wrong[4] == MOST
    unmeasured = told_of(splats(grey(0)), np.arange(N), fast, MOST, ease_of(None)).bounds["sh0"].wrong[0]
    assert unmeasured == wrong[1]


def test_sizes_that_change_alone_may_be_further_off_than_those_that_change_together() -> None:
    random = np.random.default_rng(3)
    alone = random.normal(size=(N, 3))
    wrong = {}
    for name, step in {"together": np.ones((N, 3)), "alone": alone, "one": np.eye(N)[:, :1] * np.ones(3)}.items():
        later = frames([splats(grey(0), log_scales=SIZES + MOST * step)])
        told = told_of(splats(grey(0), log_scales=SIZES), np.arange(N), later, MOST)
        wrong[name] = told.bounds["log_scales"].wrong
        assert np.all(told.bounds["sh0"].wrong == MOST), "colours count as before"
    assert np.allclose(wrong["together"], MOST)
    assert np.all((wrong["alone"] > MOST) & (wrong["alone"] <= MOST / ALONE * FASTER))
    assert wrong["one"][0] == pytest.approx(MOST / ALONE)
    assert np.allclose(wrong["one"][1:], MOST), "what does not change keeps its tolerance"


def test_noise_is_told_as_its_mean() -> None:
    noise = np.random.default_rng(1).uniform(-MOST, MOST, (16, N)) / 2
    told = told_of(splats(grey(noise[0])), np.arange(N), frames([splats(grey(row)) for row in noise[1:]]), MOST)
    assert np.allclose(told.splats.sh0, grey(noise.mean(axis=0)), atol=1e-6)


def test_noise_beyond_the_tolerance_is_told_once_and_a_trend_is_followed() -> None:
    noise = 1.5 * MOST * np.random.default_rng(2).choice([-1.0, 1.0], (16, N))
    told = told_of(splats(grey(noise[0])), np.arange(N), frames([splats(grey(row)) for row in noise[1:]]), MOST)
    assert np.allclose(told.bounds["sh0"].wrong, FASTER * MOST)
    assert np.allclose(told.splats.sh0, grey(noise.mean(axis=0)), atol=1e-6)
    alive = 1.5 * MOST * np.random.default_rng(3).uniform(-1, 1, (16, N))
    told = told_of(splats(grey(alive[0])), np.arange(N), frames([splats(grey(row)) for row in alive[1:]]), MOST)
    assert np.all(told.bounds["sh0"].wrong < 3 * MOST), "no value comes twice: a source that shakes is followed"
    trend = 0.6 * MOST * np.arange(16)[:, None] * np.ones(N)
    told = told_of(splats(grey(trend[0])), np.arange(N), frames([splats(grey(row)) for row in trend[1:]]), MOST)
    assert np.all(told.bounds["sh0"].wrong < 2 * MOST)


def test_what_stays_keeps_its_bits_and_a_jump_ends_what_lasts() -> None:
    stays = np.arange(N) < 3
    after = splats(np.where(stays[:, None], grey(0.3), grey(0.9)))
    told = told_of(splats(grey(0.3)), np.arange(N), frames([after] * 4), MOST)
    assert np.array_equal(told.splats.sh0, np.float32(grey(0.3)))
    assert np.all(told.bounds["sh0"].wrong[stays] == MOST) and np.all(told.bounds["sh0"].wrong[~stays] > MOST)


def test_tolerances_grow_with_the_cube_root_of_the_speed_up_to_a_bound() -> None:
    speed = MOST * np.array([0.5, 2, 16, 54, 128, 1e5])
    told = told_of(splats(grey(0)), np.arange(N), frames([splats(grey(speed))]), MOST)
    wanted = np.clip(np.cbrt(speed / MOST / 2), 1, FASTER)
    assert np.allclose(told.bounds["sh0"].wrong, MOST * wanted)


@pytest.mark.parametrize("column", ["log_scales", "sh_rest"])
def test_scales_and_harmonics_last_as_colours_do(column: str) -> None:
    shape = {"log_scales": (N, 3), "sh_rest": (N, 3, 3)}[column]
    values = [np.full(shape, 0.001 * at) for at in range(3)]
    made = [splats(grey(0), **{column: value}) for value in values]
    told = told_of(made[0], np.arange(N), frames(made[1:]), MOST)
    assert np.allclose(dict(told.splats.arrays())[column], 0.001, atol=1e-7)


def test_what_ends_does_not_last_longer_and_its_id_is_another_splats_then() -> None:
    made = [splats(grey(step)) for step in (0.0, 0.002, 0.004)]
    told = told_of(made[0], np.arange(N), frames(made[1:], removed=[(), (0,)]), MOST)
    assert np.allclose(told.splats.sh0[0], grey(0.001)[0], atol=1e-6)
    assert np.allclose(told.splats.sh0[1], grey(0.002)[1], atol=1e-6)


def test_few_splats_change_or_none_do() -> None:
    nothing = splats(np.zeros((0, 3)))
    later = [
        Placed(
            1, False, SourceDelta(np.zeros(0, np.int32), nothing, np.zeros(0, np.int32)), N, *[np.zeros(0, bool)] * 2
        )
    ]
    told = told_of(splats(grey(0.5)), np.arange(N), later, MOST)
    assert np.array_equal(told.splats.sh0, np.float32(grey(0.5)))
    assert len(told_of(nothing, np.zeros(0, np.int32), frames([splats(grey(0.1))]), MOST).splats) == 0


def test_a_scene_without_harmonics_has_none_to_tell() -> None:
    bare = [splats(grey(0.1 * at), sh_rest=np.zeros((N, 0, 3))) for at in range(4)]
    told = told_of(bare[0], np.arange(N), frames(bare[1:]), MOST)
    assert told.splats.sh_rest.shape == (N, 0, 3)


def test_without_a_tolerance_the_present_values_are_told() -> None:
    drift = [splats(grey(0.002 * at)) for at in range(4)]
    told = told_of(drift[0], np.arange(N), frames(drift[1:]), 0.0)
    assert np.array_equal(told.splats.sh0, drift[0].sh0)
    assert all(not bound.wrong.any() for bound in told.bounds.values())


def segments(
    held: float | np.ndarray, values: Sequence[float | np.ndarray], limit: float = MOST, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Effects [N] of the values to send, in how many frames they are reached and whether that pays, for the ``values``
    of each frame.
    """
    course = [splats(grey(value)) for value in values]
    coming = Coming(course[0], np.arange(N), frames(course[1:]))
    before = Held(np.float32(grey(held)), np.full(N, noise))
    seen = (EFFECTS["sh0"], np.ones((N, 1)))
    bound = Bound(np.full(N, limit), np.full(N, WORTH * limit**2))
    sent, lengths, pays = segment(before, course[0].sh0, coming.frames("sh0", np.arange(N)), seen, bound)
    return SH_C0 * sent[:, 0], lengths, pays


def test_what_is_the_same_for_all_is_told_more_exactly() -> None:
    step = 20 * MOST / SH_C0
    apart = told_of(splats(grey(0)), np.arange(N), frames([splats(grey(0) + step)]), MOST).bounds["sh0"].wrong
    alike = (
        told_of(splats(grey(0) - HUES), np.arange(N), frames([splats(grey(0) - HUES + step)]), MOST).bounds["sh0"].wrong
    )
    assert np.allclose(alike, apart * np.cbrt(1 / (1 + np.log2(N))))


def test_a_drift_is_sent_once_as_a_ramp() -> None:
    sent, lengths, _ = segments(0.0, [0.02 * (at + 1) for at in range(16)])
    assert np.all(lengths == 16)
    assert np.allclose(sent, 0.32, atol=1e-6)


def test_a_jump_is_shown_at_once() -> None:
    sent, lengths, _ = segments(0.0, [0.5] * 16)
    assert np.all(lengths == 1)
    assert np.allclose(sent, 0.5, atol=1e-6)


def test_a_short_jump_is_not_followed_and_a_long_or_large_one_is() -> None:
    for step, frames_long, follows in [(2, 1, False), (2.5, 4, True), (5, 1, True), (3, 1, False), (3, 2, True)]:
        course = [step * MOST] * frames_long + [0.0] * (16 - frames_long)
        assert np.all(segments(0.0, course)[2] == follows), (step, frames_long)


def test_what_does_not_come_back_is_followed_to_the_end_of_its_group() -> None:
    """Errors that all splats have in common showed in the frames before the next group."""
    assert segments(0.0, [1.5 * MOST] * 3)[2].all()
    assert not segments(0.0, [1.5 * MOST] * 3 + [0.0])[2].any()


def test_a_drift_pays() -> None:
    assert segments(0.0, [1.1 * MOST + 0.2 * MOST * at for at in range(16)])[2].all()


def test_the_thickness_of_a_flat_splat_may_be_further_off_than_its_width() -> None:
    flat, change = np.log([0.1, 0.1, 0.001]) + np.arange(N)[:, None], 4 * MOST
    wrong = []
    for axis in (0, 2):
        later = flat.copy()
        later[:, axis] += change
        told = told_of(
            splats(grey(0), log_scales=flat), np.arange(N), frames([splats(grey(0), log_scales=later)]), MOST
        )
        wrong.append(np.abs(told.splats.log_scales - flat)[:, axis].max())
    assert wrong[0] == pytest.approx(0, abs=1e-6), "beyond the tolerance: the present value"
    assert wrong[1] == pytest.approx(change / 2, rel=1e-3), "within it: the mean"


def test_a_ramp_ends_where_the_drift_does() -> None:
    _, lengths, _ = segments(0.0, [min(0.02 * (at + 1), 0.12) for at in range(16)])
    assert np.all(lengths == 6)


def test_a_ramp_may_keep_the_error_that_quantisation_left() -> None:
    course = [0.013 + 0.01 * at for at in range(16)]
    assert np.all(segments(0.0, course, limit=0.002)[1] < 16), "the first frames would be farther off than is allowed"
    assert np.all(segments(0.0, course, limit=0.002, noise=0.01)[1] == 16)


@given(
    hnp.arrays(np.float64, (12, N), elements=st.floats(-1, 1)),
    hnp.arrays(np.float64, N, elements=st.floats(-1, 1)),
    st.floats(1e-3, 0.5),
)
def test_whatever_is_sent_is_within_its_tolerance_for_as_long_as_it_is_said_to_be(
    course: np.ndarray, held: np.ndarray, limit: float
) -> None:
    sent, lengths, _ = segments(held, list(course), limit)
    assert set(lengths.tolist()) <= {1, *RAMPS}
    for row, length in enumerate(lengths.tolist()):
        for step in range(1, length + 1):
            shown = held[row] + (sent[row] - held[row]) * step / length
            assert abs(shown - course[step - 1, row]) <= limit + 1e-5


def test_the_next_value_of_a_source_s_codebook_will_do() -> None:
    """And one that lies further away is a change, however the source rounds. No tolerance is none."""
    book = (0.05 * np.arange(-100, 100)).astype(np.float32)
    now, ids = splats(0.05 * np.round(HUES / 0.05)), np.arange(N, dtype=np.int32)
    later = frames([splats(now.sh0 + np.float32(0.05))])
    exact = bounds(now, ids, later, Allowed(MOST / 10), {})["sh0"].wrong
    rounded = bounds(now, ids, later, Allowed(MOST / 10), {"sh0": book})["sh0"].wrong
    assert (exact < rounded).all()
    assert rounded == pytest.approx(0.05 * SH_C0, rel=1e-3)
    assert bounds(now, ids, later, Allowed(0.0), {"sh0": book})["sh0"].wrong == pytest.approx(0.0)
    assert bounds(now, ids, later, Allowed(MOST / 10), {"log_scales": book})["sh0"].wrong == pytest.approx(exact)
