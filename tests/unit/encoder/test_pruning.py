"""Pruning removes splats that contribute little, measures the loss, and keeps identities."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundleReader, Manifest
from cags_common.errors import BundleError, ConfigError
from cags_common.raster import create
from cags_common.splats import Splats
from cags_common.tiles.kinds import TileKind
from cags_encoder import EncodeSettings, encode
from cags_encoder.formats import write_splats
from cags_encoder.pipeline import SplatSequence
from cags_encoder.pruning import PrunedSource, Ranking, prune, prune_within
from cags_encoder.scenes import Focus, is_still, open_scene
from cags_encoder.views import cameras_around, contributions
from support.codec_scenes import cloud, with_changes

FOCUS = Focus((0.0, 0.0, 0.0), 1.5)
UP = (0.0, 1.0, 0.0)
needs_kernels = pytest.mark.skipif(create("auto").name == "oracle", reason="dozens of renders need the kernels")


def half_hidden() -> Splats:
    """Big opaque splats, and as many that are almost transparent."""
    splats = cloud(400, 2)
    logits = np.where(np.arange(400) % 2, 4.0, -9.0)
    return with_changes(splats, means=splats.means * 0.4, logit_opacities=logits, log_scales=np.full((400, 3), -2.5))


def test_contributions_are_those_of_pictures() -> None:
    weights = contributions(half_hidden(), cameras_around(FOCUS, UP, 2), create("auto"))
    assert weights[1::2].sum() > 100 * weights[::2].sum() >= 0


@needs_kernels
def test_what_does_not_show_goes_first_and_costs_little() -> None:
    source = SplatSequence((half_hidden(),) * 2, focus=FOCUS)
    told: list[tuple[int, int]] = []
    pruned, cheap = prune(source, 0.5, 2, lambda at, end: told.append((at, end)))
    left = pruned.frame(1)
    assert len(left) == 200 and (left.logit_opacities > 0).all()
    _, dear = prune(source, 0.9, 2, lambda at, end: None)
    assert cheap.psnr_db > 45 > 30 > dear.psnr_db
    assert cheap.ssim > dear.ssim
    assert (cheap.splats_before, cheap.splats_after, dear.splats_after) == (400, 200, 40)
    assert told == [(1, 2), (2, 2)]


@needs_kernels
def test_as_many_go_as_the_picture_allows() -> None:
    source = SplatSequence((half_hidden(),), focus=FOCUS)
    told: list[tuple[int, int]] = []
    few, loose = prune_within(source, 30.0, 1, lambda at, end: told.append((at, end)))
    many, tight = prune_within(source, 45.0, 1, lambda at, end: None)
    assert tight.psnr_db >= 45 and loose.psnr_db >= 30
    assert len(few.frame(0)) < len(many.frame(0)) <= 200
    assert (tight.splats_before, tight.splats_after) == (400, len(many.frame(0)))
    _, dearer = prune(source, loose.share + 2 / 128, 1, lambda at, end: None)
    assert dearer.psnr_db < 30, "the next step of the search would have cost too much"
    assert told[0][0] == 0 and told[-1][0] == told[-1][1]


@needs_kernels
def test_nothing_goes_where_nothing_may_be_lost() -> None:
    few = half_hidden().take(np.arange(1, 40, 2))  # all of them are visible
    pruned, cost = prune_within(SplatSequence((few,), focus=FOCUS), 80.0, 1, lambda at, end: None)
    assert (len(pruned.frame(0)), cost.splats_after, cost.psnr_db) == (20, 20, 100.0)


def test_a_share_and_a_loss_together_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"prune = 0.2 and prune_psnr_db = 45.0: give one of them"):
        EncodeSettings(prune=0.2, prune_psnr_db=45.0)


@needs_kernels
def test_clips_with_identities_lose_the_same_splats_in_every_frame() -> None:
    source = open_scene("procedural:size=1500,frames=5")
    pruned = PrunedSource(source, Ranking(source, 5), 0.2)
    known = [source.ids(k) for k in range(5)]
    left = [pruned.ids(k) for k in range(5)]
    pairs = [(a, b) for a, b in zip(known, left, strict=True) if a is not None and b is not None]
    gone = [set(a.tolist()) - set(b.tolist()) for a, b in pairs]
    stay = set.union(*(set(b.tolist()) for _, b in pairs))
    assert all(gone) and not set.union(*gone) & stay
    assert len(pairs) == 5 and len(pruned.frame(3)) == len(pairs[3][1])


@needs_kernels
def test_the_cost_is_kept_in_the_bundle(tmp_path: Path) -> None:
    scene = open_scene("procedural:size=1500,frames=2")
    settings = EncodeSettings(train_splats=1000, prune=0.3, lod_order="paper")
    manifest = encode(scene, settings, str(tmp_path / "out"))
    assert manifest.pruning is not None
    assert manifest.pruning.splats_after == pytest.approx(0.7 * manifest.pruning.splats_before, rel=0.02)
    with BundleReader.open(str(tmp_path / "out")) as reader:
        assert reader.manifest.pruning == manifest.pruning
        first = [tile.splats for tile in reader.frame(0).tiles if tile.kind == TileKind.LOOKS]
        assert sum(first) == pytest.approx(manifest.pruning.splats_after, rel=0.02)
    assert b"pruning" in manifest.public_json()
    damaged = manifest.to_json().replace(b'"ssim":', b'"ssim":9')
    with pytest.raises(BundleError, match=r"pruning\.ssim"):
        Manifest.from_json(damaged)
    assert b"pruning" not in replace(manifest, pruning=None).to_json()


@needs_kernels
def test_a_still_scene_stays_still(tmp_path: Path) -> None:
    write_splats(tmp_path / "still.ply", half_hidden())
    source = open_scene(f"{tmp_path}/still.ply:frames=3")
    pruned = PrunedSource(source, Ranking(source, 3), 0.2)
    assert is_still(pruned) and len(pruned.frame(0)) == 320
    assert pruned.frame(0) is pruned.frame(2) and pruned.ids(0) is pruned.ids(2)
