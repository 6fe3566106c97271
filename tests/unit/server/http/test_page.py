"""The viewer at ``/``: which name to type, and what is said where it is not built."""

from __future__ import annotations

import pytest

import cags_web
from cags_server.http.page import SECURITY, browsed, why_missing


@pytest.mark.parametrize(
    ("host", "name"),
    [
        ("127.0.0.1", "localhost"),
        ("::1", "localhost"),
        ("0.0.0.0", "localhost"),
        ("::", "localhost"),
        ("a.org", "a.org"),
    ],
)
def test_browsers_are_sent_to_localhost_where_they_can_be(host: str, name: str) -> None:
    assert browsed(host) == name


def test_a_missing_page_says_how_it_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cags_web, "page_folder", lambda: None)
    assert cags_web.HOW_TO_BUILD in (why_missing() or "")
    monkeypatch.setattr(cags_web, "page_folder", lambda: "folder")
    assert why_missing() is None


def test_the_page_may_load_nothing_from_elsewhere() -> None:
    policy = dict(part.strip().split(" ", 1) for part in SECURITY["Content-Security-Policy"].split(";"))
    assert policy.pop("default-src") == "'none'"
    allowed = {word for sources in policy.values() for word in sources.split()}
    assert allowed == {"'self'", "'wasm-unsafe-eval'", "blob:", "'none'"}
