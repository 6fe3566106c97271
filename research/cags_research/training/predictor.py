"""``cags-train predictor``: the pooled ridge regression behind the autoregressive predictor."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from cags_common.errors import ConfigError
from cags_common.geometry import F64
from cags_common.poses import PoseTrace
from cags_common.poses.walks import read_walks, split_people
from cags_server.predict.pooled import HORIZON_STEPS, ORDERS, PooledWeights, displacements, windows
from cags_server.predict.tangent import STEP_US

EXAMPLES = "  cags-train predictor --poses poses/ --held-out 09,10,11,12 --out autoregressive.npz"

PHASES = 3
"""Each walk is sampled on so many shifted grids, so that all of its samples are used."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the subcommand."""
    parser.add_argument("--poses", required=True, metavar="DIR", help="folder of SCENE_userNN.csv walks")
    parser.add_argument("--held-out", default="09,10,11,12", metavar="NN,..", help="people kept for testing")
    parser.add_argument("--ridge", type=float, default=1e-4, metavar="X", help="pull of standardised weights to zero")
    parser.add_argument("--out", required=True, metavar="FILE", help="weights to write (.npz)")


def run(arguments: argparse.Namespace) -> int:
    """Fit, write, and print a summary as JSON. Raises :class:`CagsError`."""
    if not 0 < arguments.ridge < 1e3:
        raise ConfigError(f"ridge = {arguments.ridge} must lie in (0, 1000)")
    train, test = split_people(read_walks(arguments.poses), arguments.held_out)
    weights = fit([walk.trace for walk in train], arguments.ridge)
    weights.provenance.update(
        command=f"cags-train predictor --poses POSES --held-out {arguments.held_out} --ridge {arguments.ridge:g}",
        data=sorted(walk.name for walk in train),
    )
    out = Path(arguments.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    weights.save(out)
    size = out.stat().st_size
    print(json.dumps({"out": str(out), "walks": len(train), "held_out_walks": len(test), "bytes": size}))
    return 0


def fit(traces: Iterable[PoseTrace], ridge: float) -> PooledWeights:
    """Weights of every order and horizon from ``traces``."""
    motions = [motion for trace in traces for motion in _grids(trace)]
    matrices = {order: _fit_order(motions, order, ridge) for order in ORDERS}
    return PooledWeights(matrices, {"ridge": ridge, "step_us": STEP_US, "points": sum(len(q) for q, _ in motions)})


def _grids(trace: PoseTrace) -> list[tuple[F64, F64]]:
    """Rotations and positions of a walk on a few shifted grids."""
    out = []
    for phase in range(PHASES):
        times = np.arange(phase * STEP_US // PHASES, trace.duration_us + 1, STEP_US)
        poses = trace.poses_at(times)
        out.append((np.array([p.rotation for p in poses]), np.array([p.position for p in poses])))
    return out


def _fit_order(motions: list[tuple[F64, F64]], order: int, ridge: float) -> F64:
    """[H, 6 x order, 6] by ridge regression on standardised features, one horizon after another."""
    rows = [windows(rotations, positions, order) for rotations, positions in motions]
    scale = np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)) + 1e-12
    out = []
    for steps in HORIZON_STEPS:
        inputs = np.concatenate([r[: max(0, len(r) - steps)] for r in rows]) / scale
        targets = np.concatenate([displacements(q, p, order, steps) for q, p in motions if len(q) > order + steps])
        gram = inputs.T @ inputs + ridge * len(inputs) * np.eye(inputs.shape[1])
        out.append(np.linalg.solve(gram, inputs.T @ targets) / scale[:, None])
    return np.stack(out)
