"""Ids of a group's splats."""

import numpy as np

from cags_encoder.tracks.placing import FARTHEST, ROOM, SPECK, Placer
from support.codec_scenes import cloud, with_changes


def test_ids_of_new_splats_lie_close_together_and_their_number_is_bounded() -> None:
    random, placer, count, new = np.random.default_rng(0), Placer(), 1000, 125
    identities, following = np.arange(count), count
    gaps = []
    for frame in range(24):
        delta, births, *_ = placer.place(cloud(count, frame), identities)
        fresh = delta.ids[births]
        assert not np.isin(fresh, delta.removed).any()
        if frame > 12:
            gaps.append((np.ptp(fresh) + 1) / len(fresh))
        stays = random.permutation(identities)[new:]
        identities = np.concatenate([stays, np.arange(following, following + new)])
        following += new
    assert placer.capacity <= ROOM * count
    at_random = 1 / (1 - 1 / ROOM)
    assert np.mean(gaps) < 2.5 / 3 * at_random


def test_who_gets_too_far_from_where_they_began_begins_anew() -> None:
    first, traveller, speck = cloud(100, 1), 7, 8
    scales = first.log_scales.copy()
    scales[speck] = -30.0  # smaller than most, so it may go as far as they
    first = with_changes(first, log_scales=scales)
    size = np.exp(np.sort(first.log_scales, axis=1)[:, 1])
    least = float(np.percentile(size, SPECK))
    placer, born = Placer(), []
    identity_of = np.zeros(0, np.int64)
    for frame in range(6):
        means = first.means.astype(np.float64)
        means[traveller, 0] += 0.4 * FARTHEST * max(size[traveller], least) * frame
        means[speck, 0] += 0.19 * FARTHEST * least * frame
        delta, births, *_ = placer.place(with_changes(first, means=means), np.arange(100))
        if frame == 0:
            identity_of = np.argsort(np.abs(delta.splats.means[:, None] - first.means[None]).sum(axis=2), axis=1)[:, 0]
            continue
        born.append(int(births.sum()))
        assert len(delta.removed) == births.sum()
        if births.any() and len(born) == 3:
            assert identity_of[delta.removed[0]] == traveller
    assert born == [0, 0, 1, 0, 0]


def test_a_frame_that_is_the_last_one_changes_nothing() -> None:
    placer, splats, identities = Placer(), cloud(50), np.arange(50)
    placer.place(splats, identities)
    for _ in range(2):
        delta, births, looks, _ = placer.place(splats, identities)
        assert not len(delta.ids) and not len(delta.removed) and not len(births) and not len(looks)
    delta, *_ = placer.place(with_changes(splats, means=splats.means + np.float32(1)), identities)
    assert len(delta.ids) == 50


def test_splats_that_keep_their_scales_and_colours_are_told() -> None:
    placer, splats, identities = Placer(), cloud(50), np.arange(50)
    *_, kept = placer.place(splats, identities)
    assert not kept.any()
    order = placer._identities  # splat i has id order.argsort()[i]
    means, scales, logits = splats.means.copy(), splats.log_scales.copy(), splats.logit_opacities.copy()
    means[:6] += 1
    scales[4:9] += 1
    logits[20:24] += 1
    changed = with_changes(splats, means=means, log_scales=scales, logit_opacities=logits)
    delta, births, _, kept = placer.place(changed, identities)
    assert not births.any()
    assert sorted(order[delta.ids]) == [*range(9), *range(20, 24)]
    assert sorted(order[delta.ids[kept]]) == [0, 1, 2, 3, *range(20, 24)]
