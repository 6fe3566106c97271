"""Which hosts may open the page."""

from __future__ import annotations

import pytest

from cags_client.output.page.guard import on_this_machine
from cags_common.transport.hosts import host_allowed


@pytest.mark.parametrize(
    "host", ["localhost", "localhost:8080", "127.0.0.1:1", "[::1]:8080", "192.168.1.7:80", "box:80"]
)
def test_this_machine_by_address_or_allowed_name(host: str) -> None:
    assert host_allowed(host, frozenset({"box"}))


@pytest.mark.parametrize(
    "host", ["", "evil.example", "evil.example:8080", "localhost.evil.example", "[::1", "127.0.0.1.evil"]
)
def test_foreign_names_are_refused(host: str) -> None:
    assert not host_allowed(host, frozenset({"box"}))


@pytest.mark.parametrize("peer", ["127.0.0.1", "127.8.0.1", "::1", "::ffff:127.0.0.1"])
def test_pages_on_this_machine(peer: str) -> None:
    assert on_this_machine(peer)


@pytest.mark.parametrize("peer", ["", "192.168.1.7", "fe80::1", "::ffff:10.0.0.1", "localhost"])
def test_pages_elsewhere(peer: str) -> None:
    assert not on_this_machine(peer)
