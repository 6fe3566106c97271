"""Ways to stream that the program is compared with, as settings of encoder, server and client."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Configuration:
    """What differs from the defaults of the encoder, the server and the client."""

    encode: Mapping[str, Any] = field(default_factory=dict)
    server: Mapping[str, Any] = field(default_factory=dict)
    client: Mapping[str, Any] = field(default_factory=dict)


PUBLISHED = Configuration(
    encode={"quantiser": "paper-66", "lod_order": "paper"},
    server={
        "abr": "paper",
        "fov": "lstm-mean-error",
        "lead_frames": 6,
        "poor_lead_frames": 6,
        "references": "picture",
        "reference_footprint": "plain",
    },
    client={"restore": "srresnet", "erosion": True},
)
"""The paper's way: 66-bit SVQ, the four-step rate policy, and the LSTM's field of view, trained by mean error.

References are pictures drawn as any of their size six frames ahead, aligned with erosion (PRPA) and restored by its
network.
"""

REMOTE_RENDERING = Configuration(
    server={
        "abr": "none",
        "lead_frames": 2,
        "references": "picture",
        "opening_tiles": False,
        "reference_full_size": True,
        "reference_share": 0.85,
        "reference_most": 1.0,
        "reference_crf": 14.0,
        "reference_chroma": "yuv420p",
        "fov": "fixed",
        "fov_margin": 0.1,
    },
    client={"restore": "reference", "align": "rotation"},
)
"""Plain remote rendering: no splats, but a video of the predicted view at the client's size, with a margin of 10 %.

The video may fill 85 % of the link; the client turns it by a homography. Nothing has to arrive before it but itself, so
it is planned two frames ahead (66 ms, of which the way there and back over 20 ms takes 40) and not six: predicted for
less, it is right by more. Where the link or the renderer takes longer the lead grows as for everybody.
"""

REMOTE_RENDERING_SMALL = Configuration(
    server={**REMOTE_RENDERING.server, "reference_full_size": False},
    client=REMOTE_RENDERING.client,
)
"""The same at 400x300, which a slow link carries better."""
