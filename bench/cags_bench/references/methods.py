"""Ways to use references, as settings of server and client."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Method:
    """What differs from the defaults."""

    note: str
    server: Mapping[str, Any] = field(default_factory=dict)
    client: Mapping[str, Any] = field(default_factory=dict)


METHODS: dict[str, Method] = {
    "auto": Method("the default: differences or pictures, whichever leaves less"),
    "difference": Method("what the client lacks, always", server={"references": "difference"}),
    "picture": Method("a picture of the scene, always; the client adds what it lacks of it", {"references": "picture"}),
    "none": Method("the client's own splats alone: all of the link is for tiles", {"references": "none"}),
    "published": Method(
        "the paper's way: a picture drawn as any of its size, aligned with erosion (PRPA), restored by its network",
        server={"references": "picture", "reference_footprint": "plain"},
        client={"restore": "srresnet", "erosion": True},
    ),
}
"""By the name that ``--methods`` takes. Everything else is equal: encoding, prediction, rate policy."""

OURS = "auto"
EARLIER = "before"
"""The method's name in lines that an earlier installation made."""
