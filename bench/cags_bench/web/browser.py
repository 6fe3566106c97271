"""A headless Chromium whose WebGPU runs on the software adapter that it brings."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cags_common.errors import CagsError, ConfigError


class BrowserError(CagsError):
    """The viewer in the browser did not do what was measured; the message says what it did."""


FLAGS = (
    "--headless=new",
    "--no-sandbox",
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
"""WebGPU with canvases on the software adapter; a canvas is read, not screenshot."""


def programs() -> tuple[str, str]:
    """Paths of Chromium and of its driver. Raises :class:`ConfigError` where either, or selenium, is absent."""
    try:
        import selenium.webdriver  # noqa: F401 - told here, before anything is started
    except ImportError:
        raise ConfigError("selenium drives the browser and is not installed; pip install '.[dev]'") from None
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if browser is None or driver is None:
        raise ConfigError("no Chromium with ChromeDriver here; apt-get install chromium chromium-driver")
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
    """A running headless browser (selenium's driver) with an empty ``profile``; ``webgpu`` gives it an adapter.

    Raises :class:`ConfigError` where it cannot be had.
    """
    browser, driver = programs()
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = browser
    flags = FLAGS + (WEBGPU_FLAGS if webgpu else ("--disable-gpu",))
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
