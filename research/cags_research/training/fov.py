"""Trains the LSTM that chooses the margins of the reference (the paper, section 4.4)."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from cags_common.errors import ConfigError
from cags_common.geometry import F32
from cags_research.training.fov_data import FovSequence, chunks
from cags_research.training.fov_settings import FovTraining
from cags_server.fov.lstm import INPUTS, LstmWeights


class FovNetwork(nn.Module):
    """One LSTM layer and a linear read-out, step by step."""

    def __init__(self, hidden: int, mean: Tensor, scale: Tensor) -> None:
        super().__init__()
        self.cell = nn.LSTMCell(INPUTS, hidden)
        self.out = nn.Linear(hidden, 2)
        self.mean, self.scale = mean, scale

    def step(self, inputs: Tensor, state: tuple[Tensor, Tensor] | None) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Margins [B, 2] and the state after one frame of inputs [B, INPUTS]."""
        row = ((inputs - self.mean) / self.scale).clamp(-8, 8)
        hidden, cell = self.cell(row, state)
        return self.out(hidden), (hidden, cell)


@dataclass(frozen=True, eq=False)
class Batch:
    """Sessions side by side: [B, T, ...]."""

    rotations: Tensor
    positions: Tensor
    predicted_rotations: Tensor
    predicted_positions: Tensor
    exact: Tensor
    fast: Tensor

    @classmethod
    def of(cls, parts: Sequence[FovSequence]) -> Batch:
        """Stack sessions of one length."""
        names = ("rotations", "positions", "predicted_rotations", "predicted_positions", "exact", "fast")
        return cls(*(torch.from_numpy(np.stack([getattr(part, name) for part in parts])) for name in names))


def rollouts(network: FovNetwork, batch: Batch, lead: int) -> Tensor:
    """[B, T - lead, lead, 2] margins: from every frame's true state, rolled out over the next ``lead`` predicted
    ones.
    """
    steps = batch.rotations.shape[1]
    state: tuple[Tensor, Tensor] | None = None
    hiddens, cells = [], []
    for i in range(steps - lead):
        before = max(i - 1, 0)
        margins = batch.fast[:, before] if i else torch.zeros_like(batch.fast[:, 0])
        change = batch.rotations[:, i] - batch.rotations[:, before], batch.positions[:, i] - batch.positions[:, before]
        row = [batch.rotations[:, i], change[0], batch.positions[:, i], change[1], margins]
        _, state = network.step(torch.cat(row, dim=1), state)
        hiddens.append(state[0])
        cells.append(state[1])
    return _roll(network, batch, lead, torch.stack(hiddens, dim=1), torch.stack(cells, dim=1))


def _roll(network: FovNetwork, batch: Batch, lead: int, hidden: Tensor, cell: Tensor) -> Tensor:
    count, starts, width = hidden.shape
    state = hidden.reshape(-1, width), cell.reshape(-1, width)
    rotation, position = batch.rotations[:, :starts], batch.positions[:, :starts]
    margins = batch.fast[:, :starts].reshape(-1, 2)
    out = []
    for k in range(1, lead + 1):
        q, p = batch.predicted_rotations[:, k : k + starts], batch.predicted_positions[:, k : k + starts]
        row = torch.cat([q, q - rotation, p, p - position], dim=2).reshape(count * starts, INPUTS - 2)
        margins, state = network.step(torch.cat([row, margins], dim=1), state)
        out.append(margins.reshape(count, starts, 2))
        rotation, position = q, p
    return torch.stack(out, dim=2)


def pinball(margins: Tensor, batch: Batch, lead: int, quantile: float) -> Tensor:
    """Mean pinball loss of roll-outs [B, S, lead, 2], times two: at one half it is the mean absolute error."""
    starts = margins.shape[1]
    needed = torch.stack([batch.exact[:, k : k + starts] for k in range(1, lead + 1)], dim=2)
    short = needed - margins
    return 2 * torch.maximum(quantile * short, (quantile - 1) * short).mean()


