"""How many viewers are let in where that is measured."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from cags_common.settings import add_settings, load_settings
from cags_protocol import events as ev
from cags_server.http import app
from cags_server.http.capacity import LEAST_MEASURED, Capacity, capacity
from cags_server.http.metrics import exposition
from cags_server.records import ReferenceCosts, StreamStats, Totals
from cags_server.settings import ServeSettings
from support.live_server import Client, serving

NONE = ReferenceCosts()
SERVED = ServeSettings(bundle="x", workers=4)


def test_a_viewer_a_core_until_something_is_known() -> None:
    assert capacity(ServeSettings(bundle="x"), 30.0, [(ReferenceCosts(5), NONE)], cores=4) == Capacity(4, None)


def test_what_references_cost_says_how_many() -> None:
    """10 ms on two threads and 5 ms of coding: 25 ms of a core, 30 times a second; 80 % of 4 cores carry 4."""
    measured = [(ReferenceCosts(100, 1_000_000_000, 500_000_000), NONE), (NONE, NONE)]
    found = capacity(SERVED, 30.0, measured, cores=4)
    assert found.clients == 4
    assert found.reference_ms == pytest.approx(25.0)
    assert "carries 4 viewers of this scene (a reference takes 25.0 ms of a core)" in found.reason()
    half = capacity(ServeSettings(bundle="x", workers=4, reference_every=2), 30.0, measured, cores=4)
    assert half.clients == 8


def test_where_many_watch_references_are_light_and_that_is_what_counts() -> None:
    careful, light = ReferenceCosts(100, 10**9, 10**9), ReferenceCosts(LEAST_MEASURED, 2 * 10**8, 10**8)
    assert capacity(SERVED, 30.0, [(careful, light)], cores=4).reference_ms == pytest.approx(25.0)
    few = ReferenceCosts(LEAST_MEASURED - 1, 1, 1)
    assert capacity(SERVED, 30.0, [(careful, few)], cores=4).reference_ms == pytest.approx(30.0)


def test_those_who_left_count_on() -> None:
    """Once what their mirrors took was forgotten."""
    ended = Totals()
    ended.add(StreamStats(careful=ReferenceCosts(60, 6 * 10**8, 10**8), light=ReferenceCosts(1, 2, 3)))
    ended.add(StreamStats(careful=ReferenceCosts(40, 4 * 10**8, 10**8)))
    assert ended.careful == ReferenceCosts(100, 10**9, 2 * 10**8)
    assert ended.light == ReferenceCosts(1, 2, 3)


def test_looking_at_the_metrics_changes_no_totals() -> None:
    """What goes on is not what has ended, however often somebody asks."""
    ended = Totals()
    for _ in range(2):
        exposition(ended, [StreamStats(careful=ReferenceCosts(60, 1, 1))])
    assert ended == Totals()


@pytest.mark.parametrize("given", [["--max-clients", "auto"], ["--max-clients=auto"], ["--config", "auto.toml"]])
def test_auto_is_the_number_for_it(given: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("auto.toml").write_text('max_clients = "auto"\n')
    parser = argparse.ArgumentParser()
    add_settings(parser, ServeSettings)
    settings = load_settings(ServeSettings, parser.parse_args(["--bundle", "auto", *given]))
    assert (settings.max_clients, settings.bundle) == (0, "auto")


async def test_one_more_than_the_machine_carries_is_refused_with_the_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "capacity", lambda *arguments: Capacity(1, 12.0))
    async with serving(max_clients=0) as (_, server):
        first = await Client.join(server)
        await first.until(ev.Welcomed)
        (refused,) = await (await Client.join(server)).until(ev.Refused)
        assert refused.refusal.code == "full"
        assert "carries 1 viewers of this scene (a reference takes 12.0 ms" in refused.refusal.message
