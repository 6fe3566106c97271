"""What a page and its client say to each other is recorded; the page's side is held to it by ``tests/web``."""

from __future__ import annotations

import json
from typing import Any

import pytest

from cags_client.output.page.messages import (
    PageHello,
    PageLook,
    PageMessage,
    PagePose,
    PageSet,
    PageShown,
    PageWindow,
    parse,
)
from cags_common.geometry import Pose

from .make import FILE, OF_THE_PAGE, said

READ: dict[str, PageMessage] = {
    "hello": PageHello(True, False),
    "hello with a token": PageHello(True, True, "sesame"),
    "pose": PagePose(1_700_000_000_123_456, Pose((1.0, 2.0, 3.0), (0.6, 0.0, -0.8, 0.0))),
    "window": PageWindow(1280, 720),
    "look": PageLook(("restored", "truth"), frozenset({"tiles", "score"})),
    "pause": PageSet("playing", False),
    "seek": PageSet("frame", 12.0),
    "speed": PageSet("rate", 0.5),
    "loop": PageSet("loop", True),
    "release": PageSet("held", False),
    "choice": PageSet("restorer", "none"),
    "cap": PageSet("cap_mbps", 4.5),
    "no cap": PageSet("cap_mbps", None),
    "delay": PageSet("delay_ms", 60.0),
    "drawn": PageShown(9, False),
    "lost": PageShown(10, True),
}


def test_the_client_says_what_is_recorded() -> None:
    assert json.loads(FILE.read_text(encoding="utf-8")) == said(), "written anew by tests/vectors/page/make.py"


@pytest.mark.parametrize(("name", "fields"), OF_THE_PAGE)
def test_what_the_page_says_is_read(name: str, fields: dict[str, Any]) -> None:
    assert parse(json.dumps(fields)) == READ[name]
