"""``cags-encode`` as a process, on a sequence of every kind, then verified, all frames against the files."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader
from cags_encoder.scenes import open_scene
from support.frame_sequences import KINDS
from support.processes import run_module

GROUPS = {"cut": 2}


@pytest.mark.parametrize("kind", KINDS)
def test_a_sequence_of_every_kind_is_encoded_whole(kind: str, tmp_path: Path) -> None:
    make: Callable[[Path], Path] = KINDS[kind]
    scene, out = make(tmp_path / "frames"), tmp_path / "out.cags"
    done = run_module(
        "cags_encoder",
        str(scene),
        str(out),
        "--train-splats",
        "2000",
        "--lod-order",
        "paper",
        "--workers",
        "1",
        "--json",
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    source = open_scene(str(scene))
    assert (summary["frames"], summary["groups"]) == (len(source), GROUPS.get(kind, 1))
    with BundleReader.open(str(out)) as reader:
        player = BundlePlayer(reader)
        for index in range(len(source)):
            shown, held, given = player.frame(index), reader.source(index), source.frame(index)
            assert np.array_equal(shown.ids, held.ids)
            assert sorted(map(bytes, held.splats.means)) == sorted(map(bytes, given.means))
            shift = np.abs(shown.splats.means - held.splats.means).max(axis=1)
            assert np.median(shift) < 0.002 and shift.max() < 0.1, "shifts that do not show stay unsent"
            assert np.abs(shown.splats.sh0 - held.splats.sh0).max() < 0.5
    keys = [frame for frame in range(len(source)) if frame in reader.manifest.gof_starts]
    sent = [sum(tile.splats for tile in reader.frame(index).tiles) for index in range(len(source))]
    later = [sent[index] for index in range(len(source)) if index not in keys]
    assert max(later) < 0.6 * sent[0], "later frames send what changed"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames", "out.cags"]


def test_joining_at_a_group_gives_what_playing_from_the_start_gives(tmp_path: Path) -> None:
    scene, out = KINDS["per-frame PLY"](tmp_path / "frames"), tmp_path / "out.cags"
    done = run_module(
        "cags_encoder", str(scene), str(out), "--gof-frames", "2", "--train-splats", "2000", "--lod-order", "paper",
        "--workers", "1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with BundleReader.open(str(out)) as reader:
        assert reader.manifest.gof_starts == (0, 2, 4)
        through = BundlePlayer(reader)
        for index in range(5):
            played, joined = through.frame(index), BundlePlayer(reader).frame(index)
            assert np.array_equal(played.splats.means, joined.splats.means)
        assert np.array_equal(BundlePlayer(reader).frame(1).splats.means, through.frame(1).splats.means), "seeking back"
