"""What each network is fed and what it answers, in training: the same inputs as in the client."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cags_client.restore.networks.inputs import filled
from cags_client.restore.networks.lite import Lite
from cags_client.restore.networks.srresnet import Sees, SrResNet
from cags_training.restore.dataset import Batch


@dataclass(frozen=True, eq=False)
class Answer:
    """What a network makes of a batch, before clipping."""

    restored: Tensor  # [B, S, S, 3] in the client's view
    there: Tensor | None = None  # [B, R, R, 3] in the reference's, for networks that work there


Task = Callable[[nn.Module, Batch, torch.device], Answer]


def restore_lite(network: nn.Module, batch: Batch, device: torch.device) -> Answer:
    """The correction by the fields that ``lite`` makes of the closed form's, sampled as the client does."""
    own, reference, fields, noise, distorted, places, weight = (
        torch.from_numpy(image).to(device)
        for image in (
            *(batch.own, batch.reference, batch.fields, batch.noise),
            *(batch.distorted, batch.places, batch.weight),
        )
    )
    found: Tensor = network(own, reference, fields, noise)
    sampled = sampled_at(found, places)
    restored = distorted + weight * (distorted * sampled[..., :1] + sampled[..., 1:])
    return Answer(restored, own + own * found[..., :1] + found[..., 1:])


def sampled_at(image: Tensor, places: Tensor) -> Tensor:
    """Bilinear samples [B, S, S, C] of ``image`` [B, R, R, C] at shares of its side; its border pixels repeat."""
    at = functional.grid_sample(
        image.permute(0, 3, 1, 2), 2 * places - 1, mode="bilinear", padding_mode="border", align_corners=False
    )
    return at.permute(0, 2, 3, 1)


def restore_srresnet(network: nn.Module, batch: Batch, device: torch.device) -> Answer:
    """The paper's network and its one-input variants."""
    aligned = filled(batch.aligned, batch.confidence[..., 0], batch.distorted)
    restored: Tensor = network(torch.from_numpy(aligned).to(device), torch.from_numpy(batch.distorted).to(device))
    return Answer(restored)


NETWORKS: Mapping[str, tuple[Callable[[], nn.Module], Task]] = {
    "lite": (Lite, restore_lite),
    "srresnet": (lambda: SrResNet(Sees.BOTH), restore_srresnet),
    "sr-align-ref": (lambda: SrResNet(Sees.REFERENCE), restore_srresnet),
    "cr-no-ref": (lambda: SrResNet(Sees.DISTORTED), restore_srresnet),
}
"""Network and task by name."""


ERROR_FLOOR = 1e-6
"""Squared error (60 dB) under which pictures count as equal: nothing may be lost at the top of the ladder."""


REGRET = 0.2
"""How much more a loss against what the network improves on counts than a gain."""

THERE_SHARE = 0.3
"""Weight of the reference before it was coded, for networks that work in its view: it has no parallax to learn."""


def batch_loss(answer: Answer, batch: Batch, device: torch.device) -> Tensor:
    """The loss of a batch; where the network starts from the closed form, losses against that count more."""
    truth, covered = (torch.from_numpy(image).to(device) for image in (batch.truth, batch.covered))
    if answer.there is None:
        return loss(answer.restored, truth, covered)
    spared, clean = (torch.from_numpy(image).to(device) for image in (batch.closed_form, batch.clean))
    shown = (clean.amax(dim=3, keepdim=True) > 0).to(clean.dtype)
    return loss(answer.restored, truth, covered, spared) + THERE_SHARE * loss(answer.there, clean, shown)


def loss(restored: Tensor, truth: Tensor, covered: Tensor, spared: Tensor | None = None) -> Tensor:
    """Mean over patches of the logarithm of the squared error: a decibel counts the same at every LoD.

    The error is taken in the displayed range, where values outside [0, 1] are clipped; a twentieth of what was clipped
    counts still, so that its gradient does not die. Void (``covered`` [B, S, S, 1] of 0) counts a tenth of what the
    scene covers. Where ``spared`` is given, every decibel lost against it counts ``REGRET`` times more.
    """
    shown = restored.clamp(0, 1)
    shown = shown + 0.05 * (restored - shown)
    weight = 0.1 + 0.9 * covered
    error = _log_error(shown, truth, weight)
    if spared is None:
        return error.mean()
    return (error + REGRET * (error - _log_error(spared, truth, weight)).relu()).mean()


def _log_error(picture: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
    squared = ((picture - truth) ** 2 * weight).mean(dim=(1, 2, 3)) / weight.mean(dim=(1, 2, 3))
    return torch.log(squared + ERROR_FLOOR)


def covered_psnr(restored: Tensor, truth: Tensor, covered: Tensor) -> Tensor:
    """PSNR [B] in dB of displayed pictures over the pixels that the scene covers, at most 60."""
    weight = (covered >= 0.5).to(truth.dtype)
    squared = ((restored.clamp(0, 1) - truth) ** 2 * weight).sum(dim=(1, 2, 3)) / (3 * weight.sum(dim=(1, 2, 3))).clamp(
        min=1
    )
    return -10 * torch.log10(squared.clamp(min=1e-6))
