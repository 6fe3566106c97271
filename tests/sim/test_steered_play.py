"""A viewer who pauses, seeks and loops, over connections that break: client, server and mirror stay of one mind."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Cut
from cags_encoder import EncodeSettings
from support.compared_mirror import Compared
from support.steered_play import CLIENT, SERVER, SteeredPlay, Wish, scenario_of


class Clips:
    """Encoded clips, each made once."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)

    def of(self, frames: int, group: int, splats: int = 900) -> Path:
        """``frames`` of a room, in groups of ``group``."""
        settings = EncodeSettings(frames=frames, gof_frames=group, train_splats=4096, lod_order="paper")
        return cached_bundle(f"procedural:size={splats},frames={frames}", self._folder, settings)


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Clips:
    return Clips(tmp_path_factory.mktemp("bundles"))


def test_a_loop_of_groups_that_pass_goes_on(clips: Clips, groups_pass: None) -> None:
    """A restart was awaited that the server, told that the client keeps what it has, did not send."""
    play = SteeredPlay(scenario_of(clips.of(24, 12)))
    play.until(4)
    assert [frame["frame"] for frame in play.frames[:30]] == [*range(24), *range(6)]
    assert len(play.frames) > 70


def test_a_clip_that_is_kept_whole_loops_without_a_break_from_what_is_held(clips: Clips) -> None:
    play = SteeredPlay(scenario_of(clips.of(24, 8)))
    play.until(6)
    assert [frame["frame"] for frame in play.frames] == [i % 24 for i in range(len(play.frames))]
    assert sum(frame["missed"] for frame in play.frames) == 0
    assert len(play.frames) > 140
    assert sum(frame["bytes_tiles"] for frame in play.frames[72:]) == 0
    assert play.frames[-1]["lod_mean"] == play.library.manifest.lods - 1


@pytest.mark.parametrize(("restore", "references"), [("none", "auto"), ("correct", "none")])
def test_without_references_a_restart_hides_nothing_that_comes_after_it(
    clips: Clips, groups_pass: None, restore: str, references: str
) -> None:
    client, server = replace(CLIENT, restore=restore), replace(SERVER, references=references)
    play = SteeredPlay(scenario_of(clips.of(24, 8), client=client, server=server))
    play.until(4.5)
    assert len(play.frames) > 75, "three rounds"
    assert sum(frame["missed"] for frame in play.frames) <= 1


def test_a_jump_to_what_was_left_behind_is_answered_by_a_restart(clips: Clips, groups_pass: None) -> None:
    """In an outage the server plans two groups further than the display, and has forgotten the group on display."""
    seen: list[tuple[int, int | None]] = []

    def back(player: Any, now_us: int) -> None:
        group = player.pipeline._store._oldest
        seen.append((group, play.server.streamer._tiles._group))
        player.seek(6 * group + 2)

    client = replace(CLIENT, startup_ms=0)
    wishes: list[Wish] = [
        (3_600_000, lambda player, now_us: player.set_rate(0.2, now_us)),
        (6_400_000, back),
        (11_000_000, lambda player, now_us: player.pause(now_us)),
    ]
    play = SteeredPlay(scenario_of(clips.of(60, 6), "generated:blackout:start_s=6.5", client=client), wishes)
    play.until(14)
    ((displayed, entered),) = seen
    assert entered is not None
    assert entered > displayed + 1
    assert play.problems() == []


def test_what_was_on_its_way_at_a_restart_is_not_held(clips: Clips, groups_pass: None) -> None:
    """Its acknowledgements come after the restart."""
    rng, client = random.Random(29), replace(CLIENT, startup_ms=0)
    at_us = int(rng.uniform(1.3e6, 3.0e6))

    def jump(player: Any, now_us: int) -> None:
        group = player.frame // 12
        if group < 4:
            player.seek((group + 1) * 12 + rng.randrange(3))

    trace, delay_us = rng.choice(["generated:steady-4", "generated:steady-2", "generated:steady-8"]), 120_000
    wishes: list[Wish] = [(at_us, jump), (at_us + 1000, lambda player, now_us: player.pause(now_us))]
    scenario = scenario_of(clips.of(60, 12, 3000), trace, client=client, delay_us=delay_us)
    play = SteeredPlay(scenario, wishes, jobs_us=60_000, rng=rng)
    play.until(at_us / 1e6 + 8)
    assert play.problems() == []


