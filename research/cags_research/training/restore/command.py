"""``cags-train restore``: from scenes to a weights file, with a report."""

from __future__ import annotations

import argparse
import functools
import json
import shlex
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cags_common.errors import ConfigError
from cags_common.settings import add_flags, add_settings, load_settings
from cags_research.training.pairs.settings import PairSettings
from cags_research.training.restore.settings import TrainSettings

if TYPE_CHECKING:
    from cags_research.restore.networks.weights import Weights
    from cags_research.training.pairs.crops import Crops
    from cags_research.training.restore.trainer import Trainer

EXAMPLES = """\
  cags-train restore --scene procedural:seed=5 --held-out procedural:seed=9 --out srresnet/
  cags-train restore --scene a.ply --scene b.splat --held-out c.sog --poses walk.csv --steps 12000 --out srresnet/
  cags-train restore --network sr-align-ref --patch 96 --scene a.ply --held-out c.sog --out alone/
  cags-train restore --bundle mine.cags --rate 3e-4 --steps 800 --out fine/   # fine-tune; clients fetch the weights
  cags-train restore --start srresnet/srresnet.npz --rate 3e-4 --scene mine.ply --held-out mine.ply --out fine/"""

HELD_OUT_VIEWS_SHARE = 0.2

HELD_OUT_LEVELS = "0 0.1 0.3 0.6 1"
"""Shares of the ladder at which held-out views are scored."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    parser.add_argument("--scene", action="append", default=[], metavar="SCENE", help="scene to train on; repeatable")
    parser.add_argument(
        "--held-out", action="append", default=[], metavar="SCENE", help="scene to score on; repeatable"
    )
    parser.add_argument(
        "--bundle",
        default=None,
        metavar="DIR",
        help="fine-tune for this encoded scene, from --start or the program's weights, and store the weights in it",
    )
    parser.add_argument(
        "--poses", action="append", default=[], metavar="FILE", help="head-motion trace to look along; repeatable"
    )
    parser.add_argument(
        "--held-out-poses",
        action="append",
        default=[],
        metavar="FILE",
        help="trace to look along in held-out scenes; repeatable (default: those of --poses)",
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of weights, checkpoint and report")
    parser.add_argument("--pairs", default=None, metavar="DIR", help="folder of made pairs (default: OUT/pairs)")
    parser.add_argument("--start", default=None, metavar="FILE", help="weights to start from (fine-tuning)")
    parser.add_argument("--restart", action="store_true", help="ignore the checkpoint in OUT")
    parser.add_argument("--json", action="store_true", help="print the history as JSON lines to stdout")
    add_settings(parser, TrainSettings)
    add_flags(parser.add_argument_group("pairs"), PairSettings)


def run(arguments: argparse.Namespace) -> int:
    """Make what pairs are missing, train, and write ``NETWORK.npz``, ``report.md`` and ``curves.png``."""
    from cags_research.training.restore.trainer import Trainer

    _commit()  # now: files may change while it trains
    settings = load_settings(TrainSettings, arguments, PairSettings)
    pairs = load_settings(PairSettings, arguments, TrainSettings)
    if arguments.bundle:
        _aim_at_bundle(arguments)
    if not arguments.scene or not arguments.held_out:
        raise ConfigError("give at least one --scene to train on and one --held-out to score on")
    if settings.patch > pairs.crop:
        raise ConfigError(f"patch = {settings.patch} is larger than crop = {pairs.crop}; make crops larger")
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    train, held_out = _data(arguments, pairs, out)
    trainer = Trainer(settings, train, held_out, pairs.seed)
    _prepare(trainer, arguments, out)
    _train(trainer, settings, out, as_json=arguments.json)
    weights = _finish(trainer, settings, arguments, out)
    if arguments.bundle:
        _store(weights, trainer, arguments.bundle)
    return 0


def _aim_at_bundle(arguments: argparse.Namespace) -> None:
    """Train on the bundle; score on other views of it, unless other scenes are named."""
    from cags_research.training.pairs.ladder import is_bundle

    if not is_bundle(arguments.bundle):
        raise ConfigError(f"--bundle {arguments.bundle}: is no encoded scene on this machine; run cags-encode first")
    arguments.scene = [*arguments.scene, arguments.bundle]
    arguments.held_out = arguments.held_out or [arguments.bundle]


def _store(weights: Weights, trainer: Trainer, bundle: str) -> None:
    """Put the weights into the bundle, if they are better than those that training began with."""
    from cags_common.bundle.writer import store_weights

    if trainer.history[-1].gain_db <= trainer.history[0].gain_db:
        print(f"{bundle}: training made the weights no better than at its start; nothing is stored", file=sys.stderr)
        return
    store_weights(bundle, weights.to_bytes())
    print(f"{bundle}: holds the weights now; servers that open it offer them", file=sys.stderr)


def _data(arguments: argparse.Namespace, pairs: PairSettings, out: Path) -> tuple[Crops, Crops]:
    from cags_encoder.execution.progress import progress_bar
    from cags_research.training.restore.data import crops_of_scenes

    folder = Path(arguments.pairs) if arguments.pairs else out / "pairs"
    fewer = replace(
        pairs, views=max(1, int(pairs.views * HELD_OUT_VIEWS_SHARE)), seed=pairs.seed + 1, levels=HELD_OUT_LEVELS
    )
    others = arguments.held_out_poses or arguments.poses
    with progress_bar() as tell:
        train = crops_of_scenes(arguments.scene, arguments.poses, pairs, folder, tell)
        held_out = crops_of_scenes(arguments.held_out, others, fewer, folder, tell)
    return train, held_out


def _prepare(trainer: Trainer, arguments: argparse.Namespace, out: Path) -> None:
    """Start from given weights, or go on from the checkpoint that is there."""
    from cags_research.restore.networks.weights import Weights
    from cags_research.training.restore.checkpoint import Checkpoint

    if arguments.start:
        trainer.start_from(Weights.load(Path(arguments.start)))
    elif arguments.bundle:
        trainer.start_from(Weights.shipped(trainer.settings.network))
    checkpoint = out / "checkpoint.npz"
    if checkpoint.exists() and not arguments.restart:
        trainer.resume(Checkpoint.load(checkpoint))


def _train(trainer: Trainer, settings: TrainSettings, out: Path, *, as_json: bool) -> None:
    from cags_encoder.execution.progress import progress_bar

    with progress_bar() as tell:

        def told(done: int, total: int, line: Any) -> None:
            tell(f"train {settings.network}", done, total)
            if line is not None and as_json:
                print(json.dumps(asdict(line)), flush=True)

        trainer.run(told, lambda checkpoint: checkpoint.save(out / "checkpoint.npz"))


def _finish(trainer: Trainer, settings: TrainSettings, arguments: argparse.Namespace, out: Path) -> Weights:
    from cags_research.restore.networks.weights import Weights
    from cags_research.training.restore.report import write_report

    last = trainer.history[-1]
    about = {
        "network": settings.network,
        "command": "cags-train " + shlex.join(sys.argv[1:]),
        "scenes": arguments.scene,
        "held_out": arguments.held_out,
        "poses": [Path(walk).name for walk in arguments.poses],
        "held_out_poses": [Path(walk).name for walk in arguments.held_out_poses or arguments.poses],
        "commit": _commit(),
        "seed": trainer.seed,
        "training": asdict(settings),
        "last": asdict(last),
        "crops": {"train": len(trainer.train), "held_out": len(trainer.held_out)},
    }
    weights = Weights(settings.network, trainer.weights, {k: v for k, v in about.items() if k != "network"})
    weights.save(out / f"{settings.network}.npz")
    page = write_report(out, trainer.history, about)
    print(
        f"{out / settings.network}.npz: {last.gain_db:+.2f} dB over the distorted picture on held-out crops "
        f"(step {last.step}); {page}",
        file=sys.stderr,
    )
    return weights


@functools.cache
def _commit() -> str | None:
    """Commit of the program's working tree, "+" behind it where files differ; None outside of one."""
    words = ["git", "describe", "--always", "--dirty=+"]
    try:
        said = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return said.stdout.strip()
