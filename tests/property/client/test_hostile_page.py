"""Damaged texts of the page are understood or refused by ProtocolError, never more."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cags_client.output.page.messages import PageHello, parse
from cags_common.errors import ProtocolError
from support.mutation import mutate

TEXTS = [
    json.dumps(fields).encode()
    for fields in (
        {"type": "hello", "h264": True, "raw": False, "token": "sesame"},
        {"type": "pose", "at_us": 7, "position": [0.5, -1.25, 3], "rotation": [0, 0.6, 0, 0.8]},
        {"type": "look", "pictures": ["restored"], "overlays": ["tiles", "score"]},
        {"type": "set", "name": "playing", "value": True},
        {"type": "set", "name": "frame", "value": 12},
        {"type": "set", "name": "cap_mbps", "value": 4.5},
        {"type": "shown", "number": 4, "key": False},
    )
]


def understood(data: bytes) -> bool:
    try:
        parse(data.decode("utf-8", "replace"))
    except ProtocolError:
        return False
    return True


def fuzz(cases: int, seed: int) -> int:
    """Parse ``cases`` damaged texts; how many were understood all the same."""
    rngs = (np.random.default_rng((seed, case)) for case in range(cases))
    return sum(understood(mutate(TEXTS[case % len(TEXTS)], rng)) for case, rng in enumerate(rngs))


def test_whole_texts_are_understood() -> None:
    assert all(map(understood, TEXTS))


def test_damaged_texts() -> None:
    assert 0 < fuzz(2_000, seed=1) < 2_000


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_damaged_texts_at_length() -> None:
    fuzz(100_000, seed=2)


def test_what_is_taken_of_a_token_can_be_encoded() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        token = "".join(map(chr, rng.integers(0xD780, 0xE080, 3)))  # mostly surrogates
        try:
            hello = parse(json.dumps({"type": "hello", "h264": True, "token": token}))
        except ProtocolError:
            continue
        assert isinstance(hello, PageHello)
        hello.token.encode()


@pytest.mark.parametrize("digits", [400, 5000])
def test_a_number_of_many_digits_is_refused(digits: int) -> None:
    assert not understood(b'{"type": "shown", "key": true, "number": 1' + b"0" * digits + b"}")