SEEDS = 4, 8, 14
"""Of random plays that ended ill once: tiles held only in the belief of the server, marks that stood still."""


PLAYS = [
    *((seed, whole) for seed in SEEDS for whole in (False, True)),
    *(pytest.param(seed, seed % 2 == 1, marks=pytest.mark.nightly) for seed in range(30, 90)),
]


@pytest.mark.parametrize(("seed", "whole"), PLAYS)
def test_whatever_a_viewer_does_all_ends_of_one_mind(
    seed: int, whole: bool, clips: Clips, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paused in the end, the client has what the server believes, shows it, and was never unlike its mirror."""
    if not whole:
        monkeypatch.setattr("cags_common.bundle.manifest.MAX_WHOLE_SPLATS", 0)
    rng = random.Random(seed)
    clip = clips.of(*rng.choice([(24, 8), (48, 48), (60, 12)]))
    trace = rng.choice(["steady-8", "steady-2", "steady-0.7", "steady-20", "blackout:start_s=3"])
    references = rng.choice(["auto", "auto", "difference", "picture"])
    every, abr = rng.choice([1, 1, 3]), rng.choice(["utility", "utility", "paper"])
    wishes, cuts = _random_wishes(rng)
    scenario = scenario_of(
        clip,
        f"generated:{trace}",
        server=replace(SERVER, references=references, reference_every=every, abr=abr),
        cuts=cuts,
        delay_us=rng.choice([5_000, 20_000, 60_000]),
        draw_us=rng.choice([0, 0, 8_000, 25_000]),
    )
    compared = Compared(monkeypatch, always=False)
    play = SteeredPlay(scenario, wishes, jobs_us=rng.choice([0, 0, 15_000, 60_000]), rng=rng)
    play.until(20)
    assert play.problems() == []
    assert compared.frames or references == "picture"


def _random_wishes(rng: random.Random) -> tuple[list[Wish], tuple[Cut, ...]]:
    """Nine seconds of wishes and interruptions, then a play that is paused after half a second."""
    wishes: list[Wish] = []
    cuts: list[Cut] = []
    time_us = 800_000
    while time_us < 9_000_000:
        time_us += int(rng.choice([20_000, 100_000, 300_000, 800_000]) * rng.uniform(0.3, 1.5))
        frame, rate, loops = rng.randrange(60), rng.choice([0.5, 1, 2]), rng.random() < 0.6
        shape = rng.choice([(96, 72, 60.0), (72, 96, 45.0), (128, 48, 100.0)])
        doings = {
            "pause": lambda player, now_us: player.pause(now_us),
            "play": lambda player, now_us: player.play(now_us),
            "seek": lambda player, now_us, frame=frame: player.seek(frame),
            "rate": lambda player, now_us, rate=rate: player.set_rate(rate, now_us),
            "loop": lambda player, now_us, loops=loops: player.set_loop(loops, now_us),
            "shape": lambda player, now_us, shape=shape: player.reshape(*shape, now_us),
        }
        doing = rng.choices([*doings, "cut", "nothing"], [20, 25, 25, 6, 6, 5, 5, 8])[0]
        if doing in doings:
            wishes.append((time_us, doings[doing]))
        elif doing == "cut" and (not cuts or cuts[-1].until_us < time_us):
            cuts.append(Cut(time_us, time_us + rng.choice([0, 50_000, 400_000])))
    wishes.append((9_100_000, lambda player, now_us: player.play(now_us)))
    wishes.append((9_700_000, lambda player, now_us: player.pause(now_us)))
    return wishes, tuple(cuts)
