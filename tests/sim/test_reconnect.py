"""A connection that breaks in virtual time: the play goes on, and nothing that is held is sent again."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import dump
from cags_bench.sim import session
from cags_bench.sim.session import Cut, Scenario, SessionResult, simulate
from cags_client.settings import ClientSettings
from cags_common.errors import NetworkError
from cags_encoder import EncodeSettings
from cags_protocol import events as ev
from cags_server.settings import ServerSettings

FRAMES = 60
SERVER = ServerSettings(reference_width=96, reference_height=72)
CLIENT = ClientSettings(width=96, height=72, restore="none")


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    settings = EncodeSettings(frames=FRAMES, gof_frames=20, train_splats=4096, lod_order="paper")
    bundle = cached_bundle("procedural:size=1500,frames=60", str(tmp_path_factory.mktemp("bundles")), settings)
    return Scenario(bundle, "generated:steady-10", "synthetic:walking", SERVER, CLIENT, score_every=5)


@pytest.fixture
def arrivals(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int, int]]:
    """(source frame, tile, LoD) of every layer that the client was given, as often as it was."""
    layers: list[tuple[int, int, int]] = []
    original = session.Usage.arrived

    def noted(self: Any, events: Any) -> None:
        for event in events:
            if isinstance(event, ev.TileReceived):
                m = event.message
                layers.extend((m.frame, m.tile, lod) for lod in range(m.from_lod, m.to_lod))
        original(self, events)

    monkeypatch.setattr(session.Usage, "arrived", noted)
    return layers


def cut(scenario: Scenario, *times_ms: tuple[int, int]) -> SessionResult:
    return simulate(replace(scenario, cuts=tuple(Cut(a * 1000, b * 1000) for a, b in times_ms)))


def test_a_cut_is_taken_up_and_nothing_held_is_sent_again(
    scenario: Scenario, arrivals: list[tuple[int, int, int]]
) -> None:
    result = cut(scenario, (1300, 1300))
    assert result.summary["reconnects"] == 1
    assert [r["frame"] for r in result.frames] == list(range(FRAMES))
    twice = {key for key, count in Counter(arrivals).items() if count > 1}
    assert not twice
    assert all(not r["missed"] for r in result.frames if r["time_us"] > 1_300_000 + 700_000)


def test_the_picture_is_held_and_follows_the_head_while_there_is_no_connection(scenario: Scenario) -> None:
    seen: list[np.ndarray] = []

    def watch(presented: Any, record: dict[str, Any]) -> None:
        if record["missed"]:
            seen.append(presented.rgb)

    simulate(replace(scenario, cuts=(Cut(1_200_000, 2_000_000),)), watch)
    assert len(seen) > 10
    assert all(float(picture.max()) > 0.1 for picture in seen), "never black"
    assert all(not np.array_equal(a, b) for a, b in itertools.pairwise(seen)), "re-projected"


def test_a_server_that_stays_away_ends_the_play_with_what_went_wrong(scenario: Scenario) -> None:
    client = replace(CLIENT, reconnect_s=0.5)
    with pytest.raises(NetworkError, match="connection was lost"):
        simulate(replace(scenario, client=client, cuts=(Cut(1_200_000, 60_000_000),)))
    with pytest.raises(NetworkError, match="connection was lost"):
        simulate(replace(scenario, client=replace(CLIENT, reconnect_s=0.0), cuts=(Cut(1_200_000, 1_200_000),)))


@pytest.mark.parametrize("at_ms", [5, 60, 200, 450, 2300])
def test_it_may_break_at_any_time(scenario: Scenario, at_ms: int) -> None:
    if at_ms < 40:  # before there was a welcome: there is nothing to take up
        with pytest.raises(NetworkError):
            cut(scenario, (at_ms, at_ms + 100))
        return
    result = cut(scenario, (at_ms, at_ms + 100))
    assert result.summary["frames"] == FRAMES
    assert result.frames[-1]["missed"] is False or at_ms == 2300


def test_two_cuts_and_two_runs_are_the_same(scenario: Scenario) -> None:
    one, two = (cut(scenario, (900, 1000), (1500, 1800)) for _ in range(2))
    assert dump({"frames": one.frames}) == dump({"frames": two.frames})
    assert one.summary["reconnects"] == 2
    assert one.summary["away_ms"] == pytest.approx(100 + 300 + 4 * 40, abs=200)
