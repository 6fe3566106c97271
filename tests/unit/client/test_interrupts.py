"""The first interrupt ends playback with a goodbye; a second one has its usual effect."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest

from cags_client.interrupts import interrupts


async def test_the_first_signal_ends_playback_and_the_second_is_the_systems() -> None:
    before = signal.getsignal(signal.SIGTERM)
    got: list[signal.Signals] = []
    with interrupts(got.append):
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.sleep(0.02)
        assert got == [signal.SIGTERM]
        assert signal.getsignal(signal.SIGTERM) == before == signal.SIG_DFL
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


async def test_nothing_is_left_behind_after_the_block() -> None:
    with pytest.raises(KeyError), interrupts(lambda _: None):
        raise KeyError
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


async def test_it_does_nothing_outside_of_the_main_thread() -> None:
    def play() -> str:
        async def body() -> str:
            with interrupts(lambda _: None):
                return "played"

        return asyncio.run(body())

    assert await asyncio.to_thread(play) == "played"
