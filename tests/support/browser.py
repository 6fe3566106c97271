"""Headless Chromium for tests of the live page; Debian's packages ``chromium`` and ``chromium-driver``."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

ARTEFACTS = Path(os.environ.get("CAGS_ARTEFACTS", "out/live-page"))
"""Screenshots are kept here (``out/`` is not committed)."""

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--force-color-profile=srgb",
)

WEBGPU_FLAGS = (
    "--enable-unsafe-webgpu",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    "--use-webgpu-adapter=swiftshader",
    "--use-angle=swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-vulkan-surface",
    "--disable-gpu-watchdog",
)
"""WebGPU with canvases on the software adapter that Chromium brings; a canvas is read, not screenshot."""


def require_browser() -> tuple[str, str]:
    """Paths of Chromium and its driver; skips the test where either is absent."""
    pytest.importorskip("selenium", reason="selenium drives the browser; pip install '.[dev]'")
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if browser is None or driver is None:
        pytest.skip("no Chromium with ChromeDriver here; apt-get install chromium chromium-driver")
    return browser, driver


@contextmanager
def chromium(
    profile: Path,
    *,
    width: int = 1440,
    height: int = 1000,
    phone: bool = False,
    theme: str = "dark",
    webgpu: bool = False,
) -> Iterator[Any]:
    """A running headless browser with an empty profile; ``webgpu`` gives it a software adapter."""
    from selenium import webdriver

    browser, driver = require_browser()
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    flags = tuple(flag for flag in FLAGS if not (webgpu and flag == "--disable-gpu")) + WEBGPU_FLAGS * webgpu
    for flag in (*flags, f"--window-size={width},{height}", f"--user-data-dir={profile}"):
        options.add_argument(flag)
    if phone:
        metrics = {"width": width, "height": height, "pixelRatio": 2.0, "touch": True}
        options.add_experimental_option("mobileEmulation", {"deviceMetrics": metrics})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    running = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        scheme = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
        running.execute_cdp_cmd("Emulation.setEmulatedMedia", scheme)
        yield running
    finally:
        running.quit()


def keep_screenshot(running: Any, name: str) -> Path:
    """Save what the browser shows as an artefact."""
    ARTEFACTS.mkdir(parents=True, exist_ok=True)
    path = ARTEFACTS / f"{name}.png"
    running.save_screenshot(str(path))
    return path
