"""The precision of prediction and of the field of view, session by session."""

from __future__ import annotations

from cags_bench.reproduce.cases import StreamCase
from cags_bench.reproduce.experiments.streaming import covered_share
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section

PAPER_ROWS: tuple[tuple[Cell, ...], ...] = (
    ("paper: Neural 3D Video", 0.1115, 1.54, 94.72),
    ("paper: ST-NeRF", 0.0804, 1.58, 94.66),
    ("paper: Meeting Room", 0.1841, 1.90, 94.20),
    ("paper: Dynamic 3DGS", 0.0677, 2.38, 93.77),
)


def precision_cases(context: Context) -> list[StreamCase]:
    """Ours over the trace."""
    return [context.case(scene, "cags") for scene in context.plan.scenes]


def precision(context: Context) -> Section:
    """Errors of the poses that references were rendered for, and the share of the view that they covered."""
    rows: list[list[Cell]] = [list(row) for row in PAPER_ROWS]
    for scene in context.plan.scenes:
        result = context.result(context.case(scene, "cags"))
        summary, share = result["summary"], covered_share(result["frames"])
        rows.append(
            [
                scene,
                summary.get("prediction_error_m"),
                summary.get("prediction_error_deg"),
                None if share is None else 100 * share,
            ]
        )
    return Section(
        name="precision",
        title="Prediction and field-of-view precision",
        paper="Supplement, table of precision. Ours counts as covered what survives occlusion and the border as "
        "well, in frames that used a reference.",
        columns=("scene", "position MAE", "angular MAE [deg]", "coverage [%]"),
        rows=rows,
        notes=["Per predictor, horizon and policy, on people never trained on: cags-bench predict."],
    )
