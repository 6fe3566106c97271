"""Fitting the predictor and training the margins, on walks made here."""

import json
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import ConfigError, TraceError
from cags_common.geometry import F64
from cags_common.poses import PoseTrace, write_poses
from cags_common.poses.walks import read_walks, split_people
from cags_research.training.cli import main
from cags_server.fov.lstm import LstmFov, LstmWeights
from cags_server.predict.pooled import HORIZON_STEPS, ORDERS, PooledWeights
from support.motion import swaying_pose


def walk(seed: int, seconds: float = 12.0) -> PoseTrace:
    times = np.arange(0, round(seconds * 1e6), 27_700)
    poses = [swaying_pose(int(t) + seed * 7_000_000) for t in times]
    positions: F64 = np.array([p.position for p in poses])
    return PoseTrace(times.astype(np.int64), positions, np.array([p.rotation for p in poses]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("poses")
    for person in range(1, 5):
        write_poses(walk(person), root / f"hall_user{person:02d}.csv")
    return root


def test_the_predictor_is_fitted_and_says_on_what(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "ar.npz"
    assert main(["predictor", "--poses", str(folder), "--held-out", "04", "--out", str(out)]) == 0
    assert json.loads(capsys.readouterr().out)["walks"] == 3
    weights = PooledWeights.load(out)
    assert weights.provenance["data"] == ["hall_user01", "hall_user02", "hall_user03"]
    assert set(weights.matrices) == set(ORDERS)
    assert weights.matrices[12].shape == (len(HORIZON_STEPS), 72, 6)


def test_fitting_twice_gives_the_same(folder: Path, tmp_path: Path) -> None:
    outs = [tmp_path / f"{i}.npz" for i in range(2)]
    for out in outs:
        main(["predictor", "--poses", str(folder), "--held-out", "04", "--out", str(out)])
    a, b = (PooledWeights.load(out) for out in outs)
    assert all((a.matrices[order] == b.matrices[order]).all() for order in ORDERS)


def test_the_margins_are_trained_and_run_in_the_server(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "lstm.npz"
    flags = ["--epochs", "2", "--hidden", "4", "--length", "40", "--validation", "03", "--seed", "7"]
    assert main(["fov", "--poses", str(folder), "--held-out", "04", "--out", str(out), *flags]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert 1 <= summary["epochs"] <= 2
    weights = LstmWeights.load(out)
    assert weights.hidden == 4
    assert "--seed 7" in weights.provenance["command"]
    assert LstmFov(weights=weights) is not None


def test_the_server_runs_what_torch_trained() -> None:
    """One step by step roll-out in NumPy equals the one that the training differentiates."""
    torch = pytest.importorskip("torch")
    from cags_research.training.fov import FovNetwork, Trainer, rollouts
    from cags_research.training.fov_data import CLIENT, chunks, sequence_of
    from cags_research.training.fov_settings import FovTraining
    from cags_server.fov.base import FovObservation
    from cags_server.predict import PoseDistribution

    sequences = [sequence_of(walk(1), PooledWeights.load(), 6)]
    trainer = Trainer(FovTraining(hidden=5, length=40), sequences)
    assert isinstance(trainer._network, FovNetwork)
    policy = LstmFov(weights=trainer.weights({}))
    (part,) = chunks(sequences, 40, np.random.default_rng(3))[:1]
    from cags_research.training.fov import Batch

    with torch.no_grad():
        expected = rollouts(trainer._network, Batch.of([part]), 6)[0, 20, -1].numpy()
    for i in range(21):  # frames 0 .. 20 are known, 21 .. 26 in flight
        policy.truth(i, _pose(part, i, "predicted_"), _pose(part, i), CLIENT)
        # The policy measures the margins itself; the training's are those of the recorded walk, unturned.
        state = policy._true
        policy._true = type(state)(state.hidden, state.cell, state.rotation, state.position, part.fast[i])
    for i in range(21, 27):
        pose = _pose(part, i, "predicted_")
        margins = policy.scale(FovObservation(i, PoseDistribution(pose, (0,) * 3, (0,) * 3), CLIENT))
    assert margins == pytest.approx(np.maximum(expected, 0), abs=1e-4)


def _pose(part, i: int, prefix: str = ""):
    from cags_common.geometry import Pose

    p, q = getattr(part, f"{prefix}positions")[i].tolist(), getattr(part, f"{prefix}rotations")[i].tolist()
    return Pose(tuple(p), tuple(q))


@pytest.mark.parametrize(
    ("held_out", "words"), [("09", r"\['09'\] have no walks"), ("01,02,03,04", "leaves 0 walks"), ("", "test on")]
)
def test_people_that_cannot_be_held_out_are_named(folder: Path, held_out: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        split_people(read_walks(folder), held_out)


def test_walks_must_say_who_walks(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="holds no pose traces"):
        read_walks(tmp_path)
    write_poses(walk(1, 1.0), tmp_path / "someone.csv")
    with pytest.raises(TraceError, match="does not say who walks"):
        read_walks(tmp_path)


@pytest.mark.parametrize("flags", [["predictor", "--ridge", "0"], ["fov", "--epochs", "0"]])
def test_wrong_settings_are_wrong_use(flags: list[str], folder: Path, tmp_path: Path, capsys) -> None:
    assert main([*flags, "--poses", str(folder), "--held-out", "04", "--out", str(tmp_path / "x.npz")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
