"""The training loop: resumable; what it ends with is kept, and never what happened to score best on held-out scenes."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cags_common.errors import ConfigError
from cags_common.geometry import F32
from cags_research.restore.networks import Weights, network_of
from cags_research.restore.networks.runtimes.torch_eager import channels_last
from cags_research.training.pairs.crops import Crops
from cags_research.training.restore.checkpoint import Checkpoint
from cags_research.training.restore.dataset import Batch, draw_batch, even_chances, plain_batch
from cags_research.training.restore.settings import TrainSettings
from cags_research.training.restore.tasks import NETWORKS, as_used, batch_loss, covered_psnr

WARM_UP = 0.02
"""Share of the steps over which the learning rate rises."""

SMALLEST_RATE = 0.01
"""Share of the learning rate that is left at the end."""

MAX_GRADIENT_NORM = 1.0

ADAM = ("step", "exp_avg", "exp_avg_sq")
"""What Adam keeps of a parameter that has had a gradient."""


@dataclass(frozen=True)
class Progress:
    """One line of the training's history."""

    step: int
    loss: float  # mean since the line before
    gain_db: float  # mean gain over the distorted picture on held-out crops
    gains_db: dict[str, float]  # the same by level, a share of the ladder
    worst_gain_db: float  # the least gain of any held-out crop


