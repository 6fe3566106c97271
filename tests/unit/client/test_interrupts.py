"""The first interrupt ends playback with a goodbye; the next one ends the process at once."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator

import pytest

from cags_client.interrupts import SIGNALS, interrupts, noted_interrupts
from cags_common.runtime import endings
from cags_common.runtime.endings import REQUESTS


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """SIGINT as in a program in the foreground (shells have those in the background ignore it); all back after it."""
    before = {number: signal.getsignal(number) for number in REQUESTS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Codes with which the process would have been left at once."""
    codes: list[int] = []
    monkeypatch.setattr(endings, "HEARD_TWICE_S", 0.0)
    monkeypatch.setattr(endings, "_leave", codes.append)
    return codes


async def test_the_first_signal_ends_playback_and_the_next_the_process(left: list[int]) -> None:
    got: list[signal.Signals] = []
    with interrupts(got.append):
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.sleep(0.02)
        assert (got, left) == ([signal.SIGTERM], [])
        signal.raise_signal(signal.SIGINT)
        assert left == [signal.SIGINT]
    signal.raise_signal(signal.SIGTERM)
    assert (got, left) == ([signal.SIGTERM], [signal.SIGINT, signal.SIGTERM])


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


def test_outside_of_a_loop_the_first_signal_is_noted_and_the_next_ends_the_process(left: list[int]) -> None:
    with noted_interrupts() as noted:
        signal.raise_signal(signal.SIGINT)
        assert (noted, left) == ([signal.SIGINT], [])
        signal.raise_signal(signal.SIGTERM)
    assert (noted, left) == ([signal.SIGINT], [signal.SIGTERM])


def test_without_a_signal_the_handlers_are_back_after_the_block() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    with noted_interrupts() as noted:
        assert [signal.getsignal(number) for number in SIGNALS] != before
    assert ([signal.getsignal(number) for number in SIGNALS], noted) == (before, [])


def test_scoring_after_an_interrupted_play_takes_one_more_signal_to_stop(left: list[int]) -> None:
    endings.leave_at_next()
    with noted_interrupts() as noted:
        signal.raise_signal(signal.SIGINT)
    assert (noted, left) == ([signal.SIGINT], [])


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
