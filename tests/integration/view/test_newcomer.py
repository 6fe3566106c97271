"""A newcomer with one captured file: set in motion, encoded, served, shaped, and looked at in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_encoder.formats import write_splats
from support.browser import chromium, keep_screenshot, require_browser
from support.capture import three_balls
from support.client_page import choose, measured
from support.live_stack import live_stack
from support.web_page import require_built

pytestmark = pytest.mark.slow

DEADLINE_S = 90
LEAST_DB = 22.0
"""Of what the browser shows, after splats, link and video, against the truth as the browser shows it."""

PIXELS = """
const canvas = document.getElementById('picture'), copy = new OffscreenCanvas(160, 120), c = copy.getContext('2d');
c.drawImage(canvas, 0, 0, 160, 120);
return Array.from(c.getImageData(0, 0, 160, 120).data);
"""


def pixels(running: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """What the page's picture shows, [120, 160, 3] in [0, 1]."""
    return np.array(running.execute_script(PIXELS), np.float64).reshape(120, 160, 4)[..., :3] / 255


def wait(running: Any, condition: Callable[[dict[str, Any]], bool], what: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition(measured(running)):
        assert time.monotonic() < deadline, what
        time.sleep(0.2)


def test_a_splat_file_becomes_a_scene_in_the_browser(tmp_path: Path) -> None:
    require_browser()
    require_built()
    capture = tmp_path / "balls.splat"
    write_splats(capture, three_balls())
    scene = f"motion:{capture}:frames=12"
    with live_stack(scene, tmp_path, width=320, height=240) as url, chromium(tmp_path / "profile") as running:
        running.get(url)
        wait(running, lambda page: page["pictures"] > 40, "no pictures")
        running.find_element("id", "picture").send_keys(" h")  # pause, and look at the whole scene
        wait(running, lambda page: (page["stats"].get("lod_mean") or 0) > 0, "no detail arrives")
        wait(running, lambda page: page["poseAtUs"] is not None, "the camera does not follow")
        time.sleep(2.0)
        shown = pixels(running)
        keep_screenshot(running, "newcomer")
        running.find_element("id", "inspect").click()
        figures = running.find_element("id", "figures")
        wait(running, lambda _: "100 %" in figures.text, "the page does not say that all detail is here")
        choose(running, "#picture-a", "truth")
        wait(running, lambda page: page["name"] == "truth", "no truth")
        time.sleep(0.5)
        truth = pixels(running)
    for channel, name in enumerate(("red", "green", "blue")):
        others = np.delete(shown, channel, axis=2).max(axis=2)
        assert (shown[..., channel] - others > 0.2).mean() > 0.003, f"the {name} ball is to be seen"
    db = -10 * np.log10(np.mean((shown - truth) ** 2))
    assert db >= LEAST_DB, f"the page shows the scene at {db:.1f} dB"
