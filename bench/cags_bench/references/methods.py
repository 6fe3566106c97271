"""Methods of using references, as settings of server and client."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Method:
    """Settings that differ from the defaults."""

    note: str
    server: Mapping[str, Any] = field(default_factory=dict)
    client: Mapping[str, Any] = field(default_factory=dict)


METHODS: dict[str, Method] = {
    "auto": Method("the default: differences or pictures, whichever leaves the smaller error"),
    "difference": Method("always a difference to the client's splats", server={"references": "difference"}),
    "picture": Method("always a picture, which the client compares with its own splats", {"references": "picture"}),
    "none": Method("no references: the whole link is for tiles", {"references": "none"}),
    "published": Method(
        "the paper's method: a plain picture, aligned with erosion (PRPA), restored by its network",
        server={"references": "picture", "reference_footprint": "plain"},
        client={"restore": "srresnet", "erosion": True},
    ),
}
"""Methods by their names in ``--methods``. Everything else is equal: encoding, prediction, rate policy."""

OURS = "auto"
EARLIER = "before"
"""Name of the method in lines from an earlier installation."""