@dataclass(eq=False)
class Trainer:
    """Trains one network on crops; the same data, settings and seed give the same weights (for one thread count)."""

    settings: TrainSettings
    train: Crops
    held_out: Crops
    seed: int
    history: list[Progress] = field(default_factory=list)

    def __post_init__(self) -> None:
        torch.manual_seed(self.seed)
        self._device = torch.device(self.settings.device)
        make, self._task = NETWORKS[self.settings.network]
        self._begin_with(make(self.settings.gate))
        self._chances = even_chances(self.train)
        self._step = 0
        self._losses: list[float] = []
        self._started = False

    def start_from(self, weights: Weights) -> None:
        """Begin with known weights (fine-tuning). Raises :class:`ConfigError` where they are of another network."""
        if weights.network != self.settings.network:
            raise ConfigError(f"weights are of {weights.network!r}, training is of {self.settings.network!r}")
        self._begin_with(network_of(weights))
        self._started = True

    def _begin_with(self, network: nn.Module) -> None:
        self._network = channels_last(network, self._device)
        self._average = {name: p.detach().clone() for name, p in self._network.named_parameters()}
        self._gated = any(name.startswith("gate.") for name in self._average)
        self._optimiser = torch.optim.Adam(self._network.parameters(), lr=self.settings.rate)

    @property
    def step(self) -> int:
        """Steps done."""
        return self._step

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self._step >= self.settings.steps

    @property
    def weights(self) -> dict[str, F32]:
        """The running average of the weights, as it is now."""
        return {name: p.cpu().numpy().copy() for name, p in self._average.items()}

    def run(self, tell: Callable[[int, int, Progress | None], None], save: Callable[[Checkpoint], None]) -> None:
        """Train to the end; ``save`` is called after each evaluation, ``tell`` after each step."""
        torch.set_num_threads(self.settings.threads)
        if self._step == 0 and self._started:
            self._evaluated()  # what is there already must be beaten
        while not self.finished:
            self._advance()
            line = None
            if self._is_told():
                line = self._evaluated()
                save(self.checkpoint())
            tell(self._step, self.settings.steps, line)

    def _is_told(self) -> bool:
        """Whether what the steps so far have made is scored: regularly, at the end, and what the gate wins alone."""
        s = self.settings
        alone = self._gated and self._step == s.gate_steps
        return alone or self._step % s.evaluate_every == 0 or self._step == s.steps

    def _advance(self) -> None:
        s = self.settings
        for name, parameter in self._network.named_parameters():
            parameter.requires_grad_(not self._gated or self._step >= s.gate_steps or name.startswith("gate."))
        batch = draw_batch(self.train, s.batch, s.patch, (self.seed, self._step), self._chances)
        for group in self._optimiser.param_groups:
            group["lr"] = s.rate * _schedule(self._step / s.steps)
        restored = as_used(s.network, self._task(self._network, batch, self._device), batch)
        value = batch_loss(restored, batch, self._device)
        self._optimiser.zero_grad(set_to_none=True)
        value.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self._network.parameters(), MAX_GRADIENT_NORM)
        self._optimiser.step()
        decay = min(s.average, (1 + self._step) / (10 + self._step))
        with torch.no_grad():
            for name, parameter in self._network.named_parameters():
                self._average[name].lerp_(parameter, 1 - decay)
        self._losses.append(float(value.detach()))
        self._step += 1

    def _evaluated(self) -> Progress:
        network = copy.deepcopy(self._network)
        network.load_state_dict(self._average)
        after, before = self._scores(network.eval())
        gains, levels = after - before, np.round(self.held_out.ladder, 1)
        line = Progress(
            step=self._step,
            loss=float(np.mean(self._losses)) if self._losses else math.nan,
            gain_db=float(gains.mean()),
            gains_db={f"{level:g}": float(gains[levels == level].mean()) for level in np.unique(levels)},
            worst_gain_db=float(gains.min()),
        )
        self.history.append(line)
        self._losses.clear()
        return line

    def _scores(self, network: nn.Module) -> F32:
        """PSNR of every held-out crop [2, N] in dB: restored, as the restorer shows it, and distorted."""
        scores = []
        with torch.inference_mode():
            for start in range(0, len(self.held_out), self.settings.batch):
                rows = np.arange(start, min(start + self.settings.batch, len(self.held_out)))
                batch = plain_batch(self.held_out, rows, self.held_out.truth.shape[1])
                restored = self._task(network, batch, self._device)
                pictures = (as_used(self.settings.network, restored, batch), self._tensor(batch.distorted))
                scores.append(np.stack([self._psnr(picture, batch) for picture in pictures]))
        return np.concatenate(scores, axis=1)

    def _psnr(self, pictures: Tensor, batch: Batch) -> F32:
        psnr: F32 = covered_psnr(pictures, self._tensor(batch.truth), self._tensor(batch.covered)).cpu().numpy()
        return psnr

    def _tensor(self, array: F32) -> Tensor:
        return torch.from_numpy(array).to(self._device)

    # ---------------------------------------------------------------------------------------------------- checkpoints

    def checkpoint(self) -> Checkpoint:
        """Everything that a resumed training needs."""
        arrays: dict[str, F32] = {}
        for name, parameter in self._network.named_parameters():
            arrays[f"network/{name}"] = parameter.detach().cpu().numpy().copy()
            arrays[f"average/{name}"] = self._average[name].cpu().numpy().copy()
            state = self._optimiser.state.get(parameter, {})
            for moment in ADAM if state else ():
                arrays[f"{moment}/{name}"] = state[moment].cpu().numpy().copy()
        history = [list(astuple(line)) for line in self.history]
        facts: dict[str, Any] = {"step": self._step, "history": history, "key": self._key()}
        return Checkpoint(arrays, facts)

    def resume(self, checkpoint: Checkpoint) -> None:
        """Go on from ``checkpoint``. Raises :class:`ConfigError` for one of other settings or another network."""
        if checkpoint.facts.get("key") != self._key():
            raise ConfigError(
                "the checkpoint is of other settings, data or seed; give the same, another --out, or remove it"
            )
        arrays = checkpoint.arrays
        self._step = int(checkpoint.facts["step"])
        self.history[:] = [Progress(int(step), *scores) for step, *scores in checkpoint.facts["history"]]
        for name, parameter in self._network.named_parameters():
            parameter.data.copy_(torch.from_numpy(arrays[f"network/{name}"]))
            self._average[name].copy_(torch.from_numpy(arrays[f"average/{name}"]))
            if f"{ADAM[0]}/{name}" in arrays:
                kept = {what: torch.from_numpy(arrays[f"{what}/{name}"].copy()) for what in ADAM}
                self._optimiser.state[parameter] = {
                    what: value if what == "step" else value.to(self._device) for what, value in kept.items()
                }

    def _key(self) -> str:
        return repr((self.settings, self.seed, len(self.train), len(self.held_out)))


def _schedule(done: float) -> float:
    """Share of the learning rate when the share ``done`` of the steps is done."""
    if done < WARM_UP:
        return done / WARM_UP
    fall = 0.5 * (1 + math.cos(math.pi * (done - WARM_UP) / (1 - WARM_UP)))
    return SMALLEST_RATE + (1 - SMALLEST_RATE) * fall
