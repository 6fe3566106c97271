"""``cags-train score``: restorers on whole pictures, by the share of the ladder that is held."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

from cags_client.frame import align
from cags_client.frame.align import ReferencePicture
from cags_client.frame.restore import RestoreInput
from cags_common.cli import EXIT_USAGE
from cags_common.errors import SceneError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_research.restore.networks.srresnet import SrResNet
from cags_research.restore.networks.weights import Weights
from cags_research.training.cli import main
from cags_research.training.pairs.crops import pairs_of_views
from cags_research.training.pairs.maker import Pair
from cags_research.training.pairs.settings import PairSettings
from cags_research.training.restore.score import MAX_DB, Score, score_of, table


class Fills:
    """Shows the truth of one colour, off by so much."""

    name, needs, replaces = "fills", frozenset(), True

    def __init__(self, colour):
        self._colour = colour

    def restore(self, inputs):
        return np.full_like(inputs.distorted, self._colour)


def pair(ladder=0.3, error=0.1):
    """A grey picture whose left half the scene covers; the client's is off by ``error`` there, by 0.4 beside."""
    truth = np.full((4, 6, 3), 0.5, np.float32)
    covered = np.zeros((4, 6), np.float32)
    covered[:, :3] = 1
    distorted = truth - np.where(covered, error, 0.4)[..., None].astype(np.float32)
    camera = Camera(Intrinsics.of_fov(6, 4, 1.0, 0.8), Pose.identity())
    aligned = align.create("fast").align(ReferencePicture(truth, camera, 0), np.ones((4, 6), np.float32), camera)
    return Pair(RestoreInput(distorted, aligned, 20.0), truth=truth, truth_alpha=covered, ladder=ladder)


def test_gains_are_over_what_the_scene_covers():
    score = score_of(pair(), "a", {"half": Fills(0.45), "true": Fills(0.5), "worse": Fills(0.3)})
    assert score.distorted_db == pytest.approx(20, abs=1e-4)
    assert score.gains_db == pytest.approx({"half": 6.0206, "true": MAX_DB - 20, "worse": -6.0206}, abs=1e-3)
    assert (score.ladder, score.expected_db, score.width) == (0.3, 20, 6)


class Drawn:
    """A maker whose views show this much of the scene, one after the other."""

    def __init__(self, *shown):
        self._shown = iter(shown)

    def draw_levels(self, rng, levels):
        one = pair()
        covered = np.zeros((10, 20), np.float32)
        covered.flat[: next(self._shown)] = 1
        return [replace(one, truth_alpha=covered, ladder=level) for level in levels]


def test_views_that_hardly_show_the_scene_are_drawn_again():
    """A picture with nothing in it has nothing to get wrong: whole scenes were scored at 60 dB and no gain."""
    settings = PairSettings(views=2, levels="0 1")
    drawn = list(pairs_of_views(Drawn(0, 1, 200, 50), settings, np.random.default_rng(0)))
    assert [[(p.truth_alpha.sum(), p.ladder) for p in pairs] for pairs in drawn] == [
        [(200, 0), (200, 1)],
        [(50, 0), (50, 1)],
    ]
    with pytest.raises(SceneError, match="no view of the scene shows it"):
        list(pairs_of_views(Drawn(0, 1, 0, 0), settings, np.random.default_rng(0)))


def test_the_table_has_means_by_share_of_the_ladder_and_the_worst_picture():
    gains = [(0.0, 4.0), (0.04, 6.0), (0.3, -2.0), (0.31, 1.0)]
    text = table([Score("a", ladder, 0.0, 64, 30.0, {"one": gain, "same": 0.0}) for ladder, gain in gains])
    assert text.splitlines() == [
        "| share of the ladder | 0 | 0.3 | worst picture |",
        "| --- | --- | --- | --- |",
        "| distorted, dB | 30.0 | 30.0 |  |",
        "| one | +5.00 | -0.50 | -2.00 |",
        "| same | +0.00 | +0.00 | +0.00 |",
    ]


@pytest.mark.slow
def test_from_a_scene_to_scores_of_names_and_files(tmp_path, capsys):
    network = SrResNet(gated=True)
    network.start_at_blurred()
    arrays = {name: p.detach().numpy() for name, p in network.named_parameters()}
    Weights("srresnet", arrays, {}).save(tmp_path / "w.npz")
    words = ["score", "--scene", "procedural:size=1500", "--views", "1", "--levels", "0 1", "--json", "reference"]
    assert main([*words, str(tmp_path / "w.npz")]) == 0
    base, top = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (base["ladder"], top["ladder"]) == (0, 1)
    assert base["distorted_db"] < top["distorted_db"]
    assert base["expected_db"] + 10 < top["expected_db"]
    gains = top["gains_db"]
    assert gains["reference"] < gains[str(tmp_path / "w.npz")], (
        "what is expected keeps the gate from what the reference lacks"
    )


def test_a_restorer_that_is_not_there_is_named(tmp_path, capsys):
    assert main(["score", "--scene", "procedural:size=300", str(tmp_path / "no.npz")]) == EXIT_USAGE
    assert "no.npz" in capsys.readouterr().err
