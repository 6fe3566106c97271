"""Viewers who mean ill, and a store that goes: what the others see of it.

The short form runs in every build; an hour of it, each attack by itself, with ``-m nightly``.
"""

from __future__ import annotations

import asyncio
import shutil
import time
from pathlib import Path

import pytest

from support.siege import assert_others_are_well, attack, keep, watching

FLOODS = ["evictions:900", "poses:900", "seeks:900", "clock-jump:11", "stalled:4", "storm:10"]
"""Each within the quotas."""

EVERY = [*FLOODS, "half-requests", "garbage", "connection-storm", "silent-sockets", "storm:60"]


DOOR = ["half-requests", "garbage", "connection-storm"]
"""1,100 half requests against 1,024 descriptors, requests that are none, and connections that are reset."""


@pytest.mark.siege
def test_floods_by_viewers_then_crowds_at_the_door_hurt_nobody(bundle: Path, tmp_path: Path) -> None:
    """One server, one siege after the other: floods within the quotas by holders of the token; then strangers: half
    requests, nonsense and resets; 200 silent WebSockets; fifty a second who join, are refused, and come again.
    """
    floods = [f"{each}:secret" for each in FLOODS]
    with keep(bundle, tmp_path, "--token", "secret", "--max-clients", "16", descriptors=1024) as server:
        assert_others_are_well(server, floods, DOOR, ["silent-sockets:200"], ["storm:50"], token="secret")


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", EVERY)
def test_each_attack_for_five_minutes(bundle: Path, tmp_path: Path, name: str) -> None:
    with keep(bundle, tmp_path, descriptors=1024) as server:
        assert_others_are_well(server, [name], quiet_s=20.0, attack_s=300.0)


@pytest.mark.nightly
@pytest.mark.timeout(5400)
def test_a_token_keeps_every_attack_out_for_an_hour(bundle: Path, tmp_path: Path) -> None:
    with keep(bundle, tmp_path, "--token", "secret", "--max-clients", "8", descriptors=1024) as server:
        assert_others_are_well(server, EVERY, quiet_s=20.0, attack_s=3600.0, token="secret")


@pytest.mark.faults
def test_a_bundle_that_is_deleted_fills_no_log_and_ends_no_server(bundle: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.cags"
    shutil.copytree(bundle, copy)

    async def watch_on(url: str) -> list[str]:
        async with watching(url, 2) as viewers:
            shutil.rmtree(copy)
            await asyncio.sleep(4.0)
            return [ending for viewer in viewers for ending in viewer.endings]

    with keep(copy, tmp_path) as server:
        before = len(server.log_lines)
        asyncio.run(watch_on(server.url))
        time.sleep(0.2)
        assert server.process.poll() is None
        assert len(server.log_lines) - before <= 10, server.log.read_text()
        assert server.stop() <= 1.5


@pytest.mark.faults
def test_memory_after_a_storm_of_joins_is_as_before(bundle: Path, tmp_path: Path) -> None:
    async def watch_for(url: str, seconds: float) -> None:
        async with watching(url, 2):
            await asyncio.sleep(seconds)

    with keep(bundle, tmp_path) as server:
        asyncio.run(watch_for(server.url, 1.0))
        time.sleep(1.5)
        before_mb, descriptors = server.rss_mb, server.descriptors
        with attack(server.port, "storm:60"):
            time.sleep(6.0)
        time.sleep(6.5)  # until freed memory is given back
        assert server.rss_mb <= 1.1 * before_mb + 8, f"{before_mb:.0f} -> {server.rss_mb:.0f} MB"
        assert server.descriptors == descriptors
