"""Settings of the training of the field of view's network."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.settings import check_settings, setting


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
