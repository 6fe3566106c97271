"""Every table and figure by name, in the paper's order."""

from __future__ import annotations

from cags_bench.reproduce.experiments import coding, determinism, looking, rivals, sessions, streaming, timing
from cags_bench.reproduce.plan import Experiment

EXPERIMENTS: dict[str, Experiment] = {
    one.name: one
    for one in (
        Experiment(
            "motivation",
            "figure",
            "Super-resolution, colours alone, and correction by example",
            coding.motivation,
            cases=coding.still_cases("motivation"),
        ),
        Experiment(
            "svq",
            "table",
            "Scalable vector quantisation at its highest level",
            coding.svq,
            cases=coding.still_cases("svq"),
        ),
        Experiment("fixed", "figure", "Quality under fixed bandwidth", streaming.fixed, cases=streaming.fixed_cases),
        Experiment(
            "fluctuating",
            "figure",
            "Quality under fluctuating bandwidth",
            streaming.fluctuating,
            cases=streaming.fluctuating_cases,
        ),
        Experiment(
            "range", "figure", "The fluctuating link as recorded", streaming.unscaled, cases=streaming.range_cases
        ),
        Experiment("rivals", "table", "Ours against every baseline", rivals.rivals, cases=sessions.session_cases),
        Experiment("sessions", "table", "Every session", sessions.sessions, cases=sessions.session_cases),
        Experiment(
            "ablations",
            "figure",
            "What each effect costs and brings",
            streaming.ablations,
            cases=streaming.ablation_cases,
        ),
        Experiment(
            "generality",
            "figure",
            "Other representations of moving Gaussians",
            streaming.generality,
            cases=streaming.generality_cases,
        ),
        Experiment("components", "table", "Time of the system's components", timing.components),
        Experiment("precision", "table", "Prediction and field-of-view precision", looking.precision),
        Experiment("determinism", "table", "The same bytes every time", determinism.determinism),
        Experiment(
            "layers",
            "figure",
            "Quality against size of each attribute's layers",
            coding.layers,
            cases=coding.layer_cases,
        ),
        Experiment(
            "ladder",
            "figure",
            "Quality against size along the LoD ladder",
            coding.ladder,
            cases=coding.still_cases("ladder"),
        ),
    )
}
