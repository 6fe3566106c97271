"""Ids of a group's splats."""

import numpy as np

from cags_encoder.tracks.placing import ROOM, Placer
from support.codec_scenes import cloud


def test_ids_of_new_splats_lie_close_together_and_their_number_is_bounded() -> None:
    random, placer, count, new = np.random.default_rng(0), Placer(), 1000, 125
    identities, following = np.arange(count), count
    gaps = []
    for frame in range(24):
        delta, births, _ = placer.place(cloud(count, frame), identities)
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
