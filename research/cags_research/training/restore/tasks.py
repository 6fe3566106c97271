"""What each network is fed and what it answers, in training: the same inputs as in the client."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor, nn

from cags_research.restore.networks.inputs import filled, reach
from cags_research.restore.networks.srresnet import Sees, SrResNet
from cags_research.training.restore.dataset import Batch

Task = Callable[[nn.Module, Batch, torch.device], Tensor]
"""What a network makes of a batch: the restored pictures [B, S, S, 3] in the client's view, before clipping."""


def restore_srresnet(network: nn.Module, batch: Batch, device: torch.device) -> Tensor:
    """The paper's network and its one-input variants."""
    aligned = filled(batch.aligned, batch.confidence[..., 0], batch.distorted)
    images = (aligned, batch.distorted, batch.expected_db)
    restored: Tensor = network(*(torch.from_numpy(image).to(device) for image in images))
    return restored


def _started_at_blurred(gated: bool) -> SrResNet:
    network = SrResNet(Sees.BOTH, gated=gated)
    network.start_at_blurred()
    return network


NETWORKS: Mapping[str, tuple[Callable[[bool], nn.Module], Task]] = {
    "srresnet": (_started_at_blurred, restore_srresnet),
    "sr-align-ref": (lambda gated: SrResNet(Sees.REFERENCE), restore_srresnet),
    "cr-no-ref": (lambda gated: SrResNet(Sees.DISTORTED), restore_srresnet),
}
"""Network, as training begins with it (with a gate or without, where it may have one), and task by name."""


def as_used(name: str, restored: Tensor, batch: Batch) -> Tensor:
    """What the restorer ``name`` shows where its network answers ``restored``: one that corrects keeps to the reach of
    the reference (:mod:`cags_research.restore.networks.restorer`)."""
    if name != "srresnet":
        return restored
    shares = np.stack([reach(confidence) for confidence in batch.confidence[..., 0]])[..., None]
    distorted = torch.from_numpy(batch.distorted).to(restored.device)
    return distorted + torch.from_numpy(shares).to(restored.device) * (restored - distorted)


HARM = 1.0
"""What a decibel that is lost counts more than one that is won."""

ERROR_FLOOR = 1e-6
"""Squared error (60 dB) under which pictures count as equal: nothing may be lost at the top of the ladder."""


def batch_loss(restored: Tensor, batch: Batch, device: torch.device) -> Tensor:
    """The loss of a batch: the log error of what is restored, and :data:`HARM` times its excess over the distorted.

    The gain of a coarse picture and the loss of a fine one weigh the same in decibels, but a viewer was promised the
    gain: where the expected PSNR and the pictures do not tell which of the two it will be, less is to be changed.
    """
    truth, covered, distorted = (
        torch.from_numpy(image).to(device) for image in (batch.truth, batch.covered, batch.distorted)
    )
    after, before = _log_errors(restored, truth, covered), _log_errors(distorted, truth, covered)
    return (after + HARM * (after - before).clamp(min=0.0)).mean()


def loss(restored: Tensor, truth: Tensor, covered: Tensor) -> Tensor:
    """Mean over patches of the logarithm of the squared error: a decibel counts the same at every LoD.

    The error is taken in the displayed range, where values outside [0, 1] are clipped; a twentieth of what was clipped
    counts still, so that its gradient does not die. Void (``covered`` [B, S, S, 1] of 0) counts a tenth of what the
    scene covers.
    """
    return _log_errors(restored, truth, covered).mean()


def _log_errors(restored: Tensor, truth: Tensor, covered: Tensor) -> Tensor:
    """Logarithm of each patch's squared error [B]."""
    shown = restored.clamp(0, 1)
    shown = shown + 0.05 * (restored - shown)
    weight = 0.1 + 0.9 * covered
    squared = ((shown - truth) ** 2 * weight).mean(dim=(1, 2, 3)) / weight.mean(dim=(1, 2, 3))
    return torch.log(squared + ERROR_FLOOR)


def covered_psnr(restored: Tensor, truth: Tensor, covered: Tensor) -> Tensor:
    """PSNR [B] in dB of displayed pictures over the pixels that the scene covers, at most 60."""
    weight = (covered >= 0.5).to(truth.dtype)
    squared = ((restored.clamp(0, 1) - truth) ** 2 * weight).sum(dim=(1, 2, 3)) / (3 * weight.sum(dim=(1, 2, 3))).clamp(
        min=1
    )
    return -10 * torch.log10(squared.clamp(min=1e-6))
