"""What each network is fed and what it answers, in training: the same inputs as in the client."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from cags_client.restore.networks.inputs import filled
from cags_client.restore.networks.lite import Lite, brought_up
from cags_client.restore.networks.srresnet import Sees, SrResNet
from cags_training.restore.dataset import Batch

Task = Callable[[nn.Module, Batch, torch.device], Tensor]
"""Restored pictures [B, S, S, 3], before clipping."""


def restore_lite(network: nn.Module, batch: Batch, device: torch.device) -> Tensor:
    """Pictures of the closed form plus the change that ``lite`` finds."""
    change: Tensor = network(torch.from_numpy(batch.blocks).to(device))
    return torch.from_numpy(batch.closed_form).to(device) + brought_up(change)


def restore_srresnet(network: nn.Module, batch: Batch, device: torch.device) -> Tensor:
    """The paper's network and its one-input variants."""
    aligned = filled(batch.aligned, batch.confidence, batch.distorted)
    restored: Tensor = network(torch.from_numpy(aligned).to(device), torch.from_numpy(batch.distorted).to(device))
    return restored


NETWORKS: Mapping[str, tuple[Callable[[], nn.Module], Task]] = {
    "lite": (Lite, restore_lite),
    "srresnet": (lambda: SrResNet(Sees.BOTH), restore_srresnet),
    "sr-align-ref": (lambda: SrResNet(Sees.REFERENCE), restore_srresnet),
    "cr-no-ref": (lambda: SrResNet(Sees.DISTORTED), restore_srresnet),
}
"""Network and task by name."""


ERROR_FLOOR = 1e-6
"""Squared error (60 dB) under which pictures count as equal: nothing may be lost at the top of the ladder."""


REGRET = 1.0
"""How much more a loss against the distorted picture counts than a gain, for networks that may leave it as it is."""

CAUTIOUS = frozenset({"lite"})
"""Networks that may leave the distorted picture as it is, and shall where they would worsen it."""


def loss(restored: Tensor, truth: Tensor, covered: Tensor, distorted: Tensor | None = None) -> Tensor:
    """Mean over patches of the logarithm of the squared error: a decibel counts the same at every LoD.

    The error is taken in the displayed range, where values outside [0, 1] are clipped; a twentieth of what was clipped
    counts still, so that its gradient does not die. Void counts a tenth of what the scene covers. Where ``distorted``
    is given, every decibel lost against it counts ``REGRET`` times more.
    """
    shown = restored.clamp(0, 1)
    shown = shown + 0.05 * (restored - shown)
    weight = (0.1 + 0.9 * covered)[..., None]
    error = _log_error(shown, truth, weight)
    if distorted is None:
        return error.mean()
    return (error + REGRET * (error - _log_error(distorted, truth, weight)).relu()).mean()


def _log_error(picture: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
    squared = ((picture - truth) ** 2 * weight).mean(dim=(1, 2, 3)) / weight.mean(dim=(1, 2, 3))
    return torch.log(squared + ERROR_FLOOR)


def covered_psnr(restored: Tensor, truth: Tensor, covered: Tensor) -> Tensor:
    """PSNR [B] in dB of displayed pictures over the pixels that the scene covers, at most 60."""
    weight = (covered >= 0.5).to(truth.dtype)[..., None]
    squared = ((restored.clamp(0, 1) - truth) ** 2 * weight).sum(dim=(1, 2, 3)) / (3 * weight.sum(dim=(1, 2, 3))).clamp(
        min=1
    )
    return -10 * torch.log10(squared.clamp(min=1e-6))
