"""``cags-bench predict``: predictors and field-of-view policies on recorded head motion."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cags_common.poses.walks import Walk

SUMMARY = "Measure the accuracy of pose prediction and the coverage of the reference's field of view on recorded walks."

EXAMPLES = """\
  cags-bench predict --poses poses/ --json
  cags-bench predict --poses poses/ --horizons-ms 100,200 --every-ms 250 --people all
  cags-bench predict --poses poses/ --bundle room.cags --bundle clip.cags    # and end to end
"""

AREAS = (1.2, 1.3, 1.4, 1.5, 1.6, 1.75)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    parser.add_argument("--poses", required=True, metavar="DIR", help="folder of SCENE_userNN.csv walks")
    parser.add_argument(
        "--horizons-ms", default="33,100,200,300,500", metavar="N,..", help="prediction horizons in milliseconds"
    )
    parser.add_argument(
        "--every-ms", type=int, default=500, metavar="N", help="time between predictions in milliseconds"
    )
    parser.add_argument(
        "--people",
        choices=("held-out", "all"),
        default="held-out",
        help="held-out: only people not used to fit the shipped weights; all: also the others, separately",
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="X", help="seconds of each walk for the field-of-view policies"
    )
    parser.add_argument(
        "--bundle",
        action="append",
        default=[],
        metavar="DIR",
        help="also stream this bundle with every predictor and policy",
    )
    parser.add_argument("--trace", default="generated:steady-8", metavar="TRACE", help="link of the streams")
    parser.add_argument("--frames", type=int, default=30, metavar="N", help="frames of each bundle to stream")


def run(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line per predictor and horizon, per policy and per scene; the summary last."""
    from cags_bench.jsonl import provenance, summary
    from cags_common.poses.walks import read_walks

    held_out, fitted_on = split(read_walks(args.poses))
    lines: list[dict[str, Any]] = []
    for people, walks in (("held-out", held_out), ("fitted-on", fitted_on)):
        if walks and (people == "held-out" or args.people == "all"):
            for line in (*_precision(args, walks), *_coverage(args, walks), *_table(walks)):
                lines.append({"benchmark": "predict", "people": people, "walks": len(walks), **line, **provenance()})
                yield lines[-1]
    if args.bundle:
        from cags_bench.predict.end_to_end import stream_all

        played = stream_all(args.bundle, (held_out or fitted_on)[0], args.trace, args.frames)
        yield from ({"benchmark": "predict", **line, **provenance()} for line in played)
    yield summary("predict", checks(lines))


def split(walks: Sequence[Walk]) -> tuple[list[Walk], list[Walk]]:
    """Walks of people whose data no shipped weights were fitted on, and the other walks."""
    from cags_server.fov.lstm import LstmWeights
    from cags_server.predict.pooled import PooledWeights

    used: set[str] = set()
    for provenance in (PooledWeights.load().provenance, LstmWeights.load().provenance):
        used |= {*provenance.get("data", ()), *provenance.get("validation", ())}
    people = {walk.person for walk in walks if walk.name in used}
    return [w for w in walks if w.person not in people], [w for w in walks if w.person in people]


def _precision(args: argparse.Namespace, walks: Sequence[Walk]) -> Iterator[dict[str, Any]]:
    from cags_bench.predict.baseline import PooledAr10
    from cags_bench.predict.precision import measure
    from cags_common.errors import ConfigError
    from cags_server.predict import PREDICTORS, create_predictor

    try:
        horizons = [int(part) * 1000 for part in args.horizons_ms.split(",")]
    except ValueError as error:
        raise ConfigError(f"horizons-ms = {args.horizons_ms!r} must be whole numbers, like 100,200") from error
    if not horizons or min(horizons) < 0 or max(horizons) > 1_000_000 or args.every_ms < 1:
        raise ConfigError(f"horizons-ms = {args.horizons_ms} must lie in [0, 1000] and every-ms above 0")
    predictors = {"pooled-ar10": PooledAr10(), **{name: create_predictor(name) for name in PREDICTORS.names()}}
    for name, horizon, errors in measure(walks, predictors, horizons, args.every_ms * 1000):
        yield {"case": "predictor", "predictor": name, "horizon_ms": horizon // 1000, **errors.figures()}


def _coverage(args: argparse.Namespace, walks: Sequence[Walk]) -> Iterator[dict[str, Any]]:
    from cags_bench.predict.coverage import fast_against_exact, measure
    from cags_bench.predict.table import LEAD_US
    from cags_server.fov import FOV_POLICIES, create_fov_policy
    from cags_server.predict import create_predictor

    make = {name: (lambda name=name: create_fov_policy(name)) for name in FOV_POLICIES.names()}
    for name, curve in measure(walks, create_predictor("autoregressive"), make, LEAD_US, args.seconds).items():
        yield {"case": "fov", "policy": name, "lead_ms": LEAD_US // 1000, **curve.figures(AREAS)}
    sample = walks[:: max(1, len(walks) // 4)]
    yield {
        "case": "fov-truth",
        **fast_against_exact(sample, create_predictor("autoregressive"), LEAD_US, 4_000_000),
    }


def _table(walks: Sequence[Walk]) -> Iterator[dict[str, Any]]:
    """The supplement's accuracy table, one row per scene."""
    from cags_bench.predict.table import table

    for row in table(walks):
        yield {"case": "table", **row.figures()}


def checks(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Targets, for held-out people."""
    from cags_bench.jsonl import check

    held_out = [line for line in lines if line.get("people") == "held-out"]
    found: list[dict[str, Any]] = []
    at_200 = {line["predictor"]: line for line in held_out if line["case"] == "predictor" and line["horizon_ms"] == 200}
    if "pooled-ar10" in at_200:
        base = at_200.pop("pooled-ar10")
        best = min(at_200.values(), key=lambda line: line["angular_mean_deg"])
        for figure in ("angular_mean_deg", "angular_p95_deg"):
            target, value = f"below pooled AR(10): {base[figure]:.3f}", best[figure]
            found.append(check(f"{best['predictor']} {figure} at 200 ms", target, value, value < base[figure]))
    policies = {line["policy"]: line for line in held_out if line["case"] == "fov"}
    if policies:
        at_equal_area = {name: line["coverage_at_area_pct"]["1.5"] for name, line in policies.items()}
        best_policy = max(at_equal_area, key=lambda name: at_equal_area[name])
        value = at_equal_area[best_policy]
        found.append(check(f"coverage of {best_policy} at 1.5x area", ">= 98 %", value, value >= 98.0))
        beats = at_equal_area["lstm"] > max(at_equal_area["fixed"], at_equal_area["quantile"])
        found.append(check("lstm against fixed and quantile at 1.5x", "lstm highest", at_equal_area, beats))
    return found
