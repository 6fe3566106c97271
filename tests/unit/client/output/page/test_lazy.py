"""Importing the settings of the page loads nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

import cags_client.output.page as package


def test_settings_alone_load_no_server_and_no_codec() -> None:
    code = (
        "import sys, cags_client.output.page as v; v.ViewSettings(); "
        "print([m for m in ('aiohttp', 'cv2', 'av', 'numpy', 'torch') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    for name in package.__all__:
        assert getattr(package, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        package.nothing  # noqa: B018
