"""Some hard cases on a second driver: SwiftShader, which Chromium brings (the whole set takes minutes there)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ICD = Path("/usr/lib/chromium/vk_swiftshader_icd.json")
HERE = Path(__file__).parent
NAMES = ("one splat", "odd size", "needles 1:1e5", "one depth")


@pytest.mark.skipif(not ICD.exists(), reason=f"no SwiftShader: {ICD} comes with Chromium")
def test_hard_cases_hold_on_swiftshader() -> None:
    test = "test_hard_cases.py::test_is_sound_and_within_the_bound_of_its_level"
    cases = [f"{test}[{name}-exact]" for name in NAMES]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *cases]
    environment = {**os.environ, "VK_ICD_FILENAMES": str(ICD)}
    run = subprocess.run(command, cwd=HERE, env=environment, capture_output=True, text=True, timeout=240, check=False)
    assert run.returncode == 0, run.stdout[-3000:]
    assert f"{len(NAMES)} passed" in run.stdout, "drawn, not skipped"
