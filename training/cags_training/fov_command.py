"""``cags-train fov``: the command, which loads PyTorch once its data are there."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from cags_common.poses.walks import read_walks, split_people
from cags_common.settings import add_settings, check_settings, load_settings, setting
from cags_server.predict.pooled import PooledWeights
from cags_training.fov_data import sequence_of

EXAMPLES = "  cags-train fov --poses poses/ --held-out 09,10,11,12 --out lstm.npz --seed 1"


@dataclass(frozen=True)
class FovTraining:
    """How the network is trained."""

    hidden: int = setting(32, "size of the hidden state", low=1, high=256)
    lead: int = setting(6, "frames that the viewer is predicted ahead, and the length of roll-outs", low=1, high=30)
    quantile: float = setting(0.5, "quantile of the pinball loss; 0.5 is the paper's L1", low=0.01, high=0.99)
    length: int = setting(96, "frames of one training session", low=16, high=2000)
    batch: int = setting(32, "sessions a step", low=1, high=1024)
    rate: float = setting(3e-3, "learning rate at the start; it falls to zero by a cosine", low=1e-6, high=1.0)
    epochs: int = setting(30, "passes over the walks at most", low=1, high=10_000)
    patience: int = setting(8, "epochs without a better validation loss before stopping", low=1, high=10_000)
    validation: str = setting("07,08", "people, of those trained on, who only decide when to stop")
    seed: int = setting(1, "seed of everything random", low=0)

    def __post_init__(self) -> None:
        check_settings(self)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the subcommand."""
    parser.add_argument("--poses", required=True, metavar="DIR", help="folder of SCENE_userNN.csv walks")
    parser.add_argument("--held-out", default="09,10,11,12", metavar="NN,..", help="people kept for testing")
    parser.add_argument("--out", required=True, metavar="FILE", help="weights to write (.npz)")
    add_settings(parser, FovTraining)


def run(arguments: argparse.Namespace) -> int:
    """Train, write the best weights, and print a summary as JSON. Raises :class:`CagsError`."""
    settings = load_settings(FovTraining, arguments)
    rest, held_out = split_people(read_walks(arguments.poses), arguments.held_out)
    train, validation = split_people(rest, settings.validation)
    weights = PooledWeights.load()
    parts = [[sequence_of(w.trace, weights, settings.lead) for w in walks] for walks in (train, validation, held_out)]
    from cags_training.fov import Trainer

    trainer = Trainer(settings, parts[0])
    history = list(trainer.fit(parts[1]))
    flags = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in asdict(settings).items())
    trained = trainer.weights(
        {
            "command": f"cags-train fov --poses POSES --held-out {arguments.held_out} {flags}",
            "data": sorted(walk.name for walk in train),
            "validation": sorted(walk.name for walk in validation),
        }
    )
    out = Path(arguments.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    trained.save(out)
    summary = {
        "out": str(out),
        "epochs": len(history),
        "validation_loss": min(history),
        "held_out_loss": trainer.loss_over(parts[2]),
        "bytes": out.stat().st_size,
    }
    print(json.dumps(summary))
    return 0