class Trainer:
    """Adam with a falling rate; the best weights on the validation walks are kept."""

    def __init__(self, settings: FovTraining, walks: Sequence[FovSequence]) -> None:
        torch.manual_seed(settings.seed)
        self._settings, self._walks = settings, walks
        self._rng = np.random.default_rng(settings.seed)
        sample = Batch.of(self._sessions(walks, np.random.default_rng(settings.seed)))
        self._network = FovNetwork(settings.hidden, *_statistics(sample))
        self._best = {name: value.clone() for name, value in self._network.state_dict().items()}

    def fit(self, validation: Sequence[FovSequence]) -> Iterator[float]:
        """Train; gives the validation loss of each epoch."""
        from rich.console import Console
        from rich.progress import Progress

        settings, network = self._settings, self._network
        optimiser = torch.optim.Adam(network.parameters(), lr=settings.rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.epochs)
        best, waited = float("inf"), 0
        with Progress(console=Console(file=sys.stderr), transient=True) as progress:
            bar = progress.add_task("training", total=settings.epochs)
            for _ in range(settings.epochs):
                self._epoch(optimiser)
                schedule.step()
                loss = self.loss_over(validation)
                progress.update(bar, advance=1, description=f"loss {loss:.4f}")
                waited = 0 if loss < best else waited + 1
                if loss < best:
                    best, self._best = loss, {n: v.clone() for n, v in network.state_dict().items()}
                yield loss
                if waited >= settings.patience:
                    break
        network.load_state_dict(self._best)

    def loss_over(self, walks: Sequence[FovSequence]) -> float:
        """Loss over walks; always the same sessions."""
        batch = Batch.of(self._sessions(walks, np.random.default_rng(0)))
        with torch.no_grad():
            margins = rollouts(self._network, batch, self._settings.lead)
            return float(pinball(margins, batch, self._settings.lead, self._settings.quantile))

    def weights(self, provenance: dict[str, object]) -> LstmWeights:
        """What the server runs."""
        cell, out = self._network.cell, self._network.out
        return LstmWeights(
            w_input=_array(cell.weight_ih),
            w_hidden=_array(cell.weight_hh),
            bias=_array(cell.bias_ih + cell.bias_hh),
            w_out=_array(out.weight),
            b_out=_array(out.bias),
            mean=_array(self._network.mean),
            scale=_array(self._network.scale),
            provenance=dict(provenance),
        )

    def _epoch(self, optimiser: torch.optim.Optimizer) -> None:
        sessions = self._sessions(self._walks, self._rng)
        order = self._rng.permutation(len(sessions))
        for start in range(0, len(order), self._settings.batch):
            batch = Batch.of([sessions[i] for i in order[start : start + self._settings.batch]])
            margins = rollouts(self._network, batch, self._settings.lead)
            loss = pinball(margins, batch, self._settings.lead, self._settings.quantile)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self._network.parameters(), 1.0)
            optimiser.step()

    def _sessions(self, walks: Sequence[FovSequence], rng: np.random.Generator) -> list[FovSequence]:
        sessions = chunks(walks, self._settings.length, rng)
        if not sessions:
            raise ConfigError(f"length = {self._settings.length} frames is longer than every walk; give less")
        return sessions


def _statistics(batch: Batch) -> tuple[Tensor, Tensor]:
    """Mean and scale [INPUTS] of the inputs; parts that belong together share one scale."""
    changes = batch.rotations.diff(dim=1), batch.positions.diff(dim=1)
    scales = [0.5, changes[0].std().item(), batch.positions.std().item(), changes[1].std().item()]
    margins = batch.fast.mean().item(), batch.fast.std().item()
    mean = torch.cat([torch.zeros(14), torch.full((2,), margins[0])])
    sizes = (4, 4, 3, 3)
    parts = [torch.full((n,), max(s, 1e-6)) for n, s in zip(sizes, scales, strict=True)]
    return mean, torch.cat([*parts, torch.full((2,), max(margins[1], 1e-6))])


def _array(tensor: Tensor) -> F32:
    return np.asarray(tensor.detach().numpy(), dtype=np.float32).copy()
