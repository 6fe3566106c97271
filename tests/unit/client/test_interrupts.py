"""The first interrupt ends playback with a goodbye; a second one has its usual effect."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator

import pytest

from cags_client.interrupts import SIGNALS, interrupts, noted_interrupts


async def test_the_first_signal_ends_playback_and_the_second_is_the_systems() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    got: list[signal.Signals] = []
    with interrupts(got.append):
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.sleep(0.02)
        assert got == [signal.SIGTERM]
        assert [signal.getsignal(number) for number in SIGNALS] == before


async def test_a_commands_own_handlers_are_back_after_the_block() -> None:
    """A command that is asked to end removes what it has begun (:func:`cags_common.cli.run_command`)."""

    def own(number: int, frame: object) -> None: ...

    before = signal.signal(signal.SIGTERM, own)
    try:
        with interrupts(lambda _: None):
            assert signal.getsignal(signal.SIGTERM) is not own
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.fixture
def usual_interrupt() -> Iterator[None]:
    """SIGINT as in a program in the foreground: shells have those in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_outside_of_a_loop_the_first_signal_is_noted_and_the_second_has_its_usual_effect(
    usual_interrupt: None,
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with noted_interrupts() as noted:
        signal.raise_signal(signal.SIGINT)
        assert noted == [signal.SIGINT]
        assert signal.getsignal(signal.SIGTERM) == before
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) == before


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
