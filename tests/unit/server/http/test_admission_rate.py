"""Strangers are taken on at a bounded rate, the newest first."""

from __future__ import annotations

import asyncio

import pytest

from cags_server.http import admission_rate
from cags_server.http.admission_rate import AdmissionRate


async def test_few_are_taken_on_at_once_and_the_others_at_the_rate() -> None:
    loop, those = asyncio.get_running_loop(), AdmissionRate(rate=100.0, burst=5.0)
    begun = loop.time()
    assert all(await asyncio.gather(*(those.take() for _ in range(25))))
    assert 0.15 <= loop.time() - begun <= 2.0


async def test_the_newest_goes_first() -> None:
    those, order = AdmissionRate(rate=50.0, burst=1.0), []

    async def one(name: int) -> None:
        assert await those.take()
        order.append(name)

    await those.take()
    await asyncio.gather(*(one(name) for name in range(5)))
    assert order == [4, 3, 2, 1, 0]


async def test_too_many_cost_the_oldest_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission_rate, "MAX_WAITING", 2)
    those = AdmissionRate(rate=200.0, burst=1.0)
    await those.take()
    assert await asyncio.gather(*(those.take() for _ in range(4))) == [False, False, True, True]


async def test_one_who_goes_away_takes_no_turn() -> None:
    those = AdmissionRate(rate=20.0, burst=1.0)
    await those.take()
    gone = asyncio.create_task(those.take())
    stays = asyncio.create_task(those.take())
    await asyncio.sleep(0)
    gone.cancel()
    async with asyncio.timeout(2):
        assert await stays
    assert not those._waiting
