"""Headless Chromium for tests of the live page; Debian's packages ``chromium`` and ``chromium-driver``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cags_bench.web import browser
from cags_common.errors import ConfigError

ARTEFACTS = Path(os.environ.get("CAGS_ARTEFACTS", "out/live-page"))
"""Screenshots are kept here (``out/`` is not committed)."""


def require_browser() -> tuple[str, str]:
    """Paths of Chromium and its driver; skips the test where either is absent."""
    try:
        return browser.programs()
    except ConfigError as error:
        pytest.skip(str(error))


@contextmanager
def chromium(profile: Path, **options: Any) -> Iterator[Any]:
    """A running headless browser with an empty profile, as :func:`cags_bench.web.browser.chromium`."""
    require_browser()
    with browser.chromium(profile, **options) as running:
        yield running


def keep_screenshot(running: Any, name: str) -> Path:
    """Save what the browser shows as an artefact."""
    ARTEFACTS.mkdir(parents=True, exist_ok=True)
    path = ARTEFACTS / f"{name}.png"
    running.save_screenshot(str(path))
    return path
