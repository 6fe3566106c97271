"""``cags-train fov``: the command, which loads PyTorch once its data are there."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from cags_common.poses.walks import read_walks, split_people
from cags_common.settings import add_settings, load_settings
from cags_research.training.fov_data import sequence_of
from cags_research.training.fov_settings import FovTraining
from cags_server.predict.pooled import PooledWeights

EXAMPLES = "  cags-train fov --poses poses/ --held-out 09,10,11,12 --out lstm.npz --seed 1"


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
    from cags_research.training.fov import Trainer

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
