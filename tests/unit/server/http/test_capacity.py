"""How many viewers are let in where that is measured."""

from __future__ import annotations

import pytest

from cags_protocol import events as ev
from cags_server.cli import _spelt_out
from cags_server.http import app
from cags_server.http.capacity import Capacity, capacity
from cags_server.records import StreamStats
from cags_server.settings import ServeSettings
from support.live_server import Client, serving


def test_a_viewer_a_core_until_something_is_known() -> None:
    assert capacity(ServeSettings(bundle="x"), 30.0, [StreamStats(references=5)], cores=4) == Capacity(4, None)


def test_what_references_cost_says_how_many() -> None:
    """10 ms on two threads and 5 ms of coding: 25 ms of a core, 30 times a second; 80 % of 4 cores carry 4."""
    measured = StreamStats(references=100, render_ns=1_000_000_000, encode_ns=500_000_000)
    found = capacity(ServeSettings(bundle="x", workers=4), 30.0, [measured, StreamStats()], cores=4)
    assert found.clients == 4
    assert found.reference_ms == pytest.approx(25.0)
    assert "carries 4 viewers of this scene (a reference takes 25.0 ms of a core)" in found.reason()
    half = capacity(ServeSettings(bundle="x", workers=4, reference_every=2), 30.0, [measured], cores=4)
    assert half.clients == 8


def test_the_mirror_s_render_is_part_of_a_reference() -> None:
    """10 ms for the truth and 10 ms for the mirror, on two threads, and 5 ms of coding."""
    measured = StreamStats(references=100, render_ns=10**9, mirror_ns=10**9, encode_ns=5 * 10**8)
    found = capacity(ServeSettings(bundle="x", workers=4), 30.0, [measured], cores=4)
    assert found.reference_ms == pytest.approx(45.0)
    assert found.clients == 2


def test_auto_is_the_number_for_it() -> None:
    assert _spelt_out(["--max-clients", "auto", "--host", "auto"]) == ["--max-clients", "0", "--host", "auto"]
    assert _spelt_out(["--max-clients=auto"]) == ["--max-clients=0"]


async def test_one_more_than_the_machine_carries_is_refused_with_the_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "capacity", lambda *arguments: Capacity(1, 12.0))
    async with serving(max_clients=0) as (_, server):
        first = await Client.join(server)
        await first.until(ev.Welcomed)
        (refused,) = await (await Client.join(server)).until(ev.Refused)
        assert refused.refusal.code == "full"
        assert "carries 1 viewers of this scene (a reference takes 12.0 ms" in refused.refusal.message
