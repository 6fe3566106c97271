"""``cags-train score``: what restorers make of whole pictures of held-out scenes, by the share of the ladder held."""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cags_common.metrics import covered_mask, psnr
from cags_common.settings import add_flags, load_settings
from cags_research.training.pairs.crops import pairs_of_views
from cags_research.training.pairs.ladder import Ladder
from cags_research.training.pairs.maker import Pair, PairMaker
from cags_research.training.pairs.settings import PairSettings
from cags_research.training.pairs.views import focus_of_manifest, open_walks
from cags_research.training.restore.command import HELD_OUT_LEVELS

if TYPE_CHECKING:
    from cags_client.frame.restore import Restorer

EXAMPLES = """\
  cags-train score --scene c.sog --poses walk.csv --views 4 srresnet sr-align-ref reference
  cags-train score --scene c.sog --levels '0 0.5 1' --json srresnet/srresnet.npz srresnet@openvino"""

MAX_DB = 60.0
"""PSNR above which pictures count as equal, as in training."""


@dataclass(frozen=True)
class Score:
    """One picture."""

    scene: str
    ladder: float  # mean LoD of the tiles, as a share of the ladder
    expected_db: float  # what restorers are told (RestoreInput.expected_db)
    width: int
    distorted_db: float  # PSNR over covered pixels
    gains_db: Mapping[str, float]  # over the distorted picture, by restorer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    parser.add_argument("restorers", nargs="+", metavar="RESTORER", help="name of a restorer, or a weights file (.npz)")
    parser.add_argument(
        "--scene", action="append", required=True, metavar="SCENE", help="scene to score on; repeatable"
    )
    parser.add_argument(
        "--poses", action="append", default=[], metavar="FILE", help="head-motion trace to look along; repeatable"
    )
    parser.add_argument("--json", action="store_true", help="print a JSON line for each picture, in place of the table")
    add_flags(parser, PairSettings)
    parser.set_defaults(levels=HELD_OUT_LEVELS)


def run(arguments: argparse.Namespace) -> int:
    """Score, and print a table or JSON lines."""
    settings = load_settings(PairSettings, arguments)
    restorers = {spec: _restorer(spec) for spec in arguments.restorers}
    scores = []
    for spec in arguments.scene:
        for score in _scores(spec, arguments.poses, settings, restorers):
            scores.append(score)
            if arguments.json:
                print(json.dumps(asdict(score)), flush=True)
    if not arguments.json:
        print(table(scores))
    return 0


def _restorer(spec: str) -> Restorer:
    from cags_client.frame import restore
    from cags_research.restore.networks import Weights, from_weights

    return from_weights(Weights.load(Path(spec))) if spec.endswith(".npz") else restore.create(spec)


def _scores(
    spec: str, walks: Sequence[str], settings: PairSettings, restorers: Mapping[str, Restorer]
) -> Iterator[Score]:
    """The same drawn views of a scene, of those that show it, at each of the settings' levels."""
    from cags_encoder.settings import EncodeSettings

    quantiser = settings.quantiser_list[0]
    ladder = Ladder.of_scene(spec, EncodeSettings(seed=settings.seed, quantiser=quantiser))
    placed = open_walks(tuple(walks), focus_of_manifest(ladder.manifest), settings.seed)
    maker, rng = PairMaker(ladder, placed, settings), np.random.default_rng((settings.seed, zlib.crc32(spec.encode())))
    for pairs in pairs_of_views(maker, settings, rng):
        for pair in pairs:
            yield score_of(pair, spec, restorers)


def score_of(pair: Pair, scene: str, restorers: Mapping[str, Restorer]) -> Score:
    """What each of ``restorers`` wins on one pair."""
    covered, inputs = covered_mask(pair.truth_alpha), pair.inputs
    before = min(psnr(inputs.distorted, pair.truth, covered), MAX_DB)
    gains = {
        name: min(psnr(restorer.restore(inputs), pair.truth, covered), MAX_DB) - before
        for name, restorer in restorers.items()
    }
    return Score(scene, round(pair.ladder, 4), round(inputs.expected_db, 2), inputs.distorted.shape[1], before, gains)


def table(scores: Sequence[Score]) -> str:
    """Mean gains by share of the ladder to a tenth, and the least of any picture; Markdown."""
    shares = sorted({round(score.ladder, 1) for score in scores})
    names = list(scores[0].gains_db)
    at = {share: [score for score in scores if round(score.ladder, 1) == share] for share in shares}
    head = ["share of the ladder", *(f"{share:g}" for share in shares), "worst picture"]
    rows = [["distorted, dB", *(f"{np.mean([s.distorted_db for s in at[share]]):.1f}" for share in shares), ""]]
    for name in names:
        gains = [[score.gains_db[name] for score in at[share]] for share in shares]
        rows.append([name, *(f"{np.mean(g):+.2f}" for g in gains), f"{min(map(min, gains)):+.2f}"])
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
