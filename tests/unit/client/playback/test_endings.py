"""Which endings are final, and which streams take more memory than a viewer gives."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from cags_client.playback.endings import COPIES, FATAL_REFUSALS, affordable, refused
from cags_client.settings import ClientSettings
from cags_common.errors import NetworkError
from cags_protocol.wire.messages import Refusal, RefusalCode

SETTINGS = ClientSettings(max_splats=1000, max_memory_mb=1.0)


def stream(*capacity: int, sh_degree: int = 0) -> Any:
    return SimpleNamespace(capacity=capacity, sh_degree=sh_degree)


@pytest.mark.parametrize("code", ["token", "version", "malformed", "unexpected", "quota"])
def test_a_refusal_that_would_come_again_is_final(code: str) -> None:
    assert RefusalCode(code) in FATAL_REFUSALS


@pytest.mark.parametrize("code", ["full", "timeout", "internal"])
def test_a_refusal_that_may_pass_is_tried_again(code: str) -> None:
    assert RefusalCode(code) not in FATAL_REFUSALS


def test_a_refusal_is_told_with_the_field_that_was_wrong() -> None:
    error = refused(Refusal("token", "token", "the token is wrong"))
    assert str(error) == "the server refused (token): the token is wrong"
    assert str(refused(Refusal("full", "", "no room"))) == "the server refused: no room"


def test_the_largest_group_decides() -> None:
    fits = stream(10, 1000)
    assert affordable(fits, SETTINGS) is fits
    assert affordable(stream(), SETTINGS) is not None
    with pytest.raises(NetworkError, match=r"groups of 1001 splats.*--max-splats"):
        affordable(stream(10, 1001), SETTINGS)


def test_memory_grows_with_the_degree_of_the_harmonics() -> None:
    for degree, floats in ((0, 14), (1, 14 + 9), (2, 14 + 24), (3, 14 + 45)):
        splats = int(1e6 / (COPIES * 4 * floats))
        enough = replace(SETTINGS, max_splats=10**6)
        affordable(stream(splats, sh_degree=degree), enough)
        with pytest.raises(NetworkError, match="--max-memory-mb"):
            affordable(stream(splats + 2, sh_degree=degree), enough)


@pytest.mark.parametrize(("machine", "given"), [(3_000.0, 1500), (64_000.0, 4096), (None, 2048)])
def test_half_of_the_machines_memory_is_given_by_default(
    machine: float | None, given: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_client.playback.endings.memory_mb", lambda: machine)
    splats = int(given * 1e6 / (COPIES * 4 * (14 + 45)))
    affordable(stream(splats, sh_degree=3), ClientSettings())
    with pytest.raises(NetworkError, match=f"this client gives {given}; see --max-memory-mb"):
        affordable(stream(splats + 10, sh_degree=3), ClientSettings())
