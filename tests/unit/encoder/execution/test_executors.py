"""Tasks run in order with few ahead, on any workers; a dead worker gives a one-line error."""

import os
import pickle
from collections.abc import Iterator
from operator import neg
from pathlib import Path

import pytest

from cags_common.errors import BundleError, SceneError
from cags_encoder import EncodeSettings, encode
from cags_encoder.execution.executors import AHEAD, INLINE, Shared, ahead, open_workers
from cags_encoder.scenes import open_scene
from support.bundle_bytes import assert_same_bundle


def test_one_worker_is_this_process_and_draws_nothing_ahead() -> None:
    drawn: list[int] = []

    def items() -> Iterator[int]:
        for k in range(4):
            drawn.append(k)
            yield k

    with open_workers(1) as workers:
        assert workers is INLINE
        for item, result in ahead(workers, neg, items(), lambda k: (k,)):
            assert result == -item
            assert drawn == list(range(item + 1))


def test_a_pool_keeps_order_bounds_what_is_in_flight_and_passes_errors_on() -> None:
    drawn: list[int] = []

    def items() -> Iterator[int]:
        for k in range(20):
            drawn.append(k)
            yield k

    with open_workers(2) as workers:
        for done, (item, result) in enumerate(ahead(workers, neg, items(), lambda k: (k,))):
            assert (item, result) == (done, -done)
            assert len(drawn) <= done + AHEAD * 2
        with pytest.raises(SceneError, match=r"^/nowhere\.ply: no such file"):
            list(ahead(workers, open_scene, ["/nowhere.ply"], lambda spec: (spec,)))
        with pytest.raises(BundleError, match=r"a worker process died.*to continue"):
            list(ahead(workers, os._exit, [3], lambda k: (k,)))


def test_a_shared_value_is_one_object_a_worker() -> None:
    shared = Shared([1, 2])
    first, second = (pickle.loads(pickle.dumps(shared)) for _ in range(2))
    assert first.get() is second.get()
    assert first.get() == shared.get() == [1, 2]


ROOM = "procedural:size=1500,frames=6,degree=1"
LINKED = "fourd:splats=1500,births=200,frames=6,degree=1,shuffle=1,quantise=sog"


@pytest.mark.parametrize(("codec", "spec"), [("svq", ROOM), ("density", ROOM), ("svq", LINKED)])
def test_a_pool_changes_no_byte(codec: str, spec: str, tmp_path: Path) -> None:
    scene = open_scene(spec)
    settings = EncodeSettings(codec=codec, train_splats=1500, gof_frames=4, lod_order="paper")
    encode(scene, settings, str(tmp_path / "one"))
    with open_workers(2) as workers:
        encode(scene, settings, str(tmp_path / "two"), workers=workers)
    assert_same_bundle(tmp_path / "one", tmp_path / "two")
