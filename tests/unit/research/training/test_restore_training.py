"""Training of restorers: data that may be augmented, a loss that does not die, training that resumes where it was."""

from dataclasses import fields, replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cags_common.errors import CagsError, ConfigError, SceneError  # noqa: E402
from cags_research.restore.networks import Weights  # noqa: E402
from cags_research.training.pairs.crops import Crops  # noqa: E402
from cags_research.training.pairs.ladder import draw_lods  # noqa: E402
from cags_research.training.pairs.settings import PairSettings  # noqa: E402
from cags_research.training.restore.checkpoint import Checkpoint  # noqa: E402
from cags_research.training.restore.dataset import distorted_psnr, draw_batch, even_chances, plain_batch  # noqa: E402
from cags_research.training.restore.report import write_report  # noqa: E402
from cags_research.training.restore.settings import TrainSettings  # noqa: E402
from cags_research.training.restore.tasks import HARM, NETWORKS, batch_loss, covered_psnr, loss  # noqa: E402
from cags_research.training.restore.trainer import Trainer  # noqa: E402

SIDE = 32


def crops(count=12, seed=0):
    """Pictures of random blocks, the reference the same picture; distorted ones are off by one colour a crop."""
    rng = np.random.default_rng(seed)
    truth = rng.integers(60, 180, (count, SIDE // 8, SIDE // 8, 3)).repeat(8, 1).repeat(8, 2)
    off = rng.integers(-40, 40, (count, 1, 1, 3))
    distorted, truth = ((truth + shift).astype(np.uint8) for shift in (off, 0))
    full = np.full((count, SIDE, SIDE), 255, np.uint8)
    ladder = np.linspace(0, 1, count).astype(np.float32).round(1)
    return Crops(
        distorted=distorted,
        aligned=truth,
        confidence=full,
        truth=truth,
        covered=full,
        expected_db=27 + 24 * np.sqrt(ladder),
        ladder=ladder,
    )


def settings(**changes):
    small = {"steps": 6, "batch": 2, "patch": 16, "evaluate_every": 2, "rate": 1e-3, "gate_steps": 0}
    return TrainSettings(**{**small, **changes})


def run(trainer, stop_at=None):
    saved = []
    trainer.run(lambda *_: None, saved.append)
    return saved


def test_crops_come_back_from_their_file(tmp_path):
    crops().save(tmp_path / "a.npz")
    back = Crops.load(tmp_path / "a.npz")
    for f in fields(Crops):
        np.testing.assert_array_equal(getattr(back, f.name), getattr(crops(), f.name))
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_damaged_crops_are_named(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 no")
    with pytest.raises(SceneError, match=r"a\.npz"):
        Crops.load(tmp_path / "a.npz")


def test_a_batch_depends_on_seed_and_step_alone():
    one, same, other = (draw_batch(crops(), 4, 16, (7, step)) for step in (3, 3, 4))
    np.testing.assert_array_equal(one.truth, same.truth)
    assert not np.array_equal(one.truth, other.truth)


def test_turning_keeps_pixels_together():
    batch = draw_batch(crops(), 32, 16, (0, 0))
    np.testing.assert_array_equal(batch.aligned, batch.truth)  # the reference is the true picture in these crops
    off = batch.distorted - batch.truth
    np.testing.assert_allclose(off, np.broadcast_to(off[:, :1, :1], off.shape), atol=1e-6)
    plain = plain_batch(crops(), np.arange(12), 16)
    assert any(not np.array_equal(one, other) for one in batch.truth for other in plain.truth)


def test_patches_must_fit_the_crops():
    with pytest.raises(ValueError, match="larger than the crops"):
        draw_batch(crops(), 1, SIDE + 8, (0, 0))


def test_the_loss_pulls_back_what_is_beyond_the_displayed_range():
    restored = torch.full((1, 4, 4, 3), 1.5, requires_grad=True)
    loss(restored, torch.full((1, 4, 4, 3), 0.9), torch.ones(1, 4, 4, 1)).backward()
    assert (restored.grad > 0).all()


def test_a_decibel_that_is_lost_counts_more_than_one_that_is_won():
    """Or a network that cannot tell which of the two it will be wins the one and loses the other."""
    batch = replace(plain_batch(crops(1), np.arange(1), 16), distorted=np.full((1, 16, 16, 3), 0.5, np.float32))
    truth = torch.full((1, 16, 16, 3), 0.5 + 0.05)
    batch = replace(batch, truth=truth.numpy())
    same, worse, better = (
        float(batch_loss(truth - off, batch, torch.device("cpu"))) for off in (0.05, 0.05 * 1.1, 0.05 / 1.1)
    )
    assert same == pytest.approx(float(loss(truth - 0.05, truth, torch.from_numpy(batch.covered))), abs=1e-5)
    assert (worse - same) == pytest.approx((1 + HARM) * (same - better), rel=1e-2)


def test_void_counts_less_than_what_is_covered():
    truth, restored = torch.zeros(1, 4, 4, 3), torch.zeros(1, 4, 4, 3)
    restored[:, :2] = 0.1
    covered = torch.zeros(1, 4, 4, 1)
    covered[:, :2] = 1
    wrong_where_covered = loss(restored, truth, covered)
    assert wrong_where_covered > loss(restored, truth, 1 - covered) + 1


def test_psnr_is_over_covered_pixels():
    restored, covered = torch.zeros(1, 2, 2, 3), torch.tensor([1.0, 0.0, 0.0, 0.0]).reshape(1, 2, 2, 1)
    restored[0, 0, 0] = 0.1
    assert covered_psnr(restored, torch.zeros(1, 2, 2, 3), covered).item() == pytest.approx(20.0, abs=1e-4)


@pytest.mark.parametrize("name", list(NETWORKS))
def test_every_network_trains_to_the_last_step(name):
    trainer = Trainer(settings(network=name), crops(), crops(4, seed=1), 0)
    saved = run(trainer)
    assert trainer.finished
    assert [line.step for line in trainer.history] == [2, 4, 6]
    assert len(saved) == 3
    assert set(trainer.weights) == {n for n, _ in NETWORKS[name][0](True).named_parameters()}


def test_the_last_weights_are_kept_where_earlier_ones_scored_better():
    """Kept by their best mean, networks that learnt to leave pictures alone won over those that restore."""
    misled = replace(crops(4), distorted=crops(4).truth, aligned=255 - crops(4).truth)  # the more is learnt, the worse
    trainer = Trainer(settings(rate=1e-4), crops(), misled, 0)
    saved = run(trainer)
    assert trainer.history[0].gain_db > trainer.history[-1].gain_db
    for name, array in trainer.weights.items():
        np.testing.assert_array_equal(array, saved[-1].arrays[f"average/{name}"])


def test_gains_are_told_by_the_share_of_the_ladder():
    trainer = Trainer(settings(steps=2), crops(), crops(3, seed=1), 0)
    run(trainer)
    gains = trainer.history[-1].gains_db
    assert list(gains) == ["0", "0.5", "1"]
    assert np.mean(list(gains.values())) == pytest.approx(trainer.history[-1].gain_db, abs=1e-5)


def test_every_class_of_distorted_pictures_is_drawn_as_often():
    """Of crops drawn evenly over the ladder, one in forty is as poor as what the paper restores."""
    many = crops(40)
    off = np.r_[np.full(38, 1), 12, 60].astype(np.uint8)  # 48, 26.5 and 12.6 dB
    uneven = replace(many, distorted=many.truth + off[:, None, None, None])
    assert distorted_psnr(uneven)[-3:] == pytest.approx([48.13, 26.55, 12.57], abs=0.01)
    chances = even_chances(uneven)
    assert chances.sum() == pytest.approx(1)
    assert chances[-2:] == pytest.approx([1 / 3, 1 / 3])
    drawn = np.concatenate([draw_batch(uneven, 50, 16, (0, step), chances).distorted for step in range(6)])
    steps = np.abs(drawn - np.concatenate([draw_batch(uneven, 50, 16, (0, k), chances).truth for k in range(6)]))
    assert 0.2 < (steps.mean(axis=(1, 2, 3)) > 50 / 255).mean() < 0.46


@pytest.mark.parametrize("gate_steps", [0, 1, 3])
def test_resumed_training_ends_where_unbroken_training_does(tmp_path, gate_steps):
    """With a gate that learns alone, the two parts of the network are not of the same number of steps."""
    chosen = settings(gate_steps=gate_steps)
    whole = Trainer(chosen, crops(), crops(4, seed=1), 0)
    saved = {save.facts["step"]: save for save in run(whole)}
    saved[2].save(tmp_path / "c.npz")
    resumed = Trainer(chosen, crops(), crops(4, seed=1), 0)
    resumed.resume(Checkpoint.load(tmp_path / "c.npz"))
    assert resumed.step == 2
    run(resumed)
    for name, array in whole.weights.items():
        np.testing.assert_allclose(resumed.weights[name], array, atol=1e-6)
    assert [line.step for line in resumed.history] == [line.step for line in whole.history]


def test_the_gate_learns_alone_for_its_first_steps_and_is_scored_then():
    trainer = Trainer(settings(gate_steps=3), crops(), crops(4, seed=1), 0)
    before, (_, alone, *_, end) = trainer.checkpoint().arrays, run(trainer)
    assert [line.step for line in trainer.history] == [2, 3, 4, 6]
    assert alone.facts["step"] == 3
    for name in (f"network/{name}" for name in trainer.weights):
        assert np.array_equal(before[name], alone.arrays[name]) == (not name.startswith("network/gate.")), name
        assert not np.array_equal(alone.arrays[name], end.arrays[name]), name


def test_the_papers_network_trains_without_a_gate_and_is_told_no_psnr():
    trainer = Trainer(settings(gate=False, gate_steps=3), crops(), crops(4, seed=1), 0)
    before = trainer.checkpoint().arrays
    run(trainer)
    assert [line.step for line in trainer.history] == [2, 4, 6], "nothing learns alone"
    assert not np.array_equal(before["network/head.weight"], trainer.weights["head.weight"])
    assert not Weights("srresnet", trainer.weights, {}).gated
    assert Weights("srresnet", Trainer(settings(), crops(), crops(4), 0).weights, {}).gated


def test_what_is_shown_is_trained_and_not_what_lies_beyond_the_reach_of_the_reference():
    """There the distorted picture is shown, whatever the network answers."""
    blind = replace(crops(), confidence=np.zeros_like(crops().confidence))
    trainer = Trainer(settings(), blind, crops(4), 0)
    before = trainer.checkpoint().arrays
    run(trainer)
    for name, array in trainer.weights.items():
        np.testing.assert_array_equal(before[f"network/{name}"], array)


def test_a_gate_learns_from_the_expected_psnr_what_the_pictures_do_not_tell():
    """At the base the reference is right, at the top the client's picture is: the pictures are drawn alike."""
    base = crops(24)
    top = replace(base, distorted=base.truth, aligned=base.distorted)
    parts = [
        replace(of, expected_db=np.full(24, psnr_db, "f"), ladder=np.full(24, share, "f"))
        for of, psnr_db, share in ((base, 22, 0), (top, 60, 1))
    ]
    mixed = Crops.concatenate(parts)
    trainer = Trainer(settings(steps=60, gate_steps=60, rate=1e-2, evaluate_every=60), mixed, mixed, 0)
    run(trainer)
    gains = trainer.history[-1].gains_db
    assert gains["0"] > 6
    assert gains["1"] > -0.5


def test_a_checkpoint_of_other_settings_is_refused():
    checkpoint = Trainer(settings(), crops(), crops(4), 0).checkpoint()
    with pytest.raises(ConfigError, match="other settings"):
        Trainer(settings(rate=1e-4), crops(), crops(4), 0).resume(checkpoint)


def test_a_damaged_checkpoint_is_named(tmp_path):
    (tmp_path / "c.npz").write_bytes(b"x" * 100)
    with pytest.raises(ConfigError, match=r"c\.npz"):
        Checkpoint.load(tmp_path / "c.npz")


def test_fine_tuning_starts_from_given_weights():
    first = Trainer(settings(), crops(), crops(4), 0)
    run(first)
    tuned = Trainer(settings(), crops(), crops(4), 0)
    tuned.start_from(Weights("srresnet", first.weights, {}))
    state = tuned.checkpoint().arrays
    np.testing.assert_array_equal(state["network/head.weight"], first.weights["head.weight"])
    with pytest.raises(ConfigError, match="'cr-no-ref'"):
        tuned.start_from(Weights("cr-no-ref", {}, {}))


def test_the_report_has_curves_and_facts(tmp_path):
    trainer = Trainer(settings(), crops(), crops(4), 0)
    run(trainer)
    page = write_report(tmp_path, trainer.history, {"network": "srresnet", "command": "cags-train restore"})
    text = page.read_text()
    assert "cags-train restore" in text
    assert text.count("\n| ") == 1 + len(trainer.history)
    assert (tmp_path / "curves.png").stat().st_size > 1000
    assert len((tmp_path / "history.jsonl").read_text().splitlines()) == len(trainer.history)


def test_lods_stay_on_the_ladder_and_cover_it():
    rng = np.random.default_rng(0)
    drawn = np.concatenate([draw_lods(rng, 5, 12) for _ in range(300)])
    assert drawn.min() == 0
    assert drawn.max() == 12
    assert len(np.unique(drawn)) == 13


def test_lods_are_drawn_so_that_every_decibel_comes_as_often():
    rng = np.random.default_rng(0)
    roots = np.sort([np.sqrt(draw_lods(rng, 1, 100)[0] / 100) for _ in range(4000)])
    assert abs(roots - np.linspace(0, 1, 4000)).max() < 0.16  # drawn evenly themselves: 0.25


@pytest.mark.parametrize(
    "wrong", [{"quantisers": "none"}, {"views": 0}, {"crf_low": 99.0}, {"levels": "0 high"}, {"levels": "0 1.5"}]
)
def test_settings_of_pairs_are_checked(wrong):
    with pytest.raises(CagsError):
        PairSettings(**wrong)
