"""``cags-train restore`` from scene to weights: made pairs, training, a report, and weights in a bundle that play."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import tile_codec
from cags_common.bundle.writer import store_weights
from cags_common.cli import EXIT_USAGE
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from cags_research.restore.networks import Weights
from cags_research.training.cli import main
from cags_research.training.pairs.ladder import Ladder

SMALL = ["--views", "2", "--crops", "2", "--crop", "64", "--patch", "64", "--batch", "2", "--evaluate-every", "2"]
SCENE = "procedural:size=1500,frames=6"


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return Path(
        cached_bundle(SCENE, str(tmp_path / "cache"), EncodeSettings(frames=6, train_splats=4096, lod_order="paper"))
    )


@pytest.mark.slow
def test_from_scenes_to_a_weights_file_with_a_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["restore", "--scene", SCENE, "--held-out", "procedural:size=1500,seed=2", "--out", str(out), *SMALL]
    assert main([*words, "--steps", "4"]) == 0
    weights = Weights.load(out / "srresnet.npz")
    assert weights.network == "srresnet"
    assert weights.about["last"]["step"] == 4
    assert list(weights.about["last"]["gains_db"]) == ["0", "0.1", "0.3", "0.6", "1"]
    page = (out / "report.md").read_text()
    assert "| 4 |" in page
    assert (out / "curves.png").stat().st_size > 1000
    before = (out / "srresnet.npz").read_bytes()
    assert main([*words, "--steps", "4"]) == 0, "a finished training is found again from its checkpoint"
    assert (out / "srresnet.npz").read_bytes() == before


@pytest.mark.slow
def test_fine_tuning_for_a_bundle_starts_from_the_programs_weights(tmp_path: Path, bundle: Path) -> None:
    out = tmp_path / "out"
    words = ["restore", "--bundle", str(bundle), "--out", str(out), *SMALL, "--steps", "4", "--rate", "1e-4"]
    assert main(words) == 0
    tuned = Weights.load(out / "srresnet.npz")
    with BundleReader.open(str(bundle)) as reader:
        stored = reader.weights()
    lines = [json.loads(line) for line in (out / "history.jsonl").read_text().splitlines()]
    better = lines[-1]["gain_db"] > lines[0]["gain_db"]
    assert (stored == tuned.to_bytes()) if better else stored is None


def test_a_bundle_must_be_one(tmp_path: Path) -> None:
    assert main(["restore", "--bundle", str(tmp_path), "--out", str(tmp_path / "out")]) == EXIT_USAGE


def test_a_bundle_of_frames_that_move_has_a_ladder_of_its_splats(bundle: Path) -> None:
    """Its first frame brings motion too, in levels of its own: training on a bundle ended there."""
    ladder = Ladder.of_scene(str(bundle), EncodeSettings())
    for lod in (0, ladder.top):
        assert len(ladder.at([lod] * ladder.tiles)) == len(ladder.truth)


def test_training_is_told_the_detail_that_a_client_would_tell(tmp_path: Path) -> None:
    """Of the same tiles at the same levels in a client's store, some of them behind the viewer."""
    url = str(tmp_path / "room")
    encode(open_scene("procedural:size=9000,frames=1"), EncodeSettings(train_splats=4096, lod_order="paper"), url)
    with BundleReader.open(url) as reader:
        ladder, info = Ladder(reader), reader.manifest
        store = TileStore(info, tile_codec(info, reader.codebooks()))
        lods = np.arange(ladder.tiles) % (ladder.top + 1)
        for tile, lod in enumerate(lods):
            parts = [memoryview(reader.payload(0, tile, level)) for level in range(lod + 1)]
            assert store.add_all([Arrival(0, tile, 0, parts)]) == []
        store.end(0, reader.removed_ids(0))
    shown = store.commit(0)[0].shown
    for turn in (0.0, 1.0):  # ahead, then behind
        camera = Camera(Intrinsics.of_fov(64, 48, 0.6, 0.5), Pose(info.focus_centre, (1.0 - turn, 0.0, turn, 0.0)))
        told = shown.lod_mean(camera)
        assert ladder.lod_mean(lods, camera) == pytest.approx(told)
        assert told != pytest.approx(lods.mean()), "not all of the tiles are in view"


def test_the_client_fetches_the_bundles_weights_and_plays_with_them(bundle: Path) -> None:
    """Weights that paint everything: they are seen if and only if they arrive and are used."""
    name = "sr-align-ref"  # stands in the picture's place, whatever the splats are worth
    shipped = Weights.shipped(name)
    loud = {layer: array + 0.5 if layer == "tail.bias" else array for layer, array in shipped.arrays.items()}
    client = ClientSettings(width=160, height=120, restore=name)
    scenario = Scenario(bundle, "generated:steady-30", "synthetic:walking", client=client)
    usual = simulate(scenario)
    store_weights(str(bundle), Weights(name, loud, {"command": "a test"}).to_bytes())
    painted = simulate(scenario)
    shown = [frame["psnr_restored_db"] for frame in painted.frames]
    assert min(shown) < min(frame["psnr_restored_db"] for frame in usual.frames) - 3


def test_damaged_weights_of_the_content_do_not_end_the_play(bundle: Path) -> None:
    store_weights(str(bundle), b"no weights at all")
    scenario = Scenario(
        bundle,
        "generated:steady-30",
        "synthetic:walking",
        client=ClientSettings(width=160, height=120, restore="srresnet"),
    )
    result = simulate(scenario)
    assert result.summary["frames"] == 6
    assert result.summary["decode_errors"] == 1
