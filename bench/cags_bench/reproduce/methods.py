"""Streaming methods as configurations of the program's seams: ours, the baselines and the ablations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Method:
    """One way to stream: what differs from the defaults of encoder, server and client."""

    title: str
    note: str
    """What is as published, and what stands in for what is not to be had."""
    encode: Mapping[str, Any] = field(default_factory=dict)
    server: Mapping[str, Any] = field(default_factory=dict)
    client: Mapping[str, Any] = field(default_factory=dict)


METHODS: dict[str, Method] = {
    "cags": Method("CAGS (ours)", "the defaults of this program"),
    "cags-paper": Method(
        "CAGS (as published)",
        "66-bit SVQ in the printed order of layers, the four-step rate policy, the LSTM's field of view; closed-form "
        "restoration stands in for the paper's trained network, whose weights are not public, and references keep the "
        "client's footprint, without which it would do worse",
        encode={"quantiser": "paper-66", "lod_order": "paper"},
        server={"abr": "paper", "fov": "lstm"},
        client={"adapt": "none"},
    ),
    "sr-align-ref": Method(
        "SR align ref.",
        "the aligned reference alone; bilinear upsampling stands in for the trained super-resolution network: ours, "
        "trained briefly, has not converged, and a half-trained rival would flatter",
        client={"restore": "reference", "adapt": "none"},
    ),
    "cr-no-ref": Method(
        "CR w/o ref.",
        "the distorted picture without a reference; its restoration network, trained briefly here, adds nothing",
        client={"restore": "none", "adapt": "none"},
    ),
    "lts-f": Method(
        "LTS-F",
        "density levels: nested subsets of splats by importance with compensated opacity and scale, independently "
        "decodable groups, one level a frame; our rate policy stands in for LTS's own",
        encode={"codec": "density"},
        client={"restore": "none", "adapt": "none"},
    ),
    "v3-a": Method(
        "V3-A",
        "attributes as H.264-coded planes at several qualities; a better quality is sent whole; the hash grids that V3 "
        "trains are left out",
        encode={"codec": "video"},
    ),
    "reference-only": Method(
        "reference only",
        "plain remote rendering: no splats are sent; the video of the predicted view, at the client's own size with a "
        "margin of 10 %, may fill 85 % of the link (up to crf 14); the client corrects where it looks by a homography, "
        "not where it stands",
        server={
            "abr": "none",
            "opening_tiles": False,
            "reference_full_size": True,
            "reference_share": 0.85,
            "reference_most": 1.0,
            "reference_crf": 14.0,
            "reference_chroma": "yuv420p",
            "fov": "fixed",
            "fov_margin": 0.1,
        },
        client={"restore": "reference", "align": "rotation", "adapt": "none"},
    ),
    "no-prpa": Method(
        "w/o PRPA",
        "the reference is restored from without alignment",
        client={"align": "unaligned", "adapt": "none"},
    ),
    "no-adaptive-fov": Method(
        "w/o adaptive FoV",
        "the reference's field of view is always 10 % wider",
        server={"fov": "fixed", "fov_margin": 0.1},
    ),
}
"""By the name that ``--methods`` takes."""

BASELINES = ("lts-f", "v3-a", "sr-align-ref", "cr-no-ref", "reference-only")
ABLATIONS = ("no-prpa", "no-adaptive-fov")
