"""The precision of prediction and of the field of view, by the code of ``cags-bench predict``."""

from __future__ import annotations

from cags_bench.jsonl import check
from cags_bench.predict.command import split
from cags_bench.predict.table import PrecisionRow, table
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section
from cags_common.poses.walks import read_walks

PAPER_ROWS: tuple[tuple[str, float, float, float], ...] = (
    ("Neural 3D Video", 0.1115, 1.54, 94.72),
    ("ST-NeRF", 0.0804, 1.58, 94.66),
    ("Meeting Room", 0.1841, 1.90, 94.20),
    ("Dynamic 3DGS", 0.0677, 2.38, 93.77),
)

PAPER_COVERAGE_PCT = max(row[3] for row in PAPER_ROWS)


def precision(context: Context) -> Section:
    """Errors of predicted poses, and the share of the view that references cover, on people never trained on."""
    rows: list[list[Cell]] = [
        [f"paper: {name}", None, metres, None, None, degrees, None, None, covered, None, None, None]
        for name, metres, degrees, covered in PAPER_ROWS
    ]
    found: list[PrecisionRow] = []
    if context.plan.walks:
        context.tell("precision")
        found = list(table(split(read_walks(context.plan.walks))[0]))
    rows += [_row(one) for one in found]
    ranges = [f"{name}{bound}" for name in ("position MAE", "angular MAE [deg]", "coverage [%]") for bound in _BOUNDS]
    return Section(
        name="precision",
        title="Prediction and field-of-view precision",
        paper="Supplement, table of precision. The paper's people walked in its own scenes, with units of its own; "
        "rows here are of recorded walks through three real scenes, in metres, by people whom nothing was trained on. "
        "Intervals are over walks.",
        columns=("walks in", "people", *ranges, "area of a reference"),
        rows=rows,
        notes=[
            "The same code as cags-bench predict, which has every predictor, horizon and policy.",
            *([] if found else ["No walks are beside this checkout: give --walks."]),
        ],
        checks=[
            check(
                f"references cover more of the view than the paper's, walks in {one.scene}",
                f"> {PAPER_COVERAGE_PCT} %",
                f"{one.coverage_pct.mean:.2f} [{one.coverage_pct.low:.2f}, {one.coverage_pct.high:.2f}] %",
                one.coverage_pct.above(PAPER_COVERAGE_PCT),
            )
            for one in found
        ],
    )


_BOUNDS = ("", ", 95 % from", ", to")


def _row(one: PrecisionRow) -> list[Cell]:
    intervals = one.position_m, one.angle_deg, one.coverage_pct
    bounds = [value for each in intervals for value in (each.mean, each.low, each.high)]
    return [one.scene, one.walks, *bounds, one.area]
