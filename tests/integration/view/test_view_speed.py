"""How fast the page is on this machine: displayed frames a second and drag-to-photon time, in a real browser.

For the record, not for judgement: run it on a machine that does nothing else (``pytest -m nightly``). The figures go to
``out/live-page/speed.json`` with the machine's name, the targets beside them, and a picture of the page.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from cags_bench.demo.run import NATIVE, link_trace, threads_each
from cags_bench.demo.settings import DemoSettings
from cags_bench.jsonl import check, dump, summary
from support.browser import ARTEFACTS, chromium, keep_screenshot, require_browser
from support.client_page import click, measured
from support.live_stack import live_stack
from support.web_page import require_built

SCENE = NATIVE.scene
"""The demo's: the link is the demo's too, slow enough that every frame is restored."""

WIDTH, HEIGHT = 800, 600
WATCHED_S = 10.0
DRAGS = 4
SCORED_S = 4.0


def drag(running: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    actions = ActionChains(running, duration=33).click_and_hold(running.find_element(By.ID, "picture"))
    for step in range(30):
        actions.move_by_offset(6 if step < 15 else -6, 1)
    actions.release().perform()


@pytest.mark.nightly
def test_frames_a_second_and_drag_to_photon_are_recorded(tmp_path: Path) -> None:
    require_browser()
    require_built()
    profile = tmp_path / "profile"
    link, threads = link_trace(DemoSettings()), threads_each(DemoSettings())
    more = ("--exactness", "fast", "--restore", "correct", "--threads", threads)
    stack = live_stack(
        SCENE,
        tmp_path,
        width=WIDTH,
        height=HEIGHT,
        delay_ms=20.0,
        trace=link,
        more=more,
        server=("--render-threads", threads),
    )
    with stack as url, chromium(profile) as running:
        running.get(url)
        deadline = time.monotonic() + 60
        while measured(running)["pictures"] < 30:
            assert time.monotonic() < deadline, "no pictures"
            time.sleep(0.2)
        first, started = measured(running)["pictures"], time.monotonic()
        time.sleep(WATCHED_S)
        fps = (measured(running)["pictures"] - first) / (time.monotonic() - started)
        for _ in range(DRAGS):
            drag(running)
            time.sleep(0.3)
        found = measured(running)
        click(running, "#inspect")
        for _ in ("on", "off"):  # a stretch of PSNR in the plots, without its cost in the picture's figures
            click(running, "#overlay-score")
            time.sleep(SCORED_S)
        keep_screenshot(running, "live-page")
    photon = sorted(found["photonMs"])
    assert photon
    median, p95 = photon[len(photon) // 2], photon[int(len(photon) * 0.95)]
    checks = [
        check("displayed frames a second", ">= 24", round(fps, 1), fps >= 24),
        check("drag to photon, median", "<= 120 ms", round(median), median <= 120),
    ]
    figures = {"scene": SCENE, "size": f"{WIDTH}x{HEIGHT}", "fps": round(fps, 1), "codec": found["codec"]}
    line = summary(
        "live-page", checks, **figures, photon_median_ms=round(median), photon_p95_ms=round(p95), drags=len(photon)
    )
    ARTEFACTS.mkdir(parents=True, exist_ok=True)
    (ARTEFACTS / "speed.json").write_text(dump(line) + "\n", encoding="utf-8")
    assert json.loads((ARTEFACTS / "speed.json").read_text(encoding="utf-8"))["fps"] > 0
