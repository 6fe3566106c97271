"""The fuzz on native code built with the address and undefined-behaviour sanitizers.

``sanitized.py`` runs every raster test that way (minutes).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("sanitized.py")
FUZZ = "tests/property/common/raster/test_fuzz.py"


def missing() -> str:
    """What this machine lacks; empty where the build can be made."""
    tools = [name for name in ("cmake", "c++") if shutil.which(name) is None]
    if tools:
        return f"{' and '.join(tools)} not found"
    asked = ["c++", "-print-file-name=libasan.so"]
    found = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    return "" if Path(found).is_absolute() else "the compiler has no address sanitizer library"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing() or "complete")
def test_the_fuzz_is_clean_under_the_sanitizers():
    done = run(FUZZ)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    assert "4 passed" in done.stdout
