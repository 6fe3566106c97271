"""What lacking updates costs, by the number of frames."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.raster import create
from cags_common.splats import Splats
from cags_encoder.frames.outdated import LAGS, Outdated
from cags_encoder.tracks.rows import SplatTable
from cags_encoder.views import cameras_around
from support.codec_scenes import cloud, with_changes

COUNT = 400
EVERY = np.arange(COUNT, dtype=np.int32)


def outdated(frames: int = 100) -> Outdated:
    from cags_encoder.scenes import focus_of

    return Outdated(cameras_around(focus_of(scene()), (0.0, 1.0, 0.0), 2), create("auto"), frames)


def scene() -> Splats:
    return with_changes(cloud(COUNT, 7), sh0=np.zeros((COUNT, 3)), logit_opacities=np.full(COUNT, 2.0))


def brighter(splats: Splats, by: float) -> Splats:
    return with_changes(splats, sh0=splats.sh0 + np.float32(by))


def played(rows: np.ndarray, change: float = 0.02, frames: int = 20) -> tuple[tuple[int, float], ...]:
    """Every splat of ``rows`` becomes brighter in every frame; the updates of all frames from the first on lack."""
    looked, first = outdated(), scene()
    held = SplatTable(first)
    for frame in range(1, frames + 1):
        if looked.wants(frame):
            looked.lack(frame, rows, {"sh0": np.ones(len(rows), bool)}, held.take(rows))
        held.set("sh0", rows, brighter(first.take(rows), change * frame).sh0)
        looked.look(frame, held)
    return looked.psnr_db


def test_a_change_that_goes_on_costs_six_decibels_whenever_the_time_doubles() -> None:
    found = dict(played(EVERY))
    assert tuple(found) == LAGS
    for lag in LAGS[:-1]:
        assert found[lag] - found[2 * lag] == pytest.approx(6.0, abs=0.3)


def test_what_does_not_change_takes_no_part() -> None:
    """A ball that rolls through a room is as wrong as one that fills the picture."""
    every, few = dict(played(EVERY)), dict(played(EVERY[::4]))
    for lag in LAGS:
        assert few[lag] == pytest.approx(every[lag], abs=3.0)


def test_only_changed_attributes_are_old() -> None:
    looked, held = outdated(), SplatTable(scene())
    old = with_changes(scene(), log_scales=scene().log_scales + np.float32(2), sh0=scene().sh0 + np.float32(1))
    looked.lack(1, EVERY, {"sh0": np.zeros(COUNT, bool), "log_scales": np.zeros(COUNT, bool)}, old)
    looked.look(1, held)
    assert looked.psnr_db[0][1] > 80


def test_splats_that_have_gone_do_not_count() -> None:
    looked, held = outdated(), SplatTable(scene())
    looked.lack(1, EVERY, {"sh0": np.ones(COUNT, bool)}, brighter(scene(), 0.5))
    looked.look(1, held)
    held.alive[::2] = False
    looked.look(2, held)
    held.alive[:] = False
    looked.look(4, held)
    assert [lag for lag, _ in looked.psnr_db] == [1, 2]


def test_one_look_at_a_time_and_a_few_a_clip() -> None:
    looked, held = outdated(frames=90), SplatTable(scene())
    begun = []
    for frame in range(90):
        if frame == 50:
            looked.restart()  # a cut
        if looked.wants(frame):
            begun.append(frame)
            looked.lack(frame, EVERY, {"sh0": np.ones(COUNT, bool)}, scene())
        if frame % 10 == 0:
            looked.look(frame, held)
    assert begun == [0, 30, 60]
