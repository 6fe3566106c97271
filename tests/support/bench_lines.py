"""The JSON lines of a ``cags-bench`` command, checked for what each of them must have."""

from __future__ import annotations

import json

import pytest

from cags_bench.cli import main


def lines_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, object]]:
    assert main([*arguments, "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["summary"] is True
    assert all(set(line) >= {"commit", "machine", "versions"} for line in lines)
    return lines
