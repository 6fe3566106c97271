"""Settings of ``cags-train restore``."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.settings import check_settings, setting

NETWORKS = ("srresnet", "sr-align-ref", "cr-no-ref")


@dataclass(frozen=True)
class TrainSettings:
    """How a network is trained; names are flags and TOML keys."""

    network: str = setting("srresnet", "network to train", choices=NETWORKS)
    steps: int = setting(50_000, "steps of the optimiser", low=1, high=10_000_000)
    batch: int = setting(8, "crops a step", low=1, high=1024)
    patch: int = setting(64, "side of the patch used of each crop, client pixels", low=16, high=1024)
    rate: float = setting(1e-3, "highest learning rate; it rises over 2 % of the steps and falls as a cosine", low=0)
    gate: bool = setting(True, "srresnet is told the PSNR expected of what is on screen; the paper's network is not")
    gate_steps: int = setting(500, "first steps in which the gate of srresnet learns alone", low=0, high=10_000_000)
    average: float = setting(0.998, "decay of the running average of weights that is kept", low=0, high=0.99999)
    evaluate_every: int = setting(1000, "steps between checkpoints, with an evaluation on held-out scenes", low=1)
    threads: int = setting(1, "threads of the arithmetic", low=1, high=256)
    device: str = setting("cpu", "torch device to train on")

    def __post_init__(self) -> None:
        check_settings(self)
