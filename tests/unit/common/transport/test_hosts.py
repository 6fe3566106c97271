"""Hosts as headers write them: which are this server's, and which a stranger's."""

from __future__ import annotations

import pytest

from cags_common.transport.hosts import host_allowed, host_port, is_host, is_loopback, named, same_host


def test_addresses_of_version_6_are_in_brackets() -> None:
    assert [host_port("::1", 80), host_port("localhost", 80)] == ["[::1]:80", "localhost:80"]


@pytest.mark.parametrize("host", ["localhost", "localhost:8765", "127.0.0.1:80", "[::1]:80", "192.168.1.2", "Mine.org"])
def test_addresses_localhost_and_own_names_are_allowed(host: str) -> None:
    assert host_allowed(host, named(" mine.org, other "))


@pytest.mark.parametrize("host", [None, "", "evil.org", "mine.org.evil", "localhost.evil", "[::1", "127.0.0.1.evil"])
def test_names_that_a_stranger_can_point_here_are_not(host: str | None) -> None:
    assert not host_allowed(host, named("mine.org"))


@pytest.mark.parametrize(
    ("origin", "host", "same"),
    [
        ("http://a:1", "a:1", True),
        ("https://a", "a", True),
        ("http://a:1", "a:2", False),
        ("http://b", "a", False),
        ("null", "a", False),
        ("http://[::1", "[::1", False),
        ("http://a", None, False),
    ],
)
def test_an_origin_is_the_pages_own_only_with_the_same_host_and_port(origin: str, host: str | None, same: bool) -> None:
    assert same_host(origin, host) is same


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("localhost", True), ("127.8.0.1", True), ("::1", True), ("0.0.0.0", False), ("", False), ("mine.org", False)],
)
def test_loopback(host: str, loopback: bool) -> None:
    assert is_loopback(host) is loopback


@pytest.mark.parametrize(
    ("name", "valid"),
    [
        *((name, True) for name in ("localhost", "a.b.", "::1", "fe80::1%eth0", "127.0.0.1", "bücher.example", "_x.y")),
        *((name, False) for name in ("", " ", "a..b", ".", "a" * 64, "a b", "a\0b", "http://a", "[::1]", "\udcff")),
    ],
)
def test_what_can_be_looked_up_is_a_host(name: str, valid: bool) -> None:
    assert is_host(name) is valid
