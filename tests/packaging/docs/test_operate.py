"""The operator's guide, followed from nothing to TLS, a token, metrics and three viewers: commands as printed.

Only its ports are replaced by free ones.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.processes import free_port

PAGE = Path(__file__).parents[3] / "docs/how-to/operate.md"
FENCE = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.skipif(not (shutil.which("curl") and shutil.which("openssl")), reason="the guide uses curl and openssl")
def test_the_guide_works_from_its_first_line_to_its_last(tmp_path: Path) -> None:
    script = "set -eum\ntrap 'kill $(jobs -p) 2> /dev/null || true' EXIT\n" + "\n".join(FENCE.findall(PAGE.read_text()))
    for port in ("8765", "8766", "8767"):
        script = script.replace(port, str(free_port()))
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    logs = "".join(f"\n{log.name}: {log.read_text()}" for log in tmp_path.glob("*.log"))
    assert done.returncode == 0, done.stdout + done.stderr + logs
    assert "serving clip.cags on wss://0.0.0.0:" in (tmp_path / "server.out").read_text()
    assert '"sessions": [' in done.stdout, "the operator's page"
    assert "cags_sessions_total 3.0" in done.stdout, "metrics"
    for number in (1, 2, 3):
        *frames, _ = map(json.loads, (tmp_path / f"viewer{number}.jsonl").read_text().splitlines())
        assert frames[-1]["frame"] == 19
        (log,) = (tmp_path / "sessions").glob(f"*-s{number}.jsonl")
        ending = json.loads(log.read_text().splitlines()[-1])["ending"]
        assert ending["code"] == "bye"
    assert "is not allowed; list it with --hosts" in (tmp_path / "refused.json").read_text()
    assert (tmp_path / "server.toml").stat().st_mode & 0o077 == 0, "the token is for its owner"
