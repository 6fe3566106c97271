"""Streaming methods as configurations of the program's seams: ours, the baselines and the ablations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cags_bench.reproduce import added
from cags_research.configurations import PUBLISHED, REMOTE_RENDERING, REMOTE_RENDERING_SMALL


@dataclass(frozen=True)
class Method:
    """One way to stream: what differs from the defaults of encoder, server and client."""

    title: str
    note: str
    """What is as published, and what stands in for what is not to be had."""
    encode: Mapping[str, Any] = field(default_factory=dict)
    server: Mapping[str, Any] = field(default_factory=dict)
    client: Mapping[str, Any] = field(default_factory=dict)
    predicted: bool = False
    """Whether planes count as if predicted from frame to frame: the link is as much faster as that would save."""


OURS_AND_RIVALS: dict[str, Method] = {
    "cags": Method("CAGS (ours)", "the defaults of this program"),
    "cags-paper": Method(
        "CAGS (as published)",
        "66-bit SVQ in the printed order of layers, with one code for each band of harmonics; the four-step rate "
        "policy; the LSTM's field of view, trained by mean absolute error; references are pictures drawn as any of "
        "their size, aligned and eroded (PRPA), restored by the paper's network. Both networks are trained here, "
        "because the authors' weights are not public",
        encode=PUBLISHED.encode,
        server=PUBLISHED.server,
        client=PUBLISHED.client,
    ),
    "sr-align-ref": Method(
        "SR align ref.",
        "the aligned reference alone, super-resolved by the paper's network, which is trained here until it converges",
        server={"references": "picture"},
        client={"restore": "sr-align-ref"},
    ),
    "cr-no-ref": Method(
        "CR w/o ref.",
        "the distorted picture without a reference; its restoration network, trained as long as the others, adds "
        "nothing, so there is none",
        client={"restore": "none"},
    ),
    "lts-f": Method(
        "LTS-F",
        "density levels: nested subsets of splats by importance, grown to stand for the rest (making them more opaque "
        "as well looks worse), each level decodable on its own; our rate policy by tiles, on gains of levels that are "
        "measured on the clip; the training of one layer on the other is left out",
        encode={"codec": "density"},
        client={"restore": "none"},
    ),
    "lts-f-even": Method(
        "LTS-F, a level a frame",
        "as LTS-F, but all visible tiles stand at one level, the highest that the link carries for all of them",
        encode={"codec": "density"},
        server={"abr": "even"},
        client={"restore": "none"},
    ),
    "v3-a": Method(
        "V3-A",
        "attributes as H.264-coded planes at several qualities; a better quality is sent whole; planes of a tile are "
        "intra-coded, since a tile holds what has changed, where V3 predicts from frame to frame; what V3 trains is "
        "left out, gains of qualities are measured on the clip, and it gets our references",
        encode={"codec": "video"},
    ),
    "v3-a-predicted": Method(
        "V3-A, planes predicted",
        "as V3-A, over a link that is as much faster as prediction from frame to frame would make its planes smaller: "
        "measured on the clip's first frames, at the quality at which it saves most, and granted for key frames too. "
        "What V3-A could at most reach, its training apart",
        encode={"codec": "video"},
        predicted=True,
    ),
    "reference-only": Method(
        "reference only",
        "plain remote rendering: no splats are sent; the video of the predicted view, at the client's own size with a "
        "margin of 10 %, may fill 85 % of the link (up to crf 14), and is planned two frames ahead, where ours takes "
        "six; the client corrects where it looks by a homography, not where it stands",
        server=REMOTE_RENDERING.server,
        client=REMOTE_RENDERING.client,
    ),
    "reference-only-small": Method(
        "reference only, 400x300",
        "as reference only, but a video of 400x300, enlarged by the client",
        server=REMOTE_RENDERING_SMALL.server,
        client=REMOTE_RENDERING_SMALL.client,
    ),
    "pictures": Method(
        "pictures alone",
        "references are pictures, never differences",
        server={"references": "picture"},
    ),
    "no-prpa": Method(
        "as published, w/o PRPA",
        "the published way, restored from a picture that is not aligned",
        encode=PUBLISHED.encode,
        server=PUBLISHED.server,
        client={**PUBLISHED.client, "align": "unaligned"},
    ),
    "paper-no-restoration": Method(
        "as published, w/o restoration",
        "the published way, which shows the distorted picture",
        encode=PUBLISHED.encode,
        server=PUBLISHED.server,
        client={"restore": "none"},
    ),
    "paper-no-adaptive-fov": Method(
        "as published, w/o adaptive FoV",
        "the published way; the reference's field of view is always 10 % wider",
        encode=PUBLISHED.encode,
        server={**PUBLISHED.server, "fov": "fixed", "fov_margin": 0.1},
        client=PUBLISHED.client,
    ),
    "printed-order": Method(
        "printed order of layers",
        "ours, with layers in the order that the paper prints and not in that which a scene's measurement gives",
        encode={"lod_order": "paper"},
    ),
    "one-level": Method(
        "one level a frame",
        "ours, with all visible tiles at the same level, the highest that the link carries for all of them. A bundle "
        "without levels cannot be made, so this is what choosing levels tile by tile brings, and not levels themselves",
        server={"abr": "even"},
    ),
    "whole-splats": Method(
        "without motion",
        "ours, with splats that change sent whole, as in the paper",
        encode={"motion": "none"},
    ),
    "all-effects": Method(
        "all effects",
        "ours, with every pass of the client's frame turned on, needed or not",
        client={"effects": "always"},
    ),
    "no-adaptive-fov": Method(
        "w/o adaptive FoV",
        "the reference's field of view is always 10 % wider",
        server={"fov": "fixed", "fov_margin": 0.1},
    ),
}
"""The program's own, by name."""


class Methods(dict[str, Method]):
    """Methods by name; one that was added (:mod:`cags_bench.reproduce.added`) is made when it is asked for."""

    def __missing__(self, name: str) -> Method:
        """The method called ``name``. Raises :class:`KeyError` for an unknown one."""
        setting, seam, which = added.split(name)
        changes: dict[str, Any] = {seam.side: {setting: which}}
        return Method(f"CAGS, {setting} {which}", f"ours, with the {seam.what} {which}, which was added", **changes)


METHODS = Methods(OURS_AND_RIVALS)

BASELINES = (
    "lts-f",
    "lts-f-even",
    "v3-a",
    "v3-a-predicted",
    "sr-align-ref",
    "cr-no-ref",
    "reference-only",
    "reference-only-small",
)
RANGE = ("cags", "cags-paper", "lts-f", "v3-a", "reference-only")
"""Compared over the trace as recorded."""
GENERAL = ("cags", "sr-align-ref", "cr-no-ref", "pictures", "no-adaptive-fov")
"""Compared on other representations: they share an encoding."""
GENERAL_WHOLE = ("cags-paper", "no-prpa", "paper-no-adaptive-fov")
"""Compared there too in a whole run: the paper's own columns, which need encodings of their own."""
ABLATIONS = (
    "pictures",
    "one-level",
    "whole-splats",
    "all-effects",
    "no-adaptive-fov",
    "printed-order",
    "no-prpa",
    "paper-no-restoration",
    "paper-no-adaptive-fov",
)
