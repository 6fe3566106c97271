"""Every kernel on native code built with the address and undefined-behaviour sanitizers (``kernels/sanitize.py``)."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "kernels" / "sanitize.py"


def missing() -> str:
    """What this machine lacks; empty where the build can be made."""
    tools = [name for name in ("cmake", "c++") if shutil.which(name) is None]
    if tools:
        return f"{' and '.join(tools)} not found"
    asked = ["c++", "-print-file-name=libasan.so"]
    found = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    return "" if Path(found).is_absolute() else "the compiler has no address sanitizer library"


def assert_clean(*arguments: str) -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    assert re.search(r"\d+ passed", done.stdout)
    assert "skipped" not in done.stdout, "the sanitized library was loaded"


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing() or "complete")
def test_the_kernels_are_clean_under_the_sanitizers() -> None:
    assert_clean("--short")


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.skipif(bool(missing()), reason=missing() or "complete")
def test_every_test_of_a_kernel_is_clean_under_the_sanitizers() -> None:
    assert_clean()
