"""Who waits by address: the address with most of them loses its oldest."""

from __future__ import annotations

import pytest

from cags_server.http import waiting_list
from cags_server.http.waiting_list import WaitingList


def test_the_oldest_of_the_busiest_address_goes_first() -> None:
    waiting: WaitingList[str] = WaitingList()
    assert waiting.first_to_go() is None
    for peer, item in (("a", "a1"), ("b", "b1"), ("b", "b2"), ("a", "a2"), ("b", "b3")):
        waiting.add(peer, item)
    assert (len(waiting), waiting.first_to_go()) == (5, "b1")
    waiting.add("b", "b1")  # waits anew
    assert (len(waiting), waiting.first_to_go()) == (5, "b2")
    for item in ("b1", "b2", "b2", "none"):
        waiting.discard("b", item)
    waiting.discard("c", "c1")
    assert (len(waiting), waiting.first_to_go()) == (3, "a1")


def test_who_has_waited_long_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(waiting_list.time, "monotonic", lambda: now)
    waiting: WaitingList[str] = WaitingList()
    waiting.add("a", "early")
    now = 104.0
    waiting.add("a", "late")
    waiting.add("b", "other")
    now = 106.0
    assert waiting.longer_than(5.0) == ["early"]
    assert sorted(waiting.longer_than(1.0)) == ["early", "late", "other"]
